"""Figures about many answered Modbus/TCP reads and writes that break no rule by themselves, for the
rules of `mbtool check`, the account and the troubles. The responses may be exceptions.
"""

# Most transactions of a capture are such reads and writes; columns/ decodes them into arrays,
# without an object for each. But a rule must remember something about them, such as the last
# request of a connection or the periods of a poll. The rules take this from the figures here,
# without checking each transaction. A "run" is a series of such transactions with no other record
# between them than openings and closings of connections. The place of a transaction is its index in
# the run.
#
# A poll is all equal requests of one master to one unit. Rules and account keep a bounded number of
# polls, and drop the one whose last request is oldest. The stay of a poll begins with the request
# that finds no entry for it, and ends when its entry is dropped.

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self

from mbtool.core import WireEvent
from mbtool.modbus.functions import FUNCTIONS

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

PollName = tuple[object, ...]
"""The fields of PollKey (ledger/poll_statistics.py): link, the master's host, unit, function, None,
address, quantity, None and None."""


class Stay(NamedTuple):
    """The requests of a run in one stay of a poll."""

    name: PollName
    number: int
    """The number of the stay among those that begin in the run; negative if it began before."""
    places: list[int]
    """The places of its requests; not empty."""


class Stays(NamedTuple):
    """The stays of the polls of a bounded table, while the requests of a run are made in turn."""

    dropped: list[PollName]
    """The polls that are dropped before their first request in the run, if any, the oldest
    first."""
    ended: list[Stay]
    """The stays that end within the run, in this order, but those of `passing`."""
    passing: list[int]
    """The places of the requests of stays that begin and end within the run and have few requests.
    The stay that ended first is first."""
    left: list[Stay]
    """The stays with a request in the run that do not end, in the order of their last requests."""
    begun: int
    """The number of stays that begin in the run."""
    fresh: list[int]
    """The places of the first requests of these stays, and of their first ones with another
    exception code as response."""


class AlikeRequests(NamedTuple):
    """Requests of a run that are equal except for their addresses, quantities, times, transaction
    ids, values, packets and the TCP port of the master.
    """

    like: NamedTransaction
    """One of the transactions as an example of all; it may come from an earlier run."""
    places: list[int]
    begin_ns: int
    """The time (UTC ns) of the earliest request."""
    end_ns: int
    """The time (UTC ns) of the latest response."""


class RunRows(NamedTuple):
    """The fields of the transactions of a run, in the order of the responses."""

    asked: list[int]
    """`asked_number` of the request."""
    exceptions: list[int]
    """The exception code of the response; -1 if it is none."""
    request_ns: list[int]
    latencies_ns: list[int]
    request_bytes: list[int]
    """The number of bytes of the request's ADU."""
    response_bytes: list[int]


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
    """The time (ns) at which the connection was opened; None if that was before this run. If it is
    known, the capture has the connection from its first segment on."""


class ConnectionCounts(NamedTuple):
    """Connections of one master at one link that were opened, or closed with FIN, in a run."""

    link: str
    host: str
    """The master's host."""
    opened: int
    closed: int
    most: int
    """The most connections open at once in the run, less those open before it."""
    first_opened_ns: int | None
    """The time (UTC ns) of the first opening; None if there is none."""


class QuietRun(Protocol):
    """Figures about consecutive Modbus/TCP reads and writes with the outcome OK or EXCEPTION, but
    no exception of a gateway.

    None of them has a finding, a retry, or a verdict of the decoder such as `malformed`, and no
    response comes before its request. Times are UTC ns.
    """

    def __len__(self) -> int:
        """The number of transactions."""

    connections: list[QuietConnection]
    """The transactions grouped by connection, in the order of their last requests or openings."""
    opened_and_closed: list[ConnectionCounts]
    """The openings and closings of connections among the transactions."""
    last_event_ns: int
    """The latest time of the opening or closing of a connection; 0 if there is none."""

    @property
    def file(self) -> str | None:
        """The name of the capture file that has the transactions."""

    @property
    def rows(self) -> RunRows:
        """The fields of the transactions."""

    @property
    def forms(self) -> list[AlikeRequests]:
        """The transactions grouped by all but address and quantity, in the order in which the
        groups first appear.
        """

    @cached_property
    def form(self) -> list[int]:
        """For each transaction, the index in `forms` of its group."""
        form = [0] * len(self)
        for index, one in enumerate(self.forms):
            for place in one.places:
                form[place] = index
        return form

    @cached_property
    def writes(self) -> list[int]:
        """The places of the writes."""
        forms = (one for one in self.forms if FUNCTIONS[one.like.function].writes)
        return sorted(place for one in forms for place in one.places)

    @cached_property
    def refused(self) -> list[int]:
        """The places of the transactions whose response is an exception."""
        forms = (one for one in self.forms if one.like.exception is not None)
        return sorted(place for one in forms for place in one.places)

    @property
    def last_request_ns(self) -> int:
        return max(one.last_request_ns for one in self.connections)

    @property
    def last_response_ns(self) -> int:
        return max(one.last_response_ns for one in self.connections)

    def stays(self, held: Collection[PollName], limit: int, few: int = 0) -> Stays:
        """Return the stays of polls in a table with room for `limit` polls. `held` has the polls
        that are in it before, the one whose last request is oldest first.

        Stays with at most `few` requests that begin and end in the run are `Stays.passing`.
        """

    def slow(self, least_ns: int, most: int | None = None) -> list[tuple[int, int]]:
        """Return place and latency of each transaction that took `least_ns` or longer, in order; of
        each poll at most `most`, the longest ones.
        """

    def ends(self, place: int) -> tuple[str, str, str]:
        """Return the link, the HOST:PORT of the master, and the HOST:PORT of the slave."""

    def like(self, place: int) -> NamedTransaction:
        """Make a transaction, but with the values and bytes of one with the same function."""

    def packets(self, place: int) -> tuple[int, int]:
        """Return the numbers of the packets of a request and its response."""

    def transactions(self) -> Iterator[NamedTransaction]:
        """Make the transactions one by one."""


class QuietRows(Protocol):
    """Consecutive answered reads and writes (rows) that break no rule, with no other record between
    them than openings and closings of connections.
    """

    def __len__(self) -> int: ...

    @property
    def run(self) -> QuietRun:
        """The figures about all rows, for the rules."""

    def records(self, count: int) -> Iterator[NamedTransaction | WireEvent]:
        """The transactions of the first `count` rows, and the events before the next row."""

    def behind(self, count: int) -> Self:
        """All rows but the first `count`."""


def asked_number(unit: int, function: int, address: int | None, quantity: int | None) -> int:
    """Return a number by which requests with the same unit, function, address and quantity are
    recognised; not 0.
    """
    if address is None or quantity is None:
        return hash((unit, function, address, quantity)) or 1
    return unit << 40 | function << 32 | address << 16 | quantity
