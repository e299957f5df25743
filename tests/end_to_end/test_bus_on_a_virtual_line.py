"""A recording played as the bus, and sniffed at the other end of the line."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, SerialFormat, SerialLink, WireEvent, parse_line
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.modbus import Outcome
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.replay_bus import BusOptions, BusRun
from mbtool.workflows.replay_master import MasterOptions, MasterRun
from mbtool.workflows.replay_slave import SlaveOptions, SlaveRun
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.sniff import Sniffer, serial_lines
from tests.end_to_end.programs import PATIENCE_S
from tests.workflows.bench import until

if TYPE_CHECKING:
    from mbtool.core import LineSettings
    from mbtool.decode.decoder import Evidence, Record
    from mbtool.workflows.replay_bus import BusReport

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

OURS = Path(__file__).resolve().parents[2] / "captures"
LINE = SerialFormat(19200, 8, "E", 1)
FAST = SerialFormat(115200, 8, "N", 1)

Told = tuple[int, bytes | None, bytes | None, Outcome]


def _told(records: list[Record]) -> list[Told]:
    """What counts of each transaction, whatever its time."""
    return [
        (one.unit, one.request_raw, one.response_raw, one.outcome)
        for one in records
        if not isinstance(one, WireEvent)
    ]


def _skipped(records: list[Record]) -> bytes:
    """All of it in one, as a read that comes late parts what belongs together."""
    return b"".join(one.raw for one in records if isinstance(one, WireEvent) and one.raw)


class _CountingDecoder(Decoder):
    """Counts the bytes that it is fed."""

    heard = 0

    def feed(self, item: Evidence) -> list[Record]:
        self.heard += len(item.data) if isinstance(item, Chunk) else 0
        return super().feed(item)


def _played(
    path: Path, format_: SerialFormat, *, is_ascii: bool = False, line: LineSettings | None = None
) -> tuple[list[Record], BusReport]:
    """What a sniffer hears of a recording that is played on a virtual line."""
    records: list[Record] = []
    reports: list[BusReport] = []
    with VirtualLine(format=format_) as virtual:
        near, far = (SerialLink(port, format_, is_ascii) for port in virtual.ports)
        run = BusRun(str(path), BusOptions(reading=ReadingOptions(line=line)), near)
        decoder = _CountingDecoder(Namer(), lines=serial_lines([far]))
        with Sniffer([far], decoder) as sniffer:
            player = threading.Thread(target=lambda: reports.append(run.play()), daemon=True)
            player.start()
            deadline = time.monotonic() + PATIENCE_S

            def stop(_now_ns: int) -> bool:
                assert time.monotonic() < deadline, f"heard {decoder.heard} bytes of {reports}"
                return bool(reports) and decoder.heard >= reports[0].bytes

            records += sniffer.records(stop)
    (report,) = reports
    return records, report


@pytest.mark.parametrize(
    "name",
    [
        "torn-and-glued-frames.mcap",
        "retry-after-silence.mcap",
        "broadcast-write.mcap",
    ],
)
def test_our_lines_are_heard_as_they_were_recorded(name: str) -> None:
    heard, report = _played(OURS / name, LINE)
    recorded = list(Reading([str(OURS / name)], ReadingOptions()).records())
    assert _told(heard) == _told(recorded)
    assert _skipped(heard) == _skipped(recorded)
    assert report.lateness_p99_ns is not None


def test_an_ascii_line_is_heard_as_it_was_recorded() -> None:
    path = OURS / "ascii-line.mcap"
    heard, _ = _played(path, SerialFormat(9600, 7, "E", 1), is_ascii=True)
    assert _told(heard) == _told(list(Reading([str(path)], ReadingOptions()).records()))


def test_a_network_is_heard_as_frames_on_a_line() -> None:
    path = OURS / "polling-with-exceptions.mcap"
    heard, _ = _played(path, FAST)
    recorded = [
        one
        for one in Reading([str(path)], ReadingOptions()).records()
        if not isinstance(one, WireEvent)
    ]
    told = [one for one in heard if not isinstance(one, WireEvent)]
    assert [
        (one.unit, one.function, one.address, one.response_values, one.exception) for one in told
    ] == [
        (one.unit, one.function, one.address, one.response_values, one.exception)
        for one in recorded
    ]
    assert {one.outcome for one in told} == {Outcome.OK, Outcome.EXCEPTION}


@pytest.mark.public_captures
@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("sigrokproject__sigrok-dumps/brainchild-io-16do.bytes.csv", None),
        ("sigrokproject__sigrok-dumps/flowmeter_graph_tool.bytes.csv", None),
        ("sigrokproject__sigrok-dumps/flowmeter_graph_tool.user0.pcap", None),
        ("sigrokproject__sigrok-dumps/flowmeter_graph_tool.rtac.pcap", None),
        ("ZZ_text_logs/tio__tio/issue226.hex.txt", "rtu@9600-8N1"),
        ("derived/noisy_bus_flowmeter.bus.bin", "rtu@9600-8N1"),
    ],
)
def test_lines_of_others_are_heard_as_they_were_recorded(
    name: str, line: str | None, public_captures: Path
) -> None:
    path = public_captures / name
    settings = None if line is None else parse_line(line)
    recorded = list(Reading([str(path)], ReadingOptions(line=settings)).records())
    played_on = settings.format if settings else SerialFormat(9600, 8, "N", 1)
    heard, _ = _played(path, played_on, line=settings)
    assert _told(recorded)
    assert _told(heard) == _told(recorded)


def test_a_damaged_answer_is_heard_again_on_a_line() -> None:
    """As the slave: the master gets the very bytes, and asks again as it did."""
    path = OURS / "torn-and-glued-frames.mcap"
    recorded = list(Reading([str(path)], ReadingOptions()).records())
    wrong = bytes.fromhex("01 03 04 12 34 56 78 81 f8")
    assert wrong in _skipped(recorded)
    with VirtualLine(ends=3, format=LINE) as virtual:
        asking, answering, listening = (SerialLink(port, LINE) for port in virtual.ports)
        slave = SlaveRun(str(path), SlaveOptions(with_damage=True, rate=None)).create_slave(
            answering
        )
        run = MasterRun(
            str(path),
            MasterOptions(reading=ReadingOptions(), rate=None, timeout_ns=1_000_000_000),
        )
        heard: list[Record] = []
        decoder = Decoder(Namer(), lines=serial_lines([listening]))
        with Sniffer([listening], decoder) as sniffer:
            with slave.shell:
                report = run.play(asking)
            stop = until(heard, lambda found: len(_told(found)) >= len(_told(recorded)))
            for record in sniffer.records(stop):
                heard.append(record)
    assert report.different == 0  # A wrong CRC is no answer, as it was then.
    assert _skipped(heard).count(wrong) == 1
    assert [one[3] for one in _told(heard)].count(Outcome.NO_ANSWER) == 1
