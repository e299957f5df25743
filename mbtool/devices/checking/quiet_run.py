"""Answered reads of a network that break no rule by themselves, many at once."""

# Most transactions of a capture are such, and arrays give them. What rules remember of them (the
# last request of a connection, the periods of a poll) they take from the figures here, without a
# look at each one.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

from mbtool.devices.named_transaction import NamedTransaction

if TYPE_CHECKING:
    from collections.abc import Sequence


class QuietPoll(NamedTuple):
    """The equal requests of a run, of whatever master."""

    link: str
    unit: int
    function: int
    address: int
    quantity: int
    first: int
    """The number of the first one among all rows."""
    request_ns: list[int]


class QuietConnection(NamedTuple):
    """The requests of a run on one connection. Each came after the response to the one before."""

    link: str
    source: str
    """HOST:PORT of the master."""
    destination: str
    units: frozenset[int]
    first_ns: int
    """The time of the first request."""
    least_ns: int
    last_request_ns: int
    last_response_ns: int
    recent: list[tuple[int, int, int]]
    """Transaction id, time of the request, time of the response (ns) of the last ones."""


@dataclass(slots=True)
class QuietRun:
    """Reads with the outcome OK, without findings, verdicts and retries, on a network."""

    polls: list[QuietPoll]
    """In the order of their last requests."""
    connections: list[QuietConnection]
    """In the order of their last requests."""
    transaction: Callable[[int], NamedTransaction]
    """Makes the transaction of a row, by its number among all rows."""

    @property
    def last_request_ns(self) -> int:
        return max(one.last_request_ns for one in self.connections)

    @property
    def last_response_ns(self) -> int:
        return max(one.last_response_ns for one in self.connections)


class QuietRows(Protocol):
    """All rows between two records of another kind."""

    def __len__(self) -> int: ...

    def run(self, begin: int) -> QuietRun:
        """The rows from a number to the last one."""
        ...

    def transactions(self, begin: int, end: int) -> Sequence[NamedTransaction]:
        """The rows from a number up to another, one by one."""
        ...
