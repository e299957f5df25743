"""Measures reading captures that others made, against tshark: python -m tests.benchmarks.real.

Takes each capture of the folder of public captures that has more than 2,000 packets, and makes it
as large as --packets says by appending it to itself, each time with its times and TCP numbers moved
on. With --same-numbers only the times are moved, so that most copies repeat bytes of the first one.
Two made captures are added: random reads and writes, and a scan of all addresses of all units. Then
runs mbtool and tshark in turn, each as a process of its own, and prints how many times less
processor time mbtool takes, start-up included. The package is compiled before, as an installed one
is. Absolute figures are the machine's; only ratios of
one run can be compared.
"""

from __future__ import annotations

import argparse
import compileall
import shutil
import statistics
import struct
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import mbtool
from mbtool.core import InputError
from mbtool.packets.capture_writer import PcapngWriter, PcapWriter
from mbtool.packets.link_layer import IP_FINDERS, NOT_IP
from mbtool.packets.segment import ACK, FIN, SYN, find_tcp, read_segment
from tests.benchmarks.file_workloads import make_capture, random_requests, scan
from tests.benchmarks.files import FIELDS, run
from tests.captures import public_folder, read_packets

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.core import Packet
    from mbtool.packets.segment import TcpSegment

PACKETS = 200_000
LEAST = 2000
"""A capture with more packets than this is measured."""
MADE = {"random": random_requests, "scan": scan}
PROGRAMS: dict[str, tuple[str, ...]] = {
    "jsonl": ("decode", "--format", "jsonl"),
    "csv": ("decode", "--format", "csv"),
    "parquet": ("decode", "-o", "{folder}/out.parquet", "--overwrite"),
    "stats": ("stats",),
    "inventory": ("inventory",),
    "check": ("check",),
    "report": ("report", "-o", "{folder}/out.html", "--overwrite"),
    "profile": ("decode", "--format", "jsonl", "--device", "all=fa3-at1m8x"),
    "where": ("decode", "--format", "jsonl", "--where", "function == 3"),
}
_DAY_NS = 86_400_000_000_000
_MASK, _HALF = 0xFFFFFFFF, 0x80000000
_PARTS = (".pcap", ".pcapng", ".cap")


def captures(folder: Path, only: Sequence[str] = ()) -> Iterator[tuple[str, Path]]:
    """Yield name and path of each capture in `folder` that has more than LEAST packets.

    `only` has texts of which the path must contain one; empty for all.
    """
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix not in _PARTS or (only and not any(text in name for text in only)):
            continue
        try:
            count = sum(1 for _ in zip(range(LEAST + 1), read_packets(path), strict=False))
        except InputError:
            continue
        if count > LEAST:
            yield name, path


def enlarge(path: Path, packets: int, folder: Path, *, moved: bool = True) -> Path:
    """Return a file in `folder` with the first `packets` packets of the capture appended to itself.

    The times of each copy begin one second after the last time of the copy before, but are moved by
    at most a day. With `moved` the
    TCP numbers go on, too, as if the masters had gone on polling; else each copy of a connection
    that did not end repeats old bytes.
    """
    found = list(read_packets(path))
    times = [each.ts_ns for each in found]
    span_ns = min(max(times) - min(times) + 1_000_000_000, _DAY_NS)
    steps = _steps(found) if moved else {}
    kind = "pcapng" if path.suffix == ".pcapng" else "pcap"
    result = folder / f"enlarged.{kind}"
    with result.open("wb") as file:
        pcapng = PcapngWriter(file) if kind == "pcapng" else None
        pcap = PcapWriter(file, found[0].link_type) if pcapng is None else None
        for number in range(packets):
            copy, index = divmod(number, len(found))
            one = found[index]
            data = _moved(one, steps, copy)
            one = replace(one, ts_ns=one.ts_ns + copy * span_ns, data=data)
            if pcapng is not None:
                pcapng.write(one)
            elif pcap is not None:
                pcap.write(one)
    return result


_Flow = tuple[bytes, int, bytes, int]


def _steps(packets: Sequence[Packet]) -> dict[_Flow, int]:
    """Return for each direction of each connection how many sequence numbers it uses."""
    first: dict[_Flow, int] = {}
    steps: dict[_Flow, int] = {}
    for packet in packets:
        found = _segment(packet)
        if found is not None:
            _, one = found
            flow = one.source, one.source_port, one.destination, one.destination_port
            size = len(one.payload) + one.missing + bool(one.flags & SYN) + bool(one.flags & FIN)
            begin = first.setdefault(flow, one.sequence)
            distance = (one.sequence + size - begin + _HALF & _MASK) - _HALF
            steps[flow] = max(steps.get(flow, 0), distance)
    return steps


