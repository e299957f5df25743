"""Compares captures made by others with what tshark, or their maker, says is in them.

`python -m tests.differential.truth` prints a table of all of them.
"""

# A capture FILE has its truth in FILE.expected.csv where tshark is wrong about it, and otherwise in
# FILE.adu.csv, one row for each ADU. Every field that a row states must be what mbtool reads, and
# the ADUs of each connection must come in the truth's order. What mbtool finds beside them counts
# as extra. The truth of RTU over TCP is of another form: the frames in order, as hexadecimal.
# explained.toml lists the captures in which the two differ for a reason, with the figures.

from __future__ import annotations

import csv
import sys
import tomllib
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import Chunk, CutError, Direction
from mbtool.decode.connections import ConnectionDecoder
from mbtool.modbus import Adu, parse_pdu
from mbtool.packets import StreamClosed, StreamGap, StreamItem, TcpReassembler
from tests.captures import FOLDER, public_folder, read_packets

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.core import Connection
    from mbtool.decode.connections import Decoded

EXPLAINED = Path(__file__).with_name("explained.toml")

PORTS = {"port10502_stepping0.pcap": (10502,)}
"""Captures whose slave is not at port 502."""

RTU_PORTS = {"rtu_over_tcp_brainchild.pcap": (502,), "rtu_over_tcp_flowmeter.pcap": (8899,)}

Flow = tuple[str, str]
Facts = dict[str, str]


@dataclass(slots=True)
class Comparison:
    """What came of one capture."""

    name: str
    truth: int
    found: int
    missing: list[str] = field(default_factory=list)
    """Truth's ADUs that are not there, in order, as it says; one line each."""
    extra: int = 0
    cut: str = ""

    @property
    def agrees(self) -> bool:
        return not self.missing and not self.extra


def captures_with_truth(folder: Path) -> list[Path]:
    """Every packet capture that has a truth, without the recordings of serial lines."""
    return sorted(
        path
        for path in folder.rglob("*.pcap*")
        if path.suffix != ".csv" and _truth_file(path).exists()
    )


def compare(path: Path) -> Comparison:
    """Decode a capture and hold it against its truth."""
    found: dict[Flow, list[Facts]] = defaultdict(list)
    cut = ""
    try:
        for connection, adu in _adus(path):
            found[_flow(str(connection.master), str(connection.slave))].append(_facts(adu))
    except CutError as error:
        cut = str(error)
    truth: dict[Flow, list[Facts]] = defaultdict(list)
    with _truth_file(path).open(newline="") as file:
        for row in csv.DictReader(file):
            if "src" in row:
                flow = _flow(_end(row, "src", "sport"), _end(row, "dst", "dport"))
            else:
                (flow,) = found  # A truth without addresses is of a single connection.
            truth[flow].append(_wanted(row))
    comparison = Comparison(
        name=path.name,
        truth=sum(map(len, truth.values())),
        found=sum(map(len, found.values())),
        cut=cut,
    )
    for flow, wanted in truth.items():
        _hold(comparison, wanted, found[flow])
    comparison.extra = comparison.found - comparison.truth + len(comparison.missing)
    return comparison


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why mbtool differs from a truth, and by how much."""

    figures: tuple[int, int]
    """How many ADUs are missing, and how many are extra."""
    reason: str


def explanations() -> dict[str, Explanation]:
    """The captures in which mbtool differs for a reason, by name."""
    with EXPLAINED.open("rb") as file:
        return {
            name: Explanation((entry["missing"], entry["extra"]), entry["reason"].strip())
            for name, entry in tomllib.load(file).items()
        }


def _adus(path: Path) -> Iterator[tuple[Connection, Adu]]:
    ports = PORTS.get(path.name, (502,))
    rtu_ports = RTU_PORTS.get(path.name, ())
    reassembler = TcpReassembler(frozenset((*ports, *rtu_ports)))
    conversations: dict[Connection, ConnectionDecoder] = {}

    def conversation(connection: Connection) -> ConnectionDecoder:
        rtu = connection.slave.port in rtu_ports
        return conversations.setdefault(connection, ConnectionDecoder(connection, rtu=rtu))

    def decoded(
        connection: Connection, events: Iterable[Decoded]
    ) -> Iterator[tuple[Connection, Adu]]:
        return ((connection, event) for event in events if isinstance(event, Adu))

    for item in _items(path, reassembler):
        match item:
            case Chunk(connection=connection) if connection is not None:
                events = conversation(connection).feed(item.direction, item.data, item.ts_ns)
                yield from decoded(connection, events)
            case StreamGap(connection=connection):
                events = conversation(connection).gap(item.direction, item.missing, item.ts_ns)
                yield from decoded(connection, events)
            case StreamClosed(connection=connection):
                conversations.pop(connection, None)
            case _:
                pass


def _items(path: Path, reassembler: TcpReassembler) -> Iterator[StreamItem]:
    try:
        for packet in read_packets(path):
            yield from reassembler.feed(packet)
    finally:  # Also of a file that was cut off.
        yield from reassembler.close(0)


def _hold(comparison: Comparison, truth: list[Facts], found: list[Facts]) -> None:
    """Look for each ADU of the truth behind the one before it."""
    place = 0
    for wanted in truth:
        for at in range(place, len(found)):
            if all(found[at].get(name) == value for name, value in wanted.items()):
                place = at + 1
                break
        else:
            comparison.missing.append(" ".join(f"{key}={value}" for key, value in wanted.items()))


def _facts(adu: Adu) -> Facts:
    """What the truth's columns would say of an ADU."""
    pdu = parse_pdu(adu.pdu, adu.direction)
    facts = {
        "kind": "req" if adu.direction is Direction.REQUEST else "resp",
        "unit": str(adu.unit),
        "fc": str(pdu.function if pdu.exception_code is not None else pdu.code),
        "hex": adu.raw.hex(),
    }
    if adu.transaction_id is not None:
        facts |= {
            "trans_id": str(adu.transaction_id),
            "prot_id": "0",
            "length": str(adu.size - 6),
        }
    if pdu.exception_code is not None:
        facts["exc"] = str(pdu.exception_code)
    address = pdu.number("address")
    if address is not None:
        facts["ref"] = str(address)
    quantity = pdu.number("quantity")
    if quantity is not None:
        facts["bit_cnt" if pdu.code in (0x01, 0x02, 0x0F) else "word_cnt"] = str(quantity)
    byte_count = _byte_count(adu, pdu.code)
    if byte_count is not None:
        facts["byte_cnt"] = str(byte_count)
    values = pdu.numbers("values")
    if values and pdu.code in (0x03, 0x04, 0x10):
        facts["regs"] = " ".join(map(str, values))
    fifo = pdu.numbers("fifo")
    if fifo:
        facts["word_cnt"] = str(fifo[0])
    value = pdu.number("value")
    if value is not None and pdu.code == 0x06:
        facts["regs"] = str(value)
    return facts


