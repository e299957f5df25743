"""By how much values may differ from the recorded ones."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from mbtool.core import UsageError
from mbtool.devices import Assignments, Namer, Profile, load_profile, parse_assignment
from mbtool.replay.judging import ResponseJudge
from mbtool.replay.script import Script, Step
from mbtool.replay.tolerances import Tolerances
from tests.replay.recorded import MS, answered

if TYPE_CHECKING:
    from pathlib import Path

METER = """
name = "meter"
title = "A meter"
vendor = "Maker"
transports = ["rtu"]
source = "its manual"

[functions]
03 = {}

[[areas]]
name = "data"
table = "holding_registers"
first = 0
last = 99
access = "r"

[[points]]
name = "Temperature"
table = "holding_registers"
address = 0
type = "float32"
unit = "degC"

[[points]]
name = "Setpoint"
table = "holding_registers"
address = 2
type = "int16"
scale = 0.1

[[points]]
name = "Energy"
table = "holding_registers"
address = 3
type = "uint32"

[[points]]
name = "Phase {n}"
table = "holding_registers"
address = 10
count = 3
"""
READ_ALL = "03 0000 0006"


def _words(temperature: float, setpoint: int, energy: int, spare: int) -> str:
    data = struct.pack(">fhIH", temperature, setpoint, energy, spare)
    return f"03 0C {data.hex()}"


RECORDED = _words(21.0, 215, 70_000, 7)


@pytest.fixture
def meter(tmp_path: Path) -> Profile:
    path = tmp_path / "meter.toml"
    path.write_text(METER)
    return load_profile(str(path))


@pytest.fixture
def step(tmp_path: Path, meter: Profile) -> Step:
    assert meter.name == "meter"
    namer = Namer(Assignments([parse_assignment(f"all={tmp_path / 'meter.toml'}")]))
    (one,) = Script.of([namer.name(answered(0, READ_ALL, RECORDED))]).steps
    return one


def _wrong(step: Step, meter: Profile, answer: str, *texts: str) -> list[str | None]:
    """The registers that differ beyond what the texts tolerate."""
    judge = ResponseJudge(profiles={"meter": meter}, values=Tolerances(texts, {"meter": meter}))
    judge.judge(step, bytes.fromhex(answer), 5 * MS)
    return [one.reference for one in judge.differences()]


@pytest.mark.parametrize(
    "text", ["Temperature=0.5", "temperature=0.5", "FLOAT32=2.5%", "holding 0..1=0.5"]
)
def test_a_point_may_differ_by_an_amount(step: Step, meter: Profile, text: str) -> None:
    for temperature, is_right in ((21.5, True), (20.5, True), (21.6, False), (20.3, False)):
        found = _wrong(step, meter, _words(temperature, 215, 70_000, 7), text)
        assert (found == []) is is_right, temperature


def test_an_amount_is_in_the_unit_of_the_point(step: Step, meter: Profile) -> None:
    assert _wrong(step, meter, _words(21.0, 219, 70_000, 7), "Setpoint=0.4") == []
    assert _wrong(step, meter, _words(21.0, 220, 70_000, 7), "Setpoint=0.4") == ["2"]


def test_registers_of_a_range_that_are_no_point_are_numbers(step: Step, meter: Profile) -> None:
    # 21.0 and 21.00001 differ by 5 in their second register, which is no number of its own.
    other = _words(21.00001, 215, 70_000, 9)
    assert _wrong(step, meter, other, "holding 0..5=2") == []
    assert _wrong(step, meter, other, "holding 1..5=2") == ["1"]
    assert _wrong(step, meter, other, "holding 5=1") == ["1", "5"]


def test_a_value_that_is_no_number_is_never_tolerated(step: Step, meter: Profile) -> None:
    assert _wrong(step, meter, _words(float("nan"), 215, 70_000, 7), "Temperature=1000") != []


def test_a_counter_may_grow_and_begin_again_and_not_run_back(step: Step, meter: Profile) -> None:
    judge = ResponseJudge(
        profiles={"meter": meter}, values=Tolerances(["Energy=counter"], {"meter": meter})
    )
    told = [
        judge.judge(step, bytes.fromhex(_words(21.0, 215, energy, 7)), 5 * MS)
        for energy in (80_000, 90_000, 90_000, 70_000, 4_294_967_290, 3)
    ]
    assert told == [True, True, True, False, True, True]
    assert [one.reference for one in judge.differences()] == ["3", "4"]


def test_the_last_text_for_a_point_counts(step: Step, meter: Profile) -> None:
    other = _words(22.0, 215, 70_000, 7)
    assert _wrong(step, meter, other, "float32=0.1", "Temperature=2") == []
    assert _wrong(step, meter, other, "Temperature=2", "float32=0.1") != []


def test_a_series_is_named_as_a_whole_or_by_one_of_its_points(meter: Profile) -> None:
    for text, count in (("Phase {n}=1", 3), ("Phase 2=1", 1)):
        values = Tolerances([text], {"meter": meter})
        right, _ = values.judged(
            1, "meter", meter.points[0].table, range(10, 13), [5, 5, 5], [6, 6, 6]
        )
        assert len(right) == count


def test_without_a_profile_a_range_is_of_numbers(meter: Profile) -> None:
    values = Tolerances(["holding 10..11=1"], {})
    right, wrong = values.judged(
        1, None, meter.points[0].table, range(10, 13), [5, 5, 5], [6, 7, 6]
    )
    assert (right, wrong) == ({10}, set())


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("Temperature", "write NAME=AMOUNT"),
        ("Temperature=warm", "write NAME=AMOUNT"),
        ("Temperature=-1", "write NAME=AMOUNT"),
        ("=1", "write NAME=AMOUNT"),
        ("Pressure=1", "no point or type of that name"),
        ("float64=1", "no point or type of that name"),
    ],
)
def test_a_text_that_says_nothing_is_refused(meter: Profile, text: str, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        Tolerances([text], {"meter": meter})
