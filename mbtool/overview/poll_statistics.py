"""The statistics of one poll: all equal requests of one master to one unit."""

from __future__ import annotations

from operator import sub
from typing import TYPE_CHECKING, NamedTuple

from mbtool.overview.distribution import Distribution
from mbtool.overview.request_tally import RequestTally

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.named_transaction import NamedTransaction

_PERIOD_BUCKETS = 256
_USUAL = 0.25
"""A request comes at the usual period of its poll if it differs from it by at most this share."""
_ENOUGH_PERIODS = 5
"""A poll with fewer periods than this has no usual period."""
_STEADY = 8
"""If a poll without a usual period comes this many times at equal distances and gets no response,
its requests are polls and no retries."""


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
        "_last_ns",
        "device",
        "function_name",
        "key",
        "number",
        "period",
        "reference",
        "repetitions",
        "tally",
    )

    def __init__(self, number: int, key: PollKey, first: NamedTransaction) -> None:
        self.number = number
        """The number of the poll, from 0, in the order in which polls were first seen."""
        self.key = key
        self.function_name = first.function_name
        self.reference = first.reference
        self.device = first.device
        self.tally = RequestTally()
        self.period = Distribution(_PERIOD_BUCKETS)
        """The times (ns) from one request of the poll to the next; retries are no requests here."""
        self.repetitions = 0
        """The number of retries: requests that directly follow an equal request without a
        response, and do not come at the usual period of the poll."""
        self._last_ns: int | None = None
        self._again_ns: list[int] = []
        """The times (UTC ns) of the last retries, if the poll has no usual period; fewer than
        _STEADY."""

    def begin(self, at_ns: int) -> None:
        """Note a request of the poll that is no retry. `at_ns` (UTC ns) is its time."""
        self._again_ns.clear()
        if self._last_ns is not None:
            self.period.add(at_ns - self._last_ns)
        self._last_ns = at_ns

    def begin_all(self, times_ns: Sequence[int]) -> None:
        """Note several requests of the poll that are no retries. `times_ns` (UTC ns) is sorted and
        not empty.
        """
        self.begin(times_ns[0])
        self.period.add_all(list(map(sub, times_ns[1:], times_ns)))
        self._last_ns = times_ns[-1]

    def begin_again(self, at_ns: int) -> tuple[int, Sequence[int]]:
        """Note a request that directly follows an equal one without a response, at `at_ns` (UTC
        ns).

        Returns a number, and times (UTC ns): 1 and the time of the request if it is a retry. If it
        is none, there are no times; but if it shows that the requests before it were none either,
        the result is -1 and their times, and `repetitions` no longer has them.
        """
        last_ns = self._last_ns
        if last_ns is None or self._is_usual(at_ns - last_ns):
            self.begin(at_ns)
            return 1, ()
        if self.period.count < _ENOUGH_PERIODS:
            self._again_ns.append(at_ns)
            if len(self._again_ns) >= _STEADY:
                times, self._again_ns = self._again_ns, []
                if _are_steady((last_ns, *times)):
                    self.repetitions -= len(times) - 1
                    self.begin_all(times)
                    return -1, times[:-1]
        self.repetitions += 1
        return 1, (at_ns,)

    def _is_usual(self, distance_ns: int) -> bool:
        """True if the poll has a usual period, and `distance_ns` is about that."""
        if self.period.count < _ENOUGH_PERIODS:
            return False
        usual = self.period.percentile(50)
        return abs(distance_ns - usual) <= _USUAL * usual

    def cut(self) -> None:
        """End a capture: the time from its last request to the first one of the next capture is no
        period.
        """
        self._last_ns = None
        self._again_ns.clear()

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
