"""Recordings of a logic analyser that others made on real lines, and the same frames as they would
be heard with one wire, with an echo, or while the settings of the line changed.
"""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat
from mbtool.devices.checking.rules import Severity
from tests.captures import public_folder
from tests.troubles.lines import EXACT, MS, POLLED, START_NS, Sent, judged
from tests.uart import on_the_wire

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.troubles.judge import Judgement

pytestmark = pytest.mark.public_captures

FLOWMETER = SerialFormat(9600, 8, "E", 1)
RECORDINGS = ["flowmeter_target_0liter_per_min", "flowmeter_target0_val0"]
each_recording = pytest.mark.parametrize("name", RECORDINGS)
each_timing = pytest.mark.parametrize("timing", [EXACT, POLLED])


def frames_of(name: str) -> list[Sent]:
    """The frames of a recording in the order of time: request, response, request ..."""
    path = public_folder() / "sigrokproject__sigrok-dumps" / f"{name}.rtu_truth.csv"
    if not path.exists():
        pytest.skip("no captures of others")
    with path.open() as file:
        frames = [
            Sent(START_NS + round(float(row["t_start_s"]) * 1e9), bytes.fromhex(row["hex"]))
            for row in csv.DictReader(file)
        ]
    assert all(one.data[:2] == other.data[:2] for one, other in pairs(frames))
    return frames


def pairs(frames: Sequence[Sent]) -> list[tuple[Sent, Sent]]:
    return [*zip(frames[::2], frames[1::2], strict=True)]


def serious(told: Judgement) -> list[str]:
    return [one.code for one in told.troubles if one.severity is not Severity.NOTE]


@each_recording
@each_timing
def test_the_line_itself_is_well(name: str, timing: str) -> None:
    told = judged(frames_of(name), timing, FLOWMETER)
    assert (told.level, [*told.troubles]) == ("well", [])


@each_recording
@each_timing
@pytest.mark.parametrize(("side", "other"), [("requests", "responses"), ("responses", "requests")])
def test_one_of_the_two_wires_is_told_as_one_side(
    name: str, timing: str, side: str, other: str
) -> None:
    frames = frames_of(name)
    heard = frames[::2] if side == "requests" else frames[1::2]
    told = judged(heard, timing, FLOWMETER)
    assert serious(told) == ["LINE-ONE-SIDE"]
    assert told.troubles[0].cause == f"only {side} are heard at line, no {other}"


@each_recording
@each_timing
def test_an_echo_is_a_note_with_the_number_of_requests(name: str, timing: str) -> None:
    frames = [
        new
        for request, response in pairs(frames_of(name))
        for new in (request, Sent(request.end_ns(FLOWMETER) + MS // 10, request.data), response)
    ]
    frames = [
        Sent(one.at_ns + 12 * MS, one.data) if place % 3 == 2 else one
        for place, one in enumerate(frames)
    ]
    told = judged(frames, timing, FLOWMETER)
    assert serious(told) == []
    echo = next(one for one in told.troubles if one.code == "LINE-ECHO")
    assert len(frames) // 3 - 1 <= echo.count <= len(frames) // 3


@each_recording
@each_timing
@pytest.mark.parametrize(
    "changed", [SerialFormat(19200, 8, "E", 1), SerialFormat(4800, 8, "E", 1)], ids=str
)
def test_a_change_of_the_baud_rate_is_told_with_its_time(
    name: str, timing: str, changed: SerialFormat
) -> None:
    once = frames_of(name)
    length_ns = once[-1].at_ns - once[0].at_ns + 100 * MS
    first, middle, last = (
        [Sent(one.at_ns + turn * length_ns, one.data) for one in once] for turn in range(3)
    )
    other = []
    for one in middle:
        heard = bytes(byte.value for byte in on_the_wire([one.data], changed).heard(FLOWMETER))
        other += [Sent(one.at_ns, heard)] if heard else []
    told = judged([*first, *other, *last], timing, FLOWMETER)
    assert serious(told) == ["LINE-SETTINGS"]
    trouble = told.troubles[0]
    assert trouble.since_ns is not None
    assert trouble.until_ns is not None
    assert abs(trouble.since_ns - middle[0].at_ns) < 1000 * MS
    assert abs(trouble.until_ns - middle[-1].at_ns) < 1000 * MS
