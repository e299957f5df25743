"""Sets of addresses as ranges."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from mbtool.ledger.inventory_ranges import (
    MAX_RANGES,
    AddressRanges,
    joined_ranges,
    listed,
    ranges_text,
    without,
)

RANGES = st.lists(
    st.tuples(st.integers(0, 60), st.integers(0, 12)).map(lambda one: (one[0], one[0] + one[1]))
)


def addresses(ranges: list[tuple[int, int]]) -> set[int]:
    return {address for first, last in ranges for address in range(first, last + 1)}


@given(RANGES)
def test_a_set_holds_what_was_added_in_as_few_ranges_as_can_be(
    added: list[tuple[int, int]],
) -> None:
    pairs = AddressRanges(added).pairs
    assert addresses(pairs) == addresses(added)
    assert pairs == sorted(pairs)
    assert all(before[1] + 1 < after[0] for before, after in pairwise(pairs))


@given(RANGES, RANGES)
def test_a_set_without_another_is_the_difference(
    one: list[tuple[int, int]], other: list[tuple[int, int]]
) -> None:
    left = without(AddressRanges(one).pairs, AddressRanges(other).pairs)
    assert addresses(left) == addresses(one) - addresses(other)


def test_several_sets_are_joined() -> None:
    assert joined_ranges([[(0, 3)], [(4, 9), (20, 20)], []]) == [(0, 9), (20, 20)]


def test_addresses_behind_the_last_one_do_not_exist() -> None:
    assert AddressRanges([(0xFFF0, 0x1000F), (0x10000, 0x10002)]).pairs == [(0xFFF0, 0xFFFF)]


def test_a_set_that_is_full_counts_what_it_does_not_take() -> None:
    ranges = AddressRanges((2 * at, 2 * at) for at in range(MAX_RANGES + 5))
    assert (len(ranges.pairs), ranges.left_out) == (MAX_RANGES, 5)
    ranges.add(1, 1)  # It joins two ranges, and so needs no room.
    assert len(ranges.pairs) == MAX_RANGES - 1


def test_a_long_list_names_some_and_counts_the_others() -> None:
    assert ranges_text([(0, 99), (200, 200)]) == "0..99, 200"
    assert ranges_text([(at, at) for at in range(0, 8, 2)], 2) == "0, 2 and 2 more"
    assert listed([]) == ""
