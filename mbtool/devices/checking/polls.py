"""Requests that come at regular times, and do not always (MB-404)."""

# A poll is the same request to the same unit, again and again. Its periods are regular where the
# middle half of them lie within EVEN of one another, measured by their median. Of a regular poll
# those are told that are off by more than half the median: one finding for each poll, with figures.
# Polls faster than FAST_NS follow the answers, not a clock, and have no period to keep.
#
# Holds MAX_POLLS polls with less than MAX_PERIODS periods each. Of more, a sample is kept that
# covers the whole capture, however long: each period draws a lot from its number, which scatters
# numbers evenly (Knuth, The Art of Computer Programming, 6.4: a multiplier near the golden
# section), and when there are too many, those with the higher lots go. So no rhythm of the master's
# can hide in it, and it is the same in each run. The longest and the shortest are kept apart.

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median, quantiles
from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import Finding, found
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import asked_for
from mbtool.devices.named_transaction import NamedTransaction

if TYPE_CHECKING:
    from collections.abc import Iterator


MAX_POLLS = 4096
MAX_PERIODS = 256
ENOUGH = 20
"""Periods that it takes to see what is usual."""
SEVERAL = 5
RARE = 0.03
"""Fewer than these are pauses, of which every capture has some."""
EVEN = 0.2
FAST_NS = 20_000_000

_LOTS = 1 << 32
_SPREAD = 2_654_435_761


@dataclass(slots=True)
class _Poll:
    first: NamedTransaction | None = None
    last_ns: int = 0
    sample: list[tuple[int, int]] = field(default_factory=list)
    """Lots and periods."""
    count: int = 0
    below: int = _LOTS
    """Lots from this on are not taken."""
    shortest: int = 0
    longest: int = 0

    def note(self, at_ns: int) -> None:
        period = at_ns - self.last_ns
        self.last_ns = at_ns
        if period < 0:  # The clock was set back.
            return
        self.longest = max(self.longest, period)
        self.shortest = min(self.shortest, period) if self.count else period
        lot = self.count * _SPREAD % _LOTS
        if lot < self.below:
            self.sample.append((lot, period))
        while len(self.sample) >= MAX_PERIODS:
            self.below //= 2
            self.sample = [one for one in self.sample if one[0] < self.below]
        self.count += 1


class PollRules:
    """Transactions in; what is to be said of their times out at the end."""

    def __init__(self) -> None:
        self._polls: LruDict[tuple[object, ...], _Poll] = LruDict(_Poll, MAX_POLLS)

    def transaction(self, transaction: NamedTransaction) -> None:
        """Take the next transaction whose times are known."""
        at_ns = transaction.request_ns
        if at_ns is None:
            return
        poll = self._polls[
            transaction.link,
            transaction.unit,
            transaction.function,
            transaction.address,
            transaction.quantity,
        ]
        if poll.first is None:
            poll.first, poll.last_ns = transaction, at_ns
        else:
            poll.note(at_ns)

    def close(self) -> Iterator[Finding]:
        """The capture ends."""
        for poll in self._polls.values():
            text = _text(poll)
            if text is not None and poll.first is not None:
                yield found("MB-404", poll.first, f"{asked_for(poll.first)}: {text}")


def _text(poll: _Poll) -> str | None:
    periods = [period for _, period in poll.sample]
    if len(periods) < ENOUGH:
        return None
    usual = median(periods)
    first, _, third = quantiles(periods, n=4)
    if usual < FAST_NS or third - first > EVEN * usual:
        return None
    off = sum(abs(period - usual) > usual / 2 for period in periods)
    if off < SEVERAL or off < RARE * len(periods):
        return None
    sample = f" looked at, of {poll.count}," if len(periods) < poll.count else ""
    return (
        f"asked every {_ms(usual)}, but {off} of {len(periods)} periods{sample} are off by more "
        f"than half of that; {_ms(poll.shortest)} to {_ms(poll.longest)}"
    )


def _ms(ns: float) -> str:
    return f"{ns / 1e9:.2f} s" if ns >= 1e9 else f"{ns / 1e6:.1f} ms"
