from __future__ import annotations

import pytest

from tests.benchmarks.sensitivity import (
    Sensitivity,
    constants,
    constants_of,
    markdown,
    measured,
    rows,
    variants,
)
from tests.mutants import ROOT

SOURCE = b'''
"""A module."""

COST = 4.0
"""In bits."""
LIMITS = (2.0, 5.5)
_PACE = 1 / 32
NAMES = {"A": 1}
TOLD = "4"
LIKELY = COST + 1.0
is_on = True
OFF = False


class Latency:
    FIRST_NS: int = 200
    quick = 3
'''


def test_upper_case_numbers_of_modules_and_classes_are_constants() -> None:
    found = constants_of("mbtool/serial_line/x.py", SOURCE)
    assert [(one.name, one.value) for one in found] == [
        ("COST", 4.0),
        ("LIMITS[0]", 2.0),
        ("LIMITS[1]", 5.5),
        ("_PACE", 1 / 32),
        ("Latency.FIRST_NS", 200),
    ]
    assert {one.module for one in found} == {"x"}


def test_a_variant_is_the_same_source_with_another_value() -> None:
    limit = constants_of("mbtool/serial_line/x.py", SOURCE)[2]
    assert limit.larger.applied_to(SOURCE) == SOURCE.replace(b"(2.0, 5.5)", b"(2.0, 11.0)")
    assert limit.smaller.applied_to(SOURCE) == SOURCE.replace(b"(2.0, 5.5)", b"(2.0, 2.75)")


@pytest.mark.parametrize(
    ("value", "smaller", "larger"),
    [
        (8, 4, 16),
        (1, 1, 2),
        (3, 1, 6),
        (2.0, 1.0, 4.0),
        (-4.0, -2.0, -8.0),
        (0.25, 0.125, 0.5),
        (0.98, 0.96, 0.99),
        (0, -1, 1),
    ],
)
def test_a_value_is_made_smaller_and_larger(value: float, smaller: float, larger: float) -> None:
    assert variants(value) == (smaller, larger)


def test_the_costs_are_among_the_constants() -> None:
    assert len([one for one in constants() if one.module == "costs"]) > 20


def test_what_changes_is_told_and_what_does_not_is_told_so() -> None:
    cost, *_ = constants_of("mbtool/serial_line/costs.py", SOURCE)
    none = {"found": 0, "false": 0}
    assert rows(
        [
            Sensitivity(cost, none, none),
            Sensitivity(cost, {"found": -3, "false": 1}, none),
            Sensitivity(cost, none, None),
        ]
    ) == [
        ("COST", "costs", "4", "nothing changes", ""),
        ("COST", "costs", "4", "2: found -3, false +1", "8: -"),
        ("COST", "costs", "4", "2: -", "8: fails"),
    ]
    assert markdown([Sensitivity(cost, none, none)]).splitlines()[-1] == (
        "| `COST` | costs | 4 | nothing changes |  |"
    )


def test_the_benchmark_runs_with_each_value_in_a_copy_of_the_tree() -> None:
    (beam,) = [one for one in constants() if (one.module, one.name) == ("search", "BEAM_WIDTH")]
    before = (ROOT / beam.smaller.path).read_bytes()
    base, (found,) = measured([beam], transactions=5, seeds=[1], jobs=2)
    assert base["found"] > 0
    assert found.smaller is not None
    assert found.larger is not None
    assert found.smaller.keys() == base.keys()
    assert (ROOT / beam.smaller.path).read_bytes() == before
