"""The statistics of one poll: all equal requests of one master to one unit."""

from __future__ import annotations

from collections.abc import Sequence
from heapq import nsmallest
from operator import sub
from typing import TYPE_CHECKING, NamedTuple

from mbtool.ledger.distribution import Distribution
from mbtool.ledger.request_tally import RequestTally

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.unit_account import UseAccount

LONG_NS = 3_000_000_000
"""Periods of a poll of at least this length (ns) are kept with the times at which they began, up to
LONGEST of them."""
LONGEST = 5
"""The number of longest periods that are kept of a poll."""
_PERIOD_BUCKETS = 256
"""The most buckets in the distribution of a poll's periods."""
_USUAL = 0.25
"""A request is the next one of its poll, and no retry, if the time since the last one differs from
the poll's median period by at most this share (0 to 1)."""
_ENOUGH_PERIODS = 5
"""A poll with fewer periods than this has no usual period."""
_STEADY = 8
"""If a poll without a usual period comes this many times at equal distances and gets no response,
its requests are polls and no retries."""
GIVEN_UP = RequestTally()
"""The tally of each poll whose own tally was given up, to save memory: many polls share this one
object. It stays empty."""


class RetryChange(NamedTuple):
    """The times (UTC ns) of the requests of a poll that count as retries, or no longer count as
    retries, because of a new request.
    """

    found: Sequence[int] = ()
    withdrawn: Sequence[int] = ()
    """Requests that counted as retries before and do not count as retries any more."""


class PollKey(NamedTuple):
    """The fields that identify a poll: all requests that are equal in these fields are one poll."""

    link: str
    master: str
    """The master's host; empty on a serial line."""
    unit: int
    function: int
    sub_function: int | None
    address: int | None
    quantity: int | None
    write_address: int | None
    write_quantity: int | None


def poll_key(transaction: NamedTransaction, master: str) -> PollKey:
    return PollKey(
        transaction.link,
        master,
        transaction.unit,
        transaction.function,
        transaction.sub_function,
        transaction.address,
        transaction.quantity,
        transaction.write_address,
        transaction.write_quantity,
    )


