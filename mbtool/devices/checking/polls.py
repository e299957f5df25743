"""The rule about polls whose requests usually come regularly, but sometimes early or late
(MB-404).
"""

# A poll is a series of equal requests of one master to one unit; a period is the time from one of
# them to the next. The periods of a poll are regular if their interquartile range is at most
# MAX_SPREAD of their median. A period of a regular poll is irregular if it differs from the median
# by more than half. There is one finding for each regular poll with irregular periods, with
# figures. A poll with a median period below MIN_PERIOD_NS gets no finding: such a master sends as
# soon as the response has come, not by a clock.
#
# Memory: MAX_POLLS polls with fewer than MAX_PERIODS periods each, plus the shortest and the
# longest. If there are more periods, a pseudo-random sample is kept that is spread over the whole
# capture: a period's number is hashed (Knuth, The Art of Computer Programming, 6.4: a multiplier
# near the golden section), and when the sample is full, the periods with the higher hashes are
# dropped. A fixed interval between sampled periods could hide a rhythm of the master; this sample
# cannot, and it is the same in each run.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from operator import sub
from statistics import median, quantiles
from typing import TYPE_CHECKING

from mbtool.core.moments import host_of, milliseconds
from mbtool.devices.checking.finding import Finding, transaction_finding
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import PollName, QuietRun
    from mbtool.devices.named_transaction import NamedTransaction

MAX_POLLS = 4096
MAX_PERIODS = 256
MIN_PERIODS = 20
"""A poll with fewer periods (times from one request to the next) gets no finding: the median of so
few is too uncertain."""
ENOUGH_PERIODS = 5
"""With fewer periods than this, the usual period of a poll is not known."""
MIN_IRREGULAR = 5
MIN_IRREGULAR_SHARE = 0.03
"""A poll with a smaller share of irregular periods, 0 to 1, gets no finding: every capture has a
few of them, because masters pause occasionally."""
MAX_SPREAD = 0.2
MIN_PERIOD_NS = 20_000_000

_RENEWED = 16
"""The usual period of a poll is computed anew when this part (1/16) more periods are known."""
_HASHES = 1 << 32
_MULTIPLIER = 2_654_435_761


@dataclass(slots=True)
class _Poll:
    first: Finding | None = None
    """The finding about the first request. It is kept in place of the transaction, which holds
    values and bytes, too.
    """
    last_ns: int = 0
    sample: list[tuple[int, int]] = field(default_factory=list)
    """The sampled periods: the hash of the period's number, and the period in ns."""
    count: int = 0
    hash_limit: int = _HASHES
    """The sample has those periods whose numbers have hashes below this limit; it is halved when
    the sample is full."""
    shortest: int = 0
    longest: int = 0
    usual_ns: float = 0
    """The median of the sample when `count` was `usual_of`; it is computed anew when there are many
    more periods, as it changes little."""
    usual_of: int = 0

    def note(self, at_ns: int) -> None:
        period = at_ns - self.last_ns
        self.last_ns = at_ns
        if period < 0:  # The clock was set back.
            return
        self.longest = max(self.longest, period)
        self.shortest = min(self.shortest, period) if self.count else period
        hashed = self.count * _MULTIPLIER % _HASHES
        if hashed < self.hash_limit:
            self.sample.append((hashed, period))
        self._halve()
        self.count += 1

    def note_all(self, times: Sequence[int]) -> None:
        """Add requests at these times (ns), with the same result as `note` for each."""
        periods = [*map(sub, times, (self.last_ns, *times))]
        if not periods or min(periods) < 0:
            for at_ns in times:
                self.note(at_ns)
            return
        self.last_ns = times[-1]
        self.longest = max(self.longest, max(periods))
        self.shortest = min(periods) if not self.count else min(self.shortest, min(periods))
        limit = self.hash_limit
        self.sample += [
            (hashed, period)
            for number, period in enumerate(periods, self.count)
            if (hashed := number * _MULTIPLIER % _HASHES) < limit
        ]
        self._halve()
        self.count += len(periods)

    def _halve(self) -> None:
        while len(self.sample) >= MAX_PERIODS:
            self.hash_limit //= 2
            self.sample = [one for one in self.sample if one[0] < self.hash_limit]


class PollRules:
    """Finds polls whose requests sometimes come early or late (MB-404).

    All findings come at the end of the capture.
    """

    def __init__(self) -> None:
        self._polls: LruDict[PollName, _Poll] = LruDict(_Poll, MAX_POLLS)

    def transaction(self, transaction: NamedTransaction) -> None:
        """Add the next transaction to its poll, the series of requests equal to its own.

        The caller must leave out transactions whose times are not known exactly.
        """
        at_ns = transaction.request_ns
        if at_ns is None:
            return
        poll = self._polls[_key(transaction)]
        if poll.first is None:
            poll.first, poll.last_ns = _said_of(transaction), at_ns
        else:
            poll.note(at_ns)

    def usual_ns(self, transaction: NamedTransaction) -> float | None:
        """Return the median period (ns) of a transaction's poll; None if too few are known."""
        poll = self._polls.get(_key(transaction))
        if poll is None or len(poll.sample) < ENOUGH_PERIODS:
            return None
        if poll.count * _RENEWED >= poll.usual_of * (_RENEWED + 1):
            poll.usual_of = poll.count
            poll.usual_ns = median(period for _, period in poll.sample)
        return poll.usual_ns

    def run(self, run: QuietRun) -> None:
        """Add many transactions together, with the same result as `transaction` for each."""
        request_ns = run.rows.request_ns
        for poll, stay in self._polls.use(run):
            times = [request_ns[place] for place in stay.places]
            if poll.first is None:
                poll.first, poll.last_ns = _said_of(run.like(stay.places[0])), times[0]
                del times[0]
            poll.note_all(times)

    def close(self) -> Iterator[Finding]:
        """Yield a finding for each regular poll with irregular periods.

        Call this method at the end of the capture.
        """
        for poll in self._polls.values():
            text = _text(poll)
            if text is not None and poll.first is not None:
                yield replace(poll.first, message=f"{poll.first.message}: {text}")


def _said_of(transaction: NamedTransaction) -> Finding:
    return transaction_finding("MB-404", transaction, request_text(transaction))


def _key(one: NamedTransaction) -> PollName:
    master = host_of(one.source)
    return one.link, master, one.unit, one.function, None, one.address, one.quantity, None, None


def _text(poll: _Poll) -> str | None:
    periods = [period for _, period in poll.sample]
    if len(periods) < MIN_PERIODS:
        return None
    usual = median(periods)
    first_quartile, _, third_quartile = quantiles(periods, n=4)
    if usual < MIN_PERIOD_NS or third_quartile - first_quartile > MAX_SPREAD * usual:
        return None
    off = sum(abs(period - usual) > usual / 2 for period in periods)
    if off < MIN_IRREGULAR or off < MIN_IRREGULAR_SHARE * len(periods):
        return None
    sample = f" looked at, of {poll.count}," if len(periods) < poll.count else ""
    return (
        f"asked every {_ms(usual)}, but {off} of {len(periods)} periods{sample} are off by more "
        f"than half of that; {_ms(poll.shortest)} to {_ms(poll.longest)}"
    )


def _ms(ns: float) -> str:
    return f"{ns / 1e9:.2f} s" if ns >= 1e9 else milliseconds(ns)
