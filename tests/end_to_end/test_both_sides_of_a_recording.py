"""A recording played as the slave answers the same recording played as the master."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import WireEvent, parse_line, parse_link
from mbtool.devices import DifferenceKind, Span
from mbtool.modbus import Outcome, Table
from mbtool.query.where import parse_where
from mbtool.replay import MatchStrategy, OnMiss, RecordedSlave
from mbtool.slave.faults.faults import Fault, FaultKind, FaultySlave
from mbtool.slave.faults.faults import FaultCondition as FaultMatch
from mbtool.slave.shells import open_shell
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.replay_master import MasterOptions, MasterRun
from mbtool.workflows.replay_slave import SlaveOptions, SlaveRun
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from mbtool.core import LinkSpec
    from mbtool.modbus import Responder
    from mbtool.workflows.replay_master import Report

LOOPBACK = parse_link("tcp:127.0.0.1:0")
OURS = Path(__file__).resolve().parents[2] / "captures"
OURS_ON_A_LINE = ("ft1a-touch-line.mcap", "retry-after-silence.mcap", "torn-and-glued-frames.mcap")

PUBLIC = (
    "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap",
    "OISF__suricata-verify/tests__modbus__modbus.pcap",
    "Stepping0__modbus-dnp3-gateway/pcap__modbus.pcapng",
    "antoine-lemay__Modbus_dataset/send_a_fake_command_modbus_6RTU_with_operate.pcap",
    "apache__plc4x/modbus__tcp__manual-test-capture.pcapng",
    "arkime__arkime/tests__pcap__modbus.pcap",
    "cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap",
    "digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap",
    "kb221svs__modbus-anomaly-detection/modbus.pcap",
    "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap",
    "ntop__nDPI/modbus.pcap",
    "zeek__zeek/modbusSmall.pcap",
)


def _main_unit(path: Path, options: ReadingOptions) -> tuple[str, int]:
    """A condition for the slave that was asked most, and how often."""
    asked = Counter(
        (record.link, record.unit)
        for record in Reading([str(path)], options).records()
        if not isinstance(record, WireEvent)
        if record.outcome not in (Outcome.UNSOLICITED, Outcome.BROADCAST)
    )
    ((link, unit), count) = asked.most_common(1)[0]
    return f"link == '{link}' and unit == {unit}", count


def _played(
    path: Path,
    link: LinkSpec,
    to: LinkSpec | None = None,
    options: ReadingOptions | None = None,
    faults: list[Fault] | None = None,
    match: MatchStrategy = MatchStrategy.AUTO,
    rate: Fraction | None = None,
    timeout_ns: int = 1_000_000_000,
) -> tuple[Report, int]:
    """Both sides of a recording's main unit, and how many requests it was asked."""
    options = options or ReadingOptions()
    condition, count = _main_unit(path, options)
    wanted = parse_where(condition)
    recording = SlaveRun(str(path), SlaveOptions(reading=options, wanted=wanted)).recording
    slave: Responder = RecordedSlave(recording, match=match, on_miss=OnMiss.EXCEPTION, rate=rate)
    if faults is not None:
        slave = FaultySlave(slave, faults)
    run = MasterRun(
        str(path),
        MasterOptions(
            reading=options,
            wanted=wanted,
            rate=rate,
            timeout_ns=timeout_ns,
            answers_only=True,
        ),
    )
    with open_shell(link, slave) as shell:
        return run.play(parse_link(shell.place) if to is None else to), count


@pytest.mark.parametrize("name", [*OURS_ON_A_LINE, "fa3-at1m8x-setup.pcap"])
def test_our_recordings_answer_themselves(name: str) -> None:
    report, count = _played(OURS / name, LOOPBACK)
    assert (report.requests, report.different, report.differences) == (count, 0, [])


@pytest.mark.parametrize("name", OURS_ON_A_LINE)
@pytest.mark.parametrize("match", [MatchStrategy.SEQUENCE, MatchStrategy.KEY])
def test_our_recordings_answer_themselves_by_other_ways(name: str, match: MatchStrategy) -> None:
    report, count = _played(OURS / name, LOOPBACK, match=match)
    assert (report.requests, report.different, report.differences) == (count, 0, [])