class PollStatistics:
    """The statistics of one poll: its transactions, and the times from one request to the next."""

    __slots__ = (
        "_again_ns",
        "_asked_ns",
        "_last_ns",
        "device",
        "function_name",
        "key",
        "longest",
        "number",
        "period",
        "reference",
        "repetitions",
        "tally",
        "use",
    )

    def __init__(
        self,
        number: int,
        key: PollKey,
        first: NamedTransaction,
        use: UseAccount,
        tally: RequestTally | None = None,
    ) -> None:
        self.use = use
        """The counts of the poll's function, with its unit and its master."""
        self.number = number
        """The number of the poll, from 0, in the order in which polls were first seen."""
        self.key = key
        self.function_name = first.function_name
        self.reference = first.reference
        self.device = first.device
        self.tally = RequestTally() if tally is None else tally
        self.period = Distribution(_PERIOD_BUCKETS)
        """The times (ns) from one request of the poll to the next; retries are no requests here."""
        self.longest: tuple[tuple[int, int], ...] = ()
        """The length (ns) and the begin (UTC ns) of the longest periods, the longest first."""
        self.repetitions = 0
        """The number of retries: requests that directly follow an equal request without a
        response, and do not come at the usual period of the poll. The account counts them."""
        self._last_ns: int | None = None
        """The time (UTC ns) of the last request that is no retry."""
        self._asked_ns = 0
        """The time (UTC ns) of the last request or retry; 0 if `_last_ns` is None."""
        self._again_ns: tuple[int, ...] = ()
        """The times (UTC ns) of the last retries, if the poll has no usual period; at most
        _STEADY."""

    @property
    def tape_key(self) -> tuple[str, str]:
        """The key of the master's tape (RequestOrder)."""
        return self.use.tape_key

    def give_up(self) -> None:
        """Add the counts to those of the function, and forget them: the tape of the master holds
        the poll longer, but needs only its key and its periods.
        """
        self.use.tally.merge(self.tally)
        self.tally = GIVEN_UP

    def begin(self, at_ns: int) -> None:
        """Note a request of the poll that is no retry. `at_ns` (UTC ns) is its time."""
        self._again_ns = ()
        if self._last_ns is not None:
            self.period.add(at_ns - self._last_ns)
            self._note_longest((at_ns - self._last_ns,), (self._last_ns,))
        self._last_ns = self._asked_ns = at_ns

    def begin_all(self, times_ns: Sequence[int]) -> None:
        """Note several requests of the poll that are no retries. `times_ns` (UTC ns) is sorted and
        not empty.
        """
        self.begin(times_ns[0])
        periods_ns = list(map(sub, times_ns[1:], times_ns))
        self.period.add_all(periods_ns)
        self._note_longest(periods_ns, times_ns)
        self._last_ns = self._asked_ns = times_ns[-1]

    def _note_longest(self, periods_ns: Sequence[int], begins_ns: Sequence[int]) -> None:
        """Keep those of the periods that are among the longest. Of equal ones the first is kept."""
        full = len(self.longest) == LONGEST
        if max(periods_ns, default=0) < (self.longest[-1][0] + 1 if full else LONG_NS):
            return
        some = [*self.longest, *zip(periods_ns, begins_ns, strict=False)]
        longest = nsmallest(LONGEST, some, key=lambda one: (-one[0], one[1]))
        self.longest = tuple(one for one in longest if one[0] >= LONG_NS)

    def note_repetition(self, at_ns: int) -> RetryChange:
        """Note a request that directly follows an equal one without a response, at `at_ns` (UTC
        ns).

        It is no retry if it comes at the usual period of the poll after the last poll, or after the
        last request of any kind: a poll can come late, and the polls after it keep that delay. The
        caller counts the retries that the result tells.
        """
        last_ns, asked_ns = self._last_ns, self._asked_ns
        self._asked_ns = at_ns
        if last_ns is None or self._is_usual(at_ns - last_ns, at_ns - asked_ns):
            self.begin(at_ns)
            return RetryChange()
        if self.period.count < _ENOUGH_PERIODS:
            self._again_ns = (*self._again_ns, at_ns)
            times = (last_ns, *self._again_ns)[-_STEADY - 1 :]
            if len(times) > _STEADY and _are_steady(times):
                again_ns = self._again_ns
                self.begin_all(again_ns)
                return RetryChange(withdrawn=again_ns[:-1])
            self._again_ns = self._again_ns[-_STEADY:]
        return RetryChange(found=(at_ns,))

    def _is_usual(self, *distances_ns: int) -> bool:
        """True if the poll has a usual period, and one of `distances_ns` is about that."""
        if self.period.count < _ENOUGH_PERIODS:
            return False
        usual = self.period.percentile(50)
        return any(abs(distance - usual) <= _USUAL * usual for distance in distances_ns)

    def cut(self) -> None:
        """End a capture: the time from its last request to the first one of the next capture is no
        period.
        """
        self._last_ns, self._asked_ns = None, 0
        self._again_ns = ()

    @property
    def has_regular_period(self) -> bool:
        """False if the times from one request to the next tell no period: they differ widely, or
        the poll comes in bursts. Pauses so rare that the 95th percentile does not show them are no
        bursts.
        """
        jitter = self.jitter_ns
        return jitter is not None and jitter <= self.period.percentile(50)

    @property
    def jitter_ns(self) -> int | None:
        """The variation of the periods: half the difference between their 95th and their 5th
        percentile, in ns.

        None if there are no periods.
        """
        if not self.period.count:
            return None
        return (self.period.percentile(95) - self.period.percentile(5)) // 2


def _are_steady(times_ns: Sequence[int]) -> bool:
    """True if the distances between these times (ns, sorted) are about equal."""
    distances: list[int] = sorted(map(sub, times_ns[1:], times_ns))
    usual = distances[len(distances) // 2]
    return distances[-1] - usual <= _USUAL * usual and usual - distances[0] <= _USUAL * usual
