"""The moments that a user writes."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import UsageError
from mbtool.core.moments import TimePoint, parse_duration, parse_iso, parse_moment

S = 1_000_000_000
NINE = 1_795_338_843 * S
"""2026-11-22T09:14:03 UTC."""


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("0", 0),
        ("90", 90 * S),
        ("2.5", 5 * S // 2),
        ("90s", 90 * S),
        ("1h30m", 5400 * S),
        ("1d", 86_400 * S),
        ("250ms", S // 4),
        ("1m5s250ms", 65 * S + S // 4),
        ("1.5h", 5400 * S),
    ],
)
def test_a_time_since_the_beginning_has_units_or_is_seconds(text: str, ns: int) -> None:
    assert parse_moment(text, "--start") == TimePoint(ns, is_absolute=False)


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("2026-11-22T09:14:03", NINE),
        ("2026-11-22T09:14:03Z", NINE),
        ("2026-11-22 09:14:03.201000001", NINE + 201_000_001),
        ("2026-11-22T10:14:03+01:00", NINE),
        ("2026-11-22T09:14", NINE - 3 * S),
        ("1970-01-01", 0),
    ],
)
def test_a_moment_is_iso_8601_and_utc_without_a_zone(text: str, ns: int) -> None:
    assert parse_moment(text, "--end") == TimePoint(ns, is_absolute=True)


@pytest.mark.parametrize(
    "text", ["", "-1", "soon", "1h30", "1x", "nan", "1e9", "..s", "2026-13-01", "2026-11-22T25:00"]
)
def test_other_texts_are_refused_in_one_line(text: str) -> None:
    with pytest.raises(UsageError, match=r"--start .*: write seconds") as told:
        parse_moment(text, "--start")
    assert "\n" not in str(told.value)


@given(st.text(max_size=40))
def test_no_text_raises_anything_else(text: str) -> None:
    parse_iso(text)
    try:
        parse_moment(text, "--start")
    except UsageError:
        return


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0.5ms", "--every 0.5ms: is shorter than 1 ms, the least"),
        ("49h", "--every 49h: is longer than 2 days, the most"),
        ("1us", "--every '1us': write a time such as 2.5 (seconds), 250ms or 1h30m"),
        ("2026-01-01", "--every '2026-01-01': write a time such as"),
    ],
)
def test_a_duration_out_of_range_is_told_the_range(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=re.escape(said)):
        parse_duration(text, "--every", 1_000_000, 2 * 86_400 * 10**9)
    assert parse_duration("1h30m", "--every", 0, 10**15) == 5400 * 10**9