def test_a_recording_answers_itself_by_time() -> None:
    name = "retry-after-silence.mcap"
    for _ in range(5):  # Both sides keep to the clock; a busy machine may be too late for it.
        report, count = _played(OURS / name, LOOPBACK, match=MatchStrategy.TIME, rate=Fraction(1))
        if not report.different:
            break
    assert (report.requests, report.different, report.differences) == (count, 0, [])


@pytest.mark.parametrize("name", OURS_ON_A_LINE)
@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
def test_our_recordings_answer_themselves_on_a_line(name: str, scheme: str) -> None:
    # A request of the recording that had no response costs the whole timeout. The others have one,
    # however busy the machine is.
    timeout_s = 60 if name == "ft1a-touch-line.mcap" else 2
    with VirtualLine() as line:
        links = [parse_link(f"{scheme}:{port}@115200-8N1") for port in line.ports]
        report, count = _played(
            OURS / name, links[0], links[1], timeout_ns=timeout_s * 1_000_000_000
        )
    assert (report.requests, report.different, report.differences) == (count, 0, [])


def test_rtu_over_tcp_carries_a_recording_too() -> None:
    report, count = _played(OURS / OURS_ON_A_LINE[0], parse_link("rtu+tcp:127.0.0.1:0"))
    assert (report.requests, report.different) == (count, 0)


def test_a_changed_register_is_found_and_only_that() -> None:
    span = Span(Table.INPUT_REGISTERS, 1, 1)
    fault = Fault(kind=FaultKind.OFFSET, match=FaultMatch(span=span))
    report, _ = _played(OURS / OURS_ON_A_LINE[0], LOOPBACK, faults=[fault])
    assert [
        (one.kind, one.reference, one.a.values, one.b.values) for one in report.differences
    ] == [(DifferenceKind.VALUE, "IR300002", [498], [499])]


@pytest.mark.public_captures
@pytest.mark.parametrize("name", PUBLIC)
def test_recordings_of_others_answer_themselves(name: str, public_captures: Path) -> None:
    report, count = _played(public_captures / name, LOOPBACK)
    assert (report.requests, report.different, report.differences) == (count, 0, [])


@pytest.mark.public_captures
def test_a_changed_register_in_a_recording_of_others_is_found(public_captures: Path) -> None:
    path = public_captures / "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap"
    transactions = list(Reading([str(path)], ReadingOptions()).records())
    read = Counter(
        one.address
        for one in transactions
        if not isinstance(one, WireEvent) and one.function == 3 and one.response_values
    )
    address = read.most_common(1)[0][0] or 0
    span = Span(Table.HOLDING_REGISTERS, address, address)
    fault = Fault(kind=FaultKind.OFFSET, by=3, match=FaultMatch(span=span))
    report, _ = _played(path, LOOPBACK, faults=[fault])
    assert [one.reference for one in report.differences] == [f"holding {address}"]
    assert report.different >= read[address]


@pytest.mark.public_captures
@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("ZZ_text_logs/tio__tio/issue226.hex.txt", "rtu@9600-8N1"),
        ("sigrokproject__sigrok-dumps/brainchild-io-16do.bytes.csv", None),
        ("sigrokproject__sigrok-dumps/flowmeter_graph_tool.bytes.csv", None),
        ("derived/noisy_bus_flowmeter.bus.bin", "rtu@9600-8N1"),
    ],
)
def test_serial_recordings_of_others_answer_themselves(
    name: str, line: str | None, public_captures: Path
) -> None:
    options = ReadingOptions(line=None if line is None else parse_line(line))
    with VirtualLine() as virtual:
        links = [parse_link(f"rtu:{port}@115200-8N1") for port in virtual.ports]
        # Each request of these has a response, however busy the machine is.
        path, timeout_ns = public_captures / name, 60_000_000_000
        report, count = _played(path, links[0], links[1], options, timeout_ns=timeout_ns)
    assert (report.requests, report.different, report.differences) == (count, 0, [])
