from __future__ import annotations

import pytest

from mbtool.core.moments import duration, in_ms, in_s, percent
from mbtool.views.statistics_columns import per_second

MS, S = 1e6, 1e9


@pytest.mark.parametrize(
    ("ns", "text"),
    [(0, "0.00"), (250_000, "0.25"), (8.24 * MS, "8.2"), (82.06 * MS, "82.1"), (1.24 * S, "1240")],
)
def test_milliseconds_have_the_digits_that_matter(ns: float, text: str) -> None:
    assert in_ms(ns) == text


@pytest.mark.parametrize(
    ("ns", "text"), [(0.2511 * S, "0.251"), (9.9996 * S, "10.00"), (3600 * S, "3600")]
)
def test_seconds_have_the_digits_that_matter(ns: float, text: str) -> None:
    assert in_s(ns) == text


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (8.2 * MS, "8.2 ms"), (1.024 * S, "1.02 s"), (59.94 * S, "59.9 s"), (60 * S, "1 min"),
        (123 * S, "2 min 3 s"), (11_520 * S, "3 h 12 min"), (183_600 * S, "2 d 3 h"),
        (2.88e8 * S, "3,333 d 8 h"), (59.97 * S, "60.0 s"),
    ],
)  # fmt: skip
def test_a_duration_has_its_unit(ns: float, text: str) -> None:
    assert duration(ns) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0, "0 %"), (0.0001, "<0.1 %"), (0.034, "3.4 %"), (0.34, "34 %"), (0.996, "99.6 %"),
        (0.9999, ">99.9 %"), (1, "100 %"),
    ],
)  # fmt: skip
def test_a_share_is_never_rounded_to_none_or_all(share: float, text: str) -> None:
    assert percent(share) == text


@pytest.mark.parametrize(
    ("rate", "text"), [(None, "-"), (2041.2, "2041"), (39.14, "39.1"), (0.25, "0.25")]
)
def test_a_rate_is_short(rate: float | None, text: str) -> None:
    assert per_second(rate) == text
