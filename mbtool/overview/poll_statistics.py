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
        response."""
        self._last_ns: int | None = None

    def begin(self, at_ns: int) -> None:
        """Note a request of the poll that is no retry. `at_ns` (UTC ns) is its time."""
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

    def cut(self) -> None:
        """End a capture: the time from its last request to the first one of the next capture is no
        period.
        """
        self._last_ns = None

    @property
    def jitter_ns(self) -> int | None:
        """The variation of the periods: half the difference between their 95th and their 5th
        percentile, in ns.

        None if there are no periods.
        """
        if not self.period.count:
            return None
        return (self.period.percentile(95) - self.period.percentile(5)) // 2
