from __future__ import annotations

from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.checking.security_limits import SecurityLimit
from mbtool.devices.checking.sliding_window import KEPT_RATIO, SlidingWindow

if TYPE_CHECKING:
    from collections.abc import Sequence

numbers = st.integers(1, 6)
spans = st.integers(0, 20)
times = st.lists(st.integers(0, 100), max_size=40)


def in_full_windows(times: Sequence[int], number: int, span: int) -> list[int]:
    """The cases that are in a full window, found by trying each window."""
    times = sorted(times)
    cases: set[int] = set()
    for begin in range(len(times) - number + 1):
        if times[begin + number - 1] - times[begin] <= span:
            cases.update(range(begin, begin + number))
    return [times[place] for place in sorted(cases)]


def counted(times: Sequence[int], number: int, span: int) -> tuple[int, int | None]:
    window = SlidingWindow(SecurityLimit(number, span))
    return sum(window.add(at_ns) for at_ns in times), window.first_ns


@given(times, numbers, spans)
def test_cases_in_order_are_counted_if_a_full_window_has_them(
    times: list[int], number: int, span: int
) -> None:
    expected = in_full_windows(times, number, span)
    first = expected[0] if expected else None
    assert counted(sorted(times), number, span) == (len(expected), first)


@given(times, numbers, spans)
def test_cases_out_of_order_are_counted_if_and_only_if_a_window_is_full(
    times: list[int], number: int, span: int
) -> None:
    times = times[: KEPT_RATIO // 2 * number]  # No more than are kept for certain.
    found, first = counted(times, number, span)
    assert bool(found) == bool(in_full_windows(times, number, span))
    assert found <= len(times)
    assert (first is None) == (found == 0)


@given(numbers.filter(lambda number: number > 1), spans)
def test_one_case_less_than_the_limit_is_nothing(number: int, span: int) -> None:
    assert counted([50] * (number - 1), number, span) == (0, None)
    assert counted([50] * number, number, span) == (number, 50)


def test_a_window_contains_both_its_ends() -> None:
    assert counted([0, 10], 2, 10) == (2, 0)
    assert counted([0, 11], 2, 10) == (0, None)


def test_memory_is_bounded() -> None:
    window = SlidingWindow(SecurityLimit(10, 5))
    for at_ns in range(100_000):
        window.add(at_ns)
    assert len(window._times) < KEPT_RATIO * 10
