"""Holds the recordings of serial lines made by others against their truth, in every form."""

# NAME.rtu_truth.csv has the frames of a recording as a logic analyser saw them. The same bytes are
# there with their times, bare, and in packets of link types 147 and 250. What a frame was answered
# with follows from the line having two wires (brainchild), or from one exchange after the other.

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, WireEvent, parse_line
from mbtool.modbus import Outcome
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.printed_frames import as_byte_times

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices import NamedTransaction

SIGROK = "sigrokproject__sigrok-dumps"
RECORDINGS = {
    "brainchild-io-16do": "rtu@19200-8E1",
    "flowmeter_target_0liter_per_min": "rtu@9600-8E1",
    "flowmeter_graph_tool": "rtu@9600-8E1",
    "flowmeter_target0_val0": "rtu@9600-8E1",
}
FORMS = [
    ("bytes.csv", False),
    ("bytes.csv", True),
    ("bus.bin", True),
    ("user0.pcap", False),
    ("user0.pcap", True),
    ("rtac.pcap", False),
    ("rtac.pcap", True),
]
"""Whether --link is given beside each form; what has no times and no line needs it."""

pytestmark = pytest.mark.public_captures


def _read(path: Path, line: str | None) -> tuple[list[NamedTransaction], list[WireEvent]]:
    options = ReadingOptions(line=None if line is None else parse_line(line))
    records = list(Reading([str(path)], options).records())
    return (
        [record for record in records if not isinstance(record, WireEvent)],
        [record for record in records if isinstance(record, WireEvent)],
    )


def _frames(transactions: list[NamedTransaction]) -> list[str]:
    sides = ((one.request_raw, one.response_raw) for one in transactions)
    return [raw.hex() for pair in sides for raw in pair if raw is not None]


def _truth(path: Path) -> list[str]:
    with path.open(newline="") as file:
        return [row["hex"] for row in csv.DictReader(file) if row["crc_ok"] == "1"]


@pytest.mark.parametrize(("form", "is_told"), FORMS)
@pytest.mark.parametrize("name", RECORDINGS)
def test_every_frame_of_a_recording_is_found_and_answered(
    public_captures: Path, name: str, form: str, is_told: bool
) -> None:
    folder = public_captures / SIGROK
    line = RECORDINGS[name] if is_told else None
    transactions, events = _read(folder / f"{name}.{form}", line)
    assert _frames(transactions) == _truth(folder / f"{name}.rtu_truth.csv")
    assert {one.outcome for one in transactions} == {Outcome.OK}
    assert events == []


@pytest.mark.parametrize("name", RECORDINGS)
def test_the_samples_of_the_analyser_give_what_its_byte_times_give(
    public_captures: Path, name: str
) -> None:
    folder = public_captures / SIGROK
    (signal, _), (bytes_, _) = (
        _read(folder / f"{name}.{form}", None) for form in ("sr", "bytes.csv")
    )
    assert _frames(signal) == _truth(folder / f"{name}.rtu_truth.csv")
    for one, other in zip(signal, bytes_, strict=True):
        assert one.outcome is other.outcome is Outcome.OK
        assert one.latency_ns is not None
        assert other.latency_ns is not None
        assert (
            abs(one.latency_ns - other.latency_ns) < 125_000
        )  # Byte times do not tell 8N1 from 8E1: a bit.


def test_the_direction_is_that_of_the_wire(public_captures: Path) -> None:
    folder = public_captures / SIGROK
    transactions, _ = _read(folder / "brainchild-io-16do.bytes.csv", None)
    with (folder / "brainchild-io-16do.rtu_truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    sent = [row["hex"] for row in rows if row["line"] == "tx"]
    assert [one.request_raw.hex() for one in transactions if one.request_raw] == sent


@pytest.mark.parametrize(("form", "is_told"), FORMS[:3])
def test_every_frame_of_a_noisy_line_is_found(
    public_captures: Path, form: str, is_told: bool
) -> None:
    line = "rtu@9600-8E1" if is_told else None
    folder = public_captures / "derived"
    transactions, events = _read(folder / f"noisy_bus_flowmeter.{form}", line)
    truth = _truth(public_captures / SIGROK / "flowmeter_graph_tool.rtu_truth.csv")
    assert _frames(transactions) == truth
    assert {one.outcome for one in transactions} == {Outcome.OK}
    stray = b"".join(event.raw for event in events)
    assert set(stray) <= set(bytes.fromhex("00 f8 fe fc"))
    assert len(stray) == (folder / "noisy_bus_flowmeter.bus.bin").stat().st_size - len(
        bytes.fromhex("".join(truth))
    )


def test_a_hexadecimal_log_without_times_is_transactions(public_captures: Path) -> None:
    path = public_captures / "ZZ_text_logs" / "tio__tio" / "issue226.hex.txt"
    transactions, events = _read(path, "rtu@9600-8N1")
    assert {(one.unit, one.function, one.address, one.quantity) for one in transactions} == {
        (1, 3, 0x180, 10)
    }
    assert {one.outcome for one in transactions} == {Outcome.OK}
    assert len(transactions) == 10
    assert b"".join(event.raw for event in events) == bytes.fromhex("01 03 01")  # It ends there.


def test_a_recording_printed_by_another_program_is_transactions(
    public_captures: Path, tmp_path: Path
) -> None:
    printed = public_captures / "ZZ_text_logs" / "otti__FroniusModbusRtu" / "20230228_record.txt"
    path = tmp_path / "record.csv"
    path.write_text(as_byte_times(printed.read_text()))
    transactions, events = _read(path, "rtu@19200-8E1")
    # The program that printed the frames stamped some of them a little too early.
    assert {one.kind for one in events} <= {EventKind.DISORDER}
    assert len(transactions) == 38
    assert {one.outcome for one in transactions} == {Outcome.OK}
    assert {(one.address, one.quantity) for one in transactions} == {
        (258, 16),
        (286, 42),
        (1024, 16),
    }
    values = transactions[0].response_values
    assert values is not None
    assert values[:5] == [2376, 0, 4115, 0, 28]
