"""Converts captures there and back, and compares what comes back with what was there.

`python -m tests.differential.conversions` does so with every packet capture made by others and of
the project's own, and prints a table.
"""

# Packets of a network must come back one by one, byte for byte, with times, lengths and link types,
# in each way; and the transactions must be the same. A serial line in packets becomes the packets
# of docs/wireshark.md, so only its transactions are compared.

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from mbtool.core import CutError, MbtoolError, WireEvent
from mbtool.packets.line_packets import RTAC_SERIAL
from mbtool.workflows.convert import Conversion
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.shared.time_window import TimeWindow
from tests.captures import public_folder, read_packets
from tests.differential.truth import PORTS, RTU_PORTS
from tests.records import without_origins

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import Packet
    from mbtool.decode.decoder import Record

Item = TypeVar("Item")
OWN = Path(__file__).resolve().parents[2] / "captures"
WAYS = ((".pcapng",), (".pcap",), (".mcap", ".pcapng"), (".mcap", ".pcap"))
_SERIAL_TYPES = (147, RTAC_SERIAL)


@dataclass(slots=True)
class Comparison:
    """What came back of one capture."""

    packets: int
    transactions: int
    is_serial: bool
    ways: int = 0
    """The ways that were gone."""
    unlike: list[str] = field(default_factory=list)
    """A line for each way on which something changed."""


def compare(path: Path, folder: Path) -> Comparison:
    """Convert a capture in all ways that there are for it; files are written into `folder`."""
    options = ReadingOptions(ports=PORTS.get(path.name, ()), rtu_ports=RTU_PORTS.get(path.name, ()))
    packets, transactions = _packets(path), _transactions(path, options)
    link_types = {one.link_type for one in packets}
    is_serial = bool(link_types & {*_SERIAL_TYPES})
    result = Comparison(len(packets), len(transactions), is_serial)
    for way in WAYS:
        if way[-1] == ".pcap" and (is_serial or len(link_types) > 1):
            continue  # Classic pcap holds neither; convert refuses it.
        result.ways += 1
        end, settings = path, options
        for number, suffix in enumerate(way):
            out = folder / f"{number}{suffix}"
            out.unlink(missing_ok=True)
            Conversion([str(end)], settings, TimeWindow.parse(None, None)).write(str(out))
            end, settings = out, ReadingOptions(raw=True)
        if not is_serial and _facts(_packets(end)) != _facts(packets):
            result.unlike.append(f"{' '.join(way)}: other packets")
        # Classic pcap has no place for the ports.
        if _transactions(end, options if way[-1] == ".pcap" else settings) != transactions:
            result.unlike.append(f"{' '.join(way)}: other transactions")
    return result


def captures(folder: Path) -> list[Path]:
    """The packet captures in a folder and below."""
    found = [one for one in folder.rglob("*.pcap*") if one.suffix in (".pcap", ".pcapng", ".gz")]
    return sorted(found)


def _packets(path: Path) -> list[Packet]:
    return list(_until_cut(read_packets(path)))


def _facts(packets: list[Packet]) -> list[tuple[int, int, int, bytes]]:
    return [(one.ts_ns, one.original_length, one.link_type, one.data) for one in packets]


def _transactions(path: Path, options: ReadingOptions) -> list[Record]:
    records = _until_cut(Reading([str(path)], options).records())
    return without_origins(one for one in records if not isinstance(one, WireEvent))


def _until_cut(items: Iterator[Item]) -> Iterator[Item]:
    try:
        yield from items
    except CutError:
        return


def main() -> int:
    """Print the table; the answer is 1 where something changed."""
    changed = 0
    print(f"{'capture':<75} {'packets':>8} {'transactions':>12} {'ways':>4}  came back")
    for path in [*captures(public_folder()), *captures(OWN)]:
        with tempfile.TemporaryDirectory() as folder:
            try:
                result = compare(path, Path(folder))
            except MbtoolError as error:
                print(f"{path.name}: {error}")
                changed += 1
                continue
        same = "transactions the same" if result.is_serial else "all the same"
        print(
            f"{path.parent.name + '/' + path.name:<75.75} {result.packets:>8} "
            f"{result.transactions:>12} {result.ways:>4}  {'; '.join(result.unlike) or same}"
        )
        changed += bool(result.unlike)
    return int(changed > 0)


if __name__ == "__main__":
    sys.exit(main())
