"""Figures about many answered Modbus/TCP reads and writes that break no rule by themselves, for the
rules of `mbtool check`. The responses may be exceptions.
"""

# Most transactions of a capture are such reads and writes; columns/ decodes them into arrays,
# without an object for each. But a rule must remember something about them, such as the last
# request of a connection or the periods of a poll. The rules take this from the figures here,
# without checking each transaction. A "run" is a series of such transactions with no other record
# between them.

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.core import WireEvent
    from mbtool.devices.named_transaction import NamedTransaction


class QuietPoll(NamedTuple):
    """The equal requests of one master to one unit in a run."""

    link: str
    master: str
    """The master's host."""
    unit: int
    function: int
    address: int
    quantity: int
    first: int
    """The row number of the first of these requests, for `QuietRun.head`."""
    request_ns: list[int]


class QuietRequest(NamedTuple):
    """A request in a run."""

    poll: int
    """The index of its poll in `QuietRun.polls`."""
    source: str
    """HOST:PORT of the master."""
    destination: str
    at_ns: int
    """The time of the request, in ns."""
    row: int
    """Its row number, for `QuietRun.head`."""
    packets: tuple[int, int]
    """The numbers of the packets of the request and its response."""
    exception: int
    """The exception code of the response; -1 if it is none."""


class QuietConnection(NamedTuple):
    """The requests on one connection in a run, or its opening, or both.

    Each request came after the response to the request before it.
    """

    link: str
    source: str
    """HOST:PORT of the master."""
    destination: str
    units: frozenset[int]
    """Empty if there is no request, only the opening."""
    first_ns: int
    """The time of the first request, in ns; of the opening if there is no request."""
    least_ns: int
    """The least time of a request, in ns; less than `first_ns` if the clock was set back."""
    last_request_ns: int
    last_response_ns: int
    recent: list[tuple[int, int, int]]
    """For each of the last transactions (at most connections.MAX_RECENT): transaction id, time of
    the request (ns) and time of the response (ns)."""
    opened_ns: int | None
    """The time (ns) at which the connection was opened, if that is in the run. The capture has its
    beginning then."""


class QuietRun:
    """Figures about consecutive Modbus/TCP reads and writes with the outcome OK or EXCEPTION, but
    no exception of a gateway.

    None of them has a finding, a retry, or a verdict of the decoder such as `malformed`.
    """

    def __init__(
        self,
        connections: list[QuietConnection],
        polls: Callable[[], list[QuietPoll]],
        writes: Callable[[], list[QuietRequest]],
        requests: Callable[[], list[QuietRequest]],
        head: Callable[[int], NamedTransaction],
        last_event_ns: int = 0,
        *,
        has_exceptions: bool = False,
    ) -> None:
        self.connections = connections
        """The transactions grouped by connection, in the order of their last requests or
        openings."""
        self._polls = polls
        self._writes = writes
        self._requests = requests
        self.head = head
        """Makes the transaction with a row number, but with the values and bytes of an equal
        request."""
        self.has_exceptions = has_exceptions
        """True if some responses are exceptions."""
        self.last_event_ns = last_event_ns
        """The latest time (ns) of the opening or closing of a connection; 0 if there is none."""

    @cached_property
    def polls(self) -> list[QuietPoll]:
        """The transactions grouped by equal requests, in the order of their last requests."""
        return self._polls()

    @cached_property
    def writes(self) -> list[QuietRequest]:
        """The writes among them, in their order."""
        return self._writes()

    @cached_property
    def requests(self) -> list[QuietRequest]:
        """All requests, in the order of the responses."""
        return self._requests()

    @property
    def last_request_ns(self) -> int:
        return max(one.last_request_ns for one in self.connections)

    @property
    def last_response_ns(self) -> int:
        return max(one.last_response_ns for one in self.connections)


class QuietRows(Protocol):
    """Consecutive answered reads and writes (rows) that break no rule, with no other record between
    them than openings and closings of connections.
    """

    def __len__(self) -> int: ...

    def run(self) -> QuietRun:
        """The figures about all rows, for the rules."""
        ...

    def records(self, count: int) -> Iterator[NamedTransaction | WireEvent]:
        """The transactions of the first `count` rows, and the events before the next row."""
        ...

    def behind(self, count: int) -> Self:
        """All rows but the first `count`."""
        ...
