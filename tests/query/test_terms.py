"""The names of the --where language."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mbtool.modbus import Outcome
from mbtool.query.terms import NAMES, ValueKind, why_never_true
from tests.logs.samples import NAMED, transaction

PAGE = Path(__file__).resolve().parents[2] / "docs" / "filters.md"
EMPTY = transaction(
    source=None,
    destination=None,
    address=None,
    quantity=None,
    request_values=None,
    response_values=None,
    latency_ns=None,
)
PYTHON = {
    ValueKind.NUMBER: int | float,
    ValueKind.TEXT: str,
    ValueKind.LIST: list,
    ValueKind.MOMENT: int,
}


@pytest.mark.parametrize("name", NAMES)
def test_a_value_has_the_kind_of_its_name_or_does_not_apply(name: str) -> None:
    term = NAMES[name]
    for one in (NAMED, EMPTY):
        value = term.value(one)
        assert value is None or isinstance(value, PYTHON[term.kind])
        for item in value if isinstance(value, list) else ():
            assert isinstance(item, PYTHON[term.items[0].kind])
        if term.choices and value is not None:
            assert value in term.choices


@pytest.mark.parametrize("name", NAMES)
def test_a_name_can_be_compared_with_itself(name: str) -> None:
    assert why_never_true(NAMES[name], NAMES[name], membership=False) is None


def test_outcome_can_be_compared_with_each_of_its_values() -> None:
    assert NAMES["outcome"].choices == tuple(Outcome)


def test_the_readme_has_every_name_and_no_other() -> None:
    _, _, behind = PAGE.read_text(encoding="utf-8").partition("The names are ")
    sentence, _, _ = behind.partition(". ")
    assert set(re.findall(r"`([a-z_-]+)`", sentence)) == {*NAMES, *Outcome}
