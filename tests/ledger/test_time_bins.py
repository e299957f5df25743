from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.ledger.time_bins import GREATEST, LEAST, MAX_BINS, TimeBins, note_value

S = 1_000_000_000
START = 1_700_000_000 * S


def test_a_bin_begins_at_a_multiple_of_its_width() -> None:
    bins = TimeBins(1)
    for second in range(60):
        bins.bin("row", START + second * S + 123)[0] += 1
    assert bins.width_ns == S // 5
    assert bins.begin_ns == START
    assert bins.column("row", 0) == [1, 0, 0, 0, 0] * 59 + [1]


@given(st.lists(st.integers(0, 10**18), min_size=1, max_size=50))
def test_no_count_is_lost_and_there_are_never_too_many_bins(times: list[int]) -> None:
    bins = TimeBins(1)
    for at in times:
        bins.bin("row", at)[0] += 1
    assert sum(bins.column("row", 0)) == len(times)
    assert 1 <= bins.count <= MAX_BINS


def test_fewer_bins_have_the_same_sums_and_bounds_at_multiples_of_their_width() -> None:
    bins = TimeBins(1)
    for place in range(40):
        note_value(bins.bin("row", START + place * S // 10), place + 1)
        bins.bin("row", START + place * S // 10)[0] += 1
    fewer = bins.coarser(8)
    assert (fewer.width_ns, fewer.begin_ns) == (S, START)
    assert fewer.column("row", 0) == [10, 10, 10, 10]
    assert fewer.column("row", GREATEST) == [10, 20, 30, 40]
    assert bins.column("row", 0).count(1) == 40
    assert bins.coarser(bins.count) is bins
    assert bins.coarser(0).count == 1


def test_times_before_the_first_one_have_bins_too() -> None:
    bins = TimeBins(1)
    for second in (50, 10, 30):
        bins.bin("row", START + second * S)[0] += second
    counts = {place: count for place, count in enumerate(bins.column("row", 0)) if count}
    first = (START + 10 * S) // bins.width_ns
    assert bins.begin_ns == first * bins.width_ns
    assert {(first + place) * bins.width_ns // S: n for place, n in counts.items()} == {
        1_700_000_010: 10,
        1_700_000_030: 30,
        1_700_000_050: 50,
    }


def test_the_least_and_the_greatest_value_survive_wider_bins() -> None:
    bins = TimeBins(0)
    for number, value in enumerate((7, 3, 9)):
        note_value(bins.bin("row", START + number * S // 1000), value)
    bins.bin("row", START + 86_400 * S)
    assert bins.column("row", LEAST)[0] == 3
    assert bins.column("row", GREATEST)[0] == 9


def test_rows_share_their_bins() -> None:
    bins = TimeBins(1)
    bins.bin("one", START)[0] += 1
    bins.bin("other", START + 3600 * S)[0] += 1
    assert len(bins.column("one", 0)) == len(bins.column("other", 0)) == bins.count
    assert bins.column("none", 0) == [0] * bins.count