def _byte_count(adu: Adu, code: int) -> int | None:
    """The byte count as it stands in the PDU, right or wrong."""
    request = adu.direction is Direction.REQUEST
    places = (
        {0x0F: 5, 0x10: 5, 0x17: 9, 0x14: 1, 0x15: 1}
        if request
        else dict.fromkeys((0x01, 0x02, 0x03, 0x04, 0x14, 0x15, 0x17), 1)
    )
    place = places.get(code)
    if place is None or place >= len(adu.pdu):
        return None
    return adu.pdu[place]


def _wanted(row: dict[str, str]) -> Facts:
    columns = (
        "kind", "trans_id", "prot_id", "length", "unit", "fc", "exc", "ref", "word_cnt", "bit_cnt",
        "byte_cnt", "regs", "hex",
    )  # fmt: skip
    # Where tshark cannot tell a direction it says "?", which is no statement.
    return {name: row[name] for name in columns if row.get(name) not in (None, "", "?")}


def _truth_file(path: Path) -> Path:
    expected = path.with_name(path.name + ".expected.csv")
    return expected if expected.exists() else path.with_name(path.name + ".adu.csv")


def _end(row: dict[str, str], host: str, port: str) -> str:
    return f"[{row[host]}]:{row[port]}" if ":" in row[host] else f"{row[host]}:{row[port]}"


def _flow(one: str, other: str) -> Flow:
    return (one, other) if one < other else (other, one)


def main(folder: Path) -> int:
    """Print the table; the answer is 1 where a difference is not explained, 3 without captures."""
    paths = captures_with_truth(folder)
    if not paths:
        print(f"{folder}: no capture with its truth; {FOLDER} names their folder", file=sys.stderr)
        return 3
    unexplained = 0
    explained = explanations()
    reasons = []
    print(f"{'capture':<90} {'truth':>7} {'found':>7} {'missing':>8} {'extra':>6}  note")
    for path in paths:
        result = compare(path)
        note = "cut" if result.cut else ""
        if not result.agrees:
            explanation = explained.get(path.name)
            if explanation and explanation.figures == (len(result.missing), result.extra):
                note = "explained below"
                reasons.append(f"{path.name}: {explanation.reason}")
            else:
                note = "DIFFERS"
                unexplained += 1
        print(
            f"{path.relative_to(folder)!s:<90} {result.truth:>7} {result.found:>7} "
            f"{len(result.missing):>8} {result.extra:>6}  {note}"
        )
    print("", *reasons, sep="\n")
    return int(unexplained > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else public_folder()))
