from __future__ import annotations

import pytest

from mbtool.replay.timeline import TimeRange


@pytest.mark.parametrize(
    ("window", "inside", "says"),
    [
        (TimeRange(), [0, 5, 10], "from 0 s on"),
        (TimeRange(5), [5, 10], "from 5e-09 s on"),
        (TimeRange(0, 5), [0], "from 0 s to 5e-09 s"),
        (TimeRange(5, 10), [5], "from 5e-09 s to 1e-08 s"),
        (TimeRange(1_500_000_000, 2_000_000_000), [], "from 1.5 s to 2 s"),
    ],
)
def test_a_time_range_includes_its_beginning_and_not_its_end(
    window: TimeRange, inside: list[int], says: str
) -> None:
    assert [place for place in (0, 5, 10) if place in window] == inside
    assert str(window) == says
