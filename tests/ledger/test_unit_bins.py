"""Counts of requests in bins of time."""

from __future__ import annotations

from random import Random

import pytest

from mbtool.ledger.unit_bins import MAX_BINS, UnitBins

START_NS = 1_790_000_000_000_000_000


def made(rng: Random, step_ns: int) -> list[tuple[int, int]]:
    """Requests at random distances, a few of them out of order: times and latencies in ns."""
    at_ns, found = START_NS, []
    for _ in range(rng.randrange(1, 3000)):
        at_ns += rng.randrange(step_ns)
        found.append((at_ns - rng.choice((0, 0, 0, step_ns)), rng.randrange(10**7)))
    return found


@pytest.mark.parametrize("step_ns", [10_000, 3_000_000, 10**9, 10**13])
def test_bins_do_not_depend_on_the_order_or_the_way_of_adding(step_ns: int) -> None:
    rng = Random(step_ns)
    requests = made(rng, step_ns)
    one, shuffled, together = UnitBins(), UnitBins(), UnitBins()
    for at_ns, latency_ns in requests:
        one.add(at_ns, latency_ns)
    for at_ns, latency_ns in rng.sample(requests, len(requests)):
        shuffled.add(at_ns, latency_ns)
    middle = len(requests) // 2
    in_order = sorted(requests[middle:])
    for some in (requests[:middle], in_order):
        together.add_answered([at_ns for at_ns, _ in some], [ns for _, ns in some])
    assert one.bins() == shuffled.bins() == together.bins()
    assert sum(part.asked for part in one.bins()) == len(requests)
    assert sum(part.latency_ns for part in one.bins()) == sum(ns for _, ns in requests)
    assert len(one.bins()) <= MAX_BINS


@pytest.mark.parametrize("seed", range(5))
def test_the_number_of_requests_before_a_time_is_right_but_for_a_part_of_a_bin(seed: int) -> None:
    rng = Random(seed)
    requests = made(rng, 10**8)
    bins = UnitBins()
    for at_ns, _ in requests:
        bins.add(at_ns, None)
    most = max(part.asked for part in bins.bins())
    for at_ns in rng.choices([at_ns for at_ns, _ in requests], k=50):
        number = sum(other_ns < at_ns for other_ns, _ in requests)
        assert abs(bins.asked_before(at_ns) - number) <= most
