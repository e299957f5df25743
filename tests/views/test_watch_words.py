"""Short texts of live tables."""

from __future__ import annotations

import pytest

from mbtool.views.watch_words import age, change_style, count, period, sparkline

S = 1_000_000_000


@pytest.mark.parametrize(
    ("ns", "text"),
    [(-5, "0.0s"), (0.44 * S, "0.4s"), (9.9 * S, "9.9s"), (9.96 * S, "10s"), (99 * S, "99s"),
     (100 * S, "2m"), (99 * 60 * S, "99m"), (2 * 3600 * S, "2h"), (5 * 86400 * S, "5d")],
)  # fmt: skip
def test_an_age_has_at_most_four_characters(ns: float, text: str) -> None:
    assert age(int(ns)) == text


@pytest.mark.parametrize(
    ("ns", "text"),
    [(0, "-"), (8_200_000, "8ms"), (999 * S // 1000, "999ms"), (S, "1.00s"), (12 * S, "12.0s"),
     (1200 * S, "20m")],
)  # fmt: skip
def test_a_period_has_at_most_five_characters(ns: int, text: str) -> None:
    assert period(ns) == text


@pytest.mark.parametrize(
    ("number", "text"),
    [(0, ""), (99_999, "99999"), (123_456, "123k"), (12_340_000, "12.3M"), (123_400_000, "123M")],
)
def test_a_count_has_at_most_five_characters(number: int, text: str) -> None:
    assert count(number) == text


def test_a_sparkline_goes_from_the_least_to_the_greatest() -> None:
    assert sparkline([0, 7, None, 3.5], 8) == "▁█x▅"
    assert sparkline([5, 5], 8) == "▁▁"
    assert sparkline([None], 8) == "x"
    assert sparkline([1, 2, 3], 2) == "▁█"
    assert sparkline([float("nan"), float("inf"), 1], 3) == "xx▁"


def test_a_change_fades() -> None:
    assert change_style(0, 10 * S) == ""
    assert change_style(10 * S, 10 * S) == "bold reverse"
    assert change_style(8 * S, 10 * S) == "bold yellow"
    assert change_style(1 * S, 10 * S) == ""