def _moved(packet: Packet, steps: dict[_Flow, int], copy: int) -> bytes:
    """Return the bytes of a packet with the TCP numbers that it has in a copy of the capture."""
    found = _segment(packet) if steps and copy else None
    if found is None:
        return packet.data
    start, one = found
    flow = one.source, one.source_port, one.destination, one.destination_port
    sequence = one.sequence + copy * steps[flow] & _MASK
    acknowledged = one.acknowledgement
    if one.flags & ACK:
        acknowledged = acknowledged + copy * steps.get((*flow[2:], *flow[:2]), 0) & _MASK
    numbers = struct.pack(">II", sequence, acknowledged)
    return packet.data[: start + 4] + numbers + packet.data[start + 12 :]


def _segment(packet: Packet) -> tuple[int, TcpSegment] | None:
    """Return the offset of a packet's TCP header, and its segment; None if it has none."""
    finder = IP_FINDERS.get(packet.link_type)
    at = NOT_IP if finder is None else finder(packet.data)
    place = None if at == NOT_IP else find_tcp(packet.data, at, packet.original_length)
    if place is None or len(packet.data) < place.start + 20:
        return None
    segment = read_segment(packet.data, at, place, packet.original_length)
    return None if segment is None else (place.start, segment)


def measure(path: Path, folder: Path, names: Sequence[str], rounds: int) -> dict[str, float]:
    """Run tshark and the programs with these names in turn.

    Returns for each name how many times the processor time of mbtool tshark takes: the median of
    the rounds. The key "tshark" has the seconds of tshark.
    """
    fields = [word for field in FIELDS for word in ("-e", field)]
    tshark = ["tshark", "-r", str(path), "-T", "fields", *fields]
    found: dict[str, list[float]] = {name: [] for name in names}
    seconds = []
    for _ in range(rounds):
        seconds.append(run(tshark).seconds)
        for name in names:
            command, *options = (word.format(folder=folder) for word in PROGRAMS[name])
            words = [sys.executable, "-m", "mbtool", command, str(path), *options]
            # `check` and `report` end with 1 if they have something to tell.
            found[name].append(seconds[-1] / run(words, codes=(0, 1)).seconds)
    ratios = {name: statistics.median(each) for name, each in found.items()}
    return {"tshark": statistics.median(seconds), **ratios}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packets", type=int, default=PACKETS, help="packets of each capture")
    parser.add_argument("--rounds", type=int, default=1, help="the median of these counts")
    parser.add_argument("--only", action="append", default=[], help="part of a path; repeatable")
    parser.add_argument("--program", action="append", default=[], choices=PROGRAMS)
    parser.add_argument("--keep", type=Path, help="a folder for the enlarged captures")
    parser.add_argument("--same-numbers", action="store_true", help="do not move TCP numbers")
    options = parser.parse_args()
    if shutil.which("tshark") is None:
        sys.exit("tshark is not installed")
    compileall.compile_dir(str(Path(mbtool.__file__).parent), quiet=1)
    names = options.program or [*PROGRAMS]
    sys.stdout.write(f"{'capture':<44}{'tshark s':>9}" + "".join(f"{one:>10}" for one in names))
    sys.stdout.write("\n")
    rows = []
    for name, ratios in _all(options, names):
        cells = "".join(f"{ratios[one]:>10.1f}" for one in names)
        sys.stdout.write(f"{name[-43:]:<44}{ratios['tshark']:>9.2f}{cells}\n")
        sys.stdout.flush()
        if name not in MADE:
            rows.append(ratios)
    for text, of in (("median of captures", statistics.median), ("lowest", min)):
        if rows:
            cells = "".join(f"{of(one[name] for one in rows):>10.1f}" for name in names)
            sys.stdout.write(f"{text:<53}{cells}\n")


def _all(
    options: argparse.Namespace, names: Sequence[str]
) -> Iterator[tuple[str, dict[str, float]]]:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, path in captures(public_folder(), options.only):
            large = enlarge(path, options.packets, folder, moved=not options.same_numbers)
            if options.keep is not None:
                options.keep.mkdir(exist_ok=True)
                shutil.copy(large, options.keep / (name.replace("/", "+")))
            yield name, measure(large, folder, names, options.rounds)
            large.unlink()
        for name, frames in MADE.items():
            if not options.only or name in options.only:
                made = make_capture(folder / f"{name}.pcap", frames, options.packets)
                if options.keep is not None:
                    shutil.copy(made.path, options.keep)
                yield name, measure(made.path, folder, names, options.rounds)


if __name__ == "__main__":
    main()
