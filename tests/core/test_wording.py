from __future__ import annotations

import pytest

from mbtool.core.moments import counted, milliseconds, plural


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 bytes"), (1, "1 byte"), (2, "2 bytes"), (12345, "12,345 bytes")]
)
def test_only_a_count_of_one_takes_the_singular(count: int, text: str) -> None:
    assert counted(count, "byte") == text


def test_a_comma_groups_the_thousands_of_a_count() -> None:
    assert counted(1_234_567, "request", ",") == "1,234,567 requests"
    assert counted(1, "request", ",") == "1 request"


def test_the_noun_of_a_count_can_be_had_alone() -> None:
    assert [plural(count, "unit") for count in (0, 1, 2)] == ["units", "unit", "units"]


@pytest.mark.parametrize(
    ("ns", "text"),
    [(0, "0.0 ms"), (8_249_999, "8.2 ms"), (9_999_000_000, "9999.0 ms"), (1.5e6, "1.5 ms")],
)
def test_a_duration_is_written_in_milliseconds_with_one_decimal(ns: float, text: str) -> None:
    assert milliseconds(ns) == text
