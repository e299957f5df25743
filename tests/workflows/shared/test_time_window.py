"""The part of a capture that --start and --end name."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.workflows.shared.time_window import TimeWindow
from tests.logs.samples import EVENT, START_NS, transaction

MS = 1_000_000


def numbers(start: str | None, end: str | None) -> list[int]:
    """Which of four reads, a millisecond apart, are in the window. The second completes first."""
    window = TimeWindow.parse(start, end)
    reads = [transaction(number) for number in (1, 0, 2, 3)]
    kept = [one for one in window.begun(reads) if one in window]
    return sorted((one.start_ns - START_NS) // MS for one in kept if one in reads)


@pytest.mark.parametrize(
    ("start", "end", "kept"),
    [
        (None, None, [0, 1, 2, 3]),
        ("0", None, [0, 1, 2, 3]),
        ("1ms", None, [1, 2, 3]),
        (None, "0.002", [0, 1]),
        ("1ms", "3ms", [1, 2]),
        ("2023-11-14T22:13:20.001", None, [1, 2, 3]),
        (None, "2023-11-14T22:13:20.001", [0]),
        ("1ms", "2023-11-14T22:13:20.003", [1, 2]),
        ("1h", None, []),
    ],
)
def test_what_begins_in_the_window_is_in_it_and_its_end_is_not(
    start: str | None, end: str | None, kept: list[int]
) -> None:
    assert numbers(start, end) == kept


def test_an_event_is_in_the_window_by_its_time() -> None:
    window = TimeWindow.parse("2023-11-14T22:13:20", "2023-11-14T22:13:21")
    assert EVENT in window


def test_a_live_capture_is_not_held() -> None:
    window = TimeWindow.parse("0", None)
    records = window.begun(iter([transaction(0), transaction(1)]), at_once=True)
    assert next(records) == transaction(0)


@pytest.mark.parametrize(
    ("start", "end"), [("2", "1"), ("1s", "1000ms"), ("2026-01-02", "2026-01-01")]
)
def test_an_end_that_is_not_after_the_start_is_refused(start: str, end: str) -> None:
    with pytest.raises(UsageError, match=f"--end {end}: is not after --start {start}"):
        TimeWindow.parse(start, end)
