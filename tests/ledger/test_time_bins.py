"""Counts in bins of time."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.ledger import time_bins
from mbtool.ledger.time_bins import MAX_BINS, LinkSum, TimeBins, UnitSum

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.ledger.time_bins import Row

S = 1_000_000_000
START = 1_700_000_000 * S
HOUR = 3600 * S


def add(row: Row, requests: Iterable[tuple[int, int]]) -> Row:
    """Count requests, of which each has a time (UTC ns) and a latency (ns)."""
    for at_ns, latency_ns in requests:
        cell = row.cell(at_ns)
        cell[UnitSum.REQUESTS] += 1
        cell[UnitSum.LATENCIES] += 1
        cell[UnitSum.LATENCY_NS] += latency_ns
        cell[UnitSum.GREATEST_NS] = max(cell[UnitSum.GREATEST_NS], latency_ns)
    return row


def made(rng: Random, step_ns: int) -> list[tuple[int, int]]:
    """Requests at random distances, a few of them out of order: times and latencies in ns."""
    at_ns, found = START, []
    for _ in range(rng.randrange(1, 3000)):
        at_ns += rng.randrange(step_ns)
        found.append((at_ns - rng.choice((0, 0, 0, step_ns)), rng.randrange(10**7)))
    return found


@pytest.mark.parametrize("step_ns", [10_000, 3_000_000, 10**9, 10**13])
def test_bins_do_not_depend_on_the_order_or_the_way_of_adding(step_ns: int) -> None:
    rng = Random(step_ns)
    requests = made(rng, step_ns)
    one, shuffled, together = (TimeBins().row() for _ in range(3))
    add(one, requests)
    add(shuffled, rng.sample(requests, len(requests)))
    ordered = sorted(requests)
    for cell, begin, end in together.cells_of([at_ns for at_ns, _ in ordered]):
        latencies = [latency_ns for _, latency_ns in ordered[begin:end]]
        cell[UnitSum.REQUESTS] += end - begin
        cell[UnitSum.LATENCIES] += end - begin
        cell[UnitSum.LATENCY_NS] += sum(latencies)
        cell[UnitSum.GREATEST_NS] = max(cell[UnitSum.GREATEST_NS], *latencies)
    assert one.width_ns == shuffled.width_ns == together.width_ns
    assert one.cells == shuffled.cells == together.cells
    assert one.bins() == together.bins()
    assert sum(part.asked for part in one.bins()) == len(requests)
    assert sum(part.latency_ns for part in one.bins()) == sum(ns for _, ns in requests)
    assert len(one.bins()) <= 64
    assert max(cell[UnitSum.GREATEST_NS] for cell in one.cells.values()) == max(
        ns for _, ns in requests
    )


@given(st.lists(st.integers(-(2**63), 2**64), min_size=1, max_size=400))
def test_no_count_is_lost_and_there_are_never_too_many_bins(times: list[int]) -> None:
    every = TimeBins()
    row = add(every.row(), ((at, 0) for at in times))
    assert row.total(UnitSum.REQUESTS) == len(times)
    assert len(row.cells) <= MAX_BINS
    chart = every.chart(300)
    assert sum(chart.column(row, UnitSum.REQUESTS)) == len(times)
    assert 1 <= chart.bins <= 400


def test_a_chart_begins_at_a_multiple_of_its_width() -> None:
    every = TimeBins()
    row = add(every.row(), ((START + second * S + 123, 0) for second in range(60)))
    chart = every.chart(300)
    assert (chart.width_ns, chart.begin_ns) == (S // 5, START)
    assert chart.column(row, UnitSum.REQUESTS) == [1, 0, 0, 0, 0] * 59 + [1]
    fewer = every.chart(8)
    assert (fewer.width_ns, fewer.begin_ns) == (10 * S, START)
    assert fewer.column(row, UnitSum.REQUESTS) == [10] * 6
    assert every.chart(0).bins == 1
    assert TimeBins().chart(300).bins == 0


def test_the_greatest_latency_survives_wider_bins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_bins, "MAX_BINS", 2)
    every = TimeBins()
    latencies = (7, 3, 9, 4)
    row = add(every.row(), ((START + at * S, ns) for at, ns in enumerate(latencies)))
    assert len(row.cells) <= 2
    assert max(every.chart(1).column(row, UnitSum.GREATEST_NS)) == 9


def test_rows_share_the_bins_of_a_chart_whatever_their_own_width() -> None:
    every = TimeBins()
    short, long = every.row(), every.row()
    add(short, ((START + at, 0) for at in range(20)))
    add(long, ((START + at * S, 0) for at in range(3000)))
    assert short.width_ns < long.width_ns
    chart = every.chart(300)
    assert chart.column(short, UnitSum.REQUESTS)[0] == 20
    assert sum(chart.column(long, UnitSum.REQUESTS)) == 3000
    assert chart.column(every.row(), UnitSum.REQUESTS) == [0] * chart.bins


@pytest.mark.parametrize("seed", range(5))
def test_the_number_of_requests_before_a_time_is_right_but_for_a_part_of_a_bin(seed: int) -> None:
    rng = Random(seed)
    requests = made(rng, 10**8)
    row = add(TimeBins().row(), requests)
    most = max(cell[UnitSum.REQUESTS] for cell in row.cells.values())
    for at_ns in rng.choices([at_ns for at_ns, _ in requests], k=50):
        number = sum(other_ns < at_ns for other_ns, _ in requests)
        assert abs(row.asked_before(at_ns) - number) <= most


def test_all_rows_together_have_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_bins, "MAX_CELLS", 1000)
    every = TimeBins()
    rows = [every.row() for _ in range(20)]
    for at in range(500):
        for row in rows:
            add(row, [(START + at * S, 1)])
    assert sum(len(row.cells) for row in rows) <= 1000
    assert {row.total(UnitSum.REQUESTS) for row in rows} == {500}


def test_hours_are_kept_for_a_month_and_then_joined() -> None:
    month, year = TimeBins().row(), TimeBins().row()
    for row, hours in ((month, 24 * 31), (year, 24 * 365)):
        for hour in range(hours):
            row.cell(START + hour * HOUR)[LinkSum.REQUESTS] += 2
            row.cell(START + hour * HOUR)[LinkSum.NO_ANSWER] += 1
        row.cell(START)[LinkSum.BYTES] += 9
    assert [(one.requests, one.missing) for one in month.hours()] == [(2, 1)] * 24 * 31
    begins = [one.begin_ns for one in year.hours()]
    assert begins[1] - begins[0] == 24 * HOUR
    assert sum(one.requests for one in year.hours()) == 2 * 24 * 365
