"""Finds the units that became slower, and the time since when they are slower."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeVar

from mbtool.core.moments import DAY_NS
from mbtool.troubles.slow_units import ENOUGH_ANSWERS, slow_units

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.ledger.distribution import Distribution
    from mbtool.ledger.time_bins import UnitBin
    from mbtool.ledger.unit_account import UnitAccount

K = TypeVar("K")

SLOWER = 2
"""A unit has become slower if its mean latency in the last quarter of its bins of time is at least
this many times that in the first half, and at least SLOWER_NS more."""
SLOWER_NS = 10_000_000
_ENOUGH_BINS = 8
"""A unit with answers in fewer bins than this is never said to have become slower."""


class Slower(NamedTuple):
    """The time from which a unit answers slower, and its mean latencies before and since."""

    since_ns: int
    """The time (UTC ns), exact to a bin."""
    mean_ns: float
    """The mean latency since then, in ns."""
    before_ns: float
    """The mean latency before, in ns."""
    is_long: bool
    """True if the unit was heard for a day or longer, so that times need a date."""

    @property
    def factor(self) -> float:
        """The mean latency since then, divided by that before."""
        return self.mean_ns / (self.before_ns or 1)


def slow_and_slower_units(
    latencies: Mapping[K, Distribution], times: Mapping[K, UnitAccount]
) -> tuple[dict[K, float], dict[K, Slower]]:
    """Return the units that always were slow, as slow_units does, and those that became slower.

    `latencies` and `times` have the latencies and the times of the requests of each unit.
    """
    found = {unit: became_slower(one.bins.bins()) for unit, one in times.items()}
    slower = {unit: one for unit, one in found.items() if one is not None and unit in latencies}
    slow = slow_units(latencies)
    return {unit: usual for unit, usual in slow.items() if unit not in slower}, slower


def became_slower(bins: Sequence[UnitBin]) -> Slower | None:
    """Return since when a unit is slower (SLOWER); None if it is not, or not any more.

    `bins` are the unit's, sorted by time.
    """
    bins = [one for one in bins if one.answered]
    if len(bins) < _ENOUGH_BINS:
        return None
    half = len(bins) // 2
    usual_ns, late_ns = _mean(bins[:half]), _mean(bins[-len(bins) // 4 :])
    if late_ns < max(SLOWER * usual_ns, usual_ns + SLOWER_NS):
        return None
    middle_ns = (usual_ns + late_ns) / 2
    fast = (at for at, one in enumerate(bins) if _mean([one]) < middle_ns)
    first = max(fast, default=-1) + 1
    since = bins[first:]
    is_over = len(since) < len(bins) // 8  # The unit became fast again.
    if not first or is_over or sum(one.answered for one in since) < ENOUGH_ANSWERS:
        return None

    def slow_ns(one: UnitBin) -> int:
        """Return for how much of a bin the unit was slow, by the bin's mean."""
        share = (_mean([one]) - usual_ns) / (late_ns - usual_ns)
        return round(min(max(share, 0), 1) * (one.end_ns - one.begin_ns))

    since_ns = since[0].end_ns - slow_ns(since[0])
    if bins[first - 1].end_ns == since[0].begin_ns == since_ns:
        since_ns -= slow_ns(bins[first - 1])
    is_long = bins[-1].end_ns - bins[0].begin_ns >= DAY_NS
    # Leave out the last bin before the slow ones, because the unit may have become slower in it.
    # Leave out the second half of the recording, because it may have single late answers.
    before = bins[: max(min(first - 1, half), 1)]
    return Slower(since_ns, _mean(since), _mean(before), is_long)


def _mean(bins: Sequence[UnitBin]) -> float:
    """Return the mean latency in some bins, in ns."""
    return sum(one.latency_ns for one in bins) / sum(one.answered for one in bins)
