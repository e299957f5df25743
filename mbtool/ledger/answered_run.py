"""A batch of answered requests, in which equal requests are grouped so that counting is fast."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter, sub
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import msgspec

from mbtool.devices.named_transaction import NamedTransaction

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from mbtool.ledger.request_tally import RequestTally

P = TypeVar("P", bound="Hashable")

_COUNT, _BEGIN_NS, _END_NS, _REQUEST_NS, _LATENCIES = map(
    attrgetter, ("count", "begin_ns", "end_ns", "request_ns", "latencies")
)
_FEW = 8
"""Groups of equal requests are joined by their forms (equal but for the address) if a group has
fewer requests than this in the mean."""


@dataclass(slots=True)
class AlikeRequests:
    """A group of requests of one batch that are equal except for their times, transaction ids,
    values, packets and the TCP port of the master.
    """

    like: NamedTransaction
    """One of the transactions as an example of all; it may come from an earlier batch."""
    count: int
    begin_ns: int
    """The time (UTC ns) of the earliest request of the group."""
    end_ns: int
    """The time (UTC ns) of the latest response of the group."""
    request_ns: list[int]
    """The time (UTC ns) of each request of the group, in the order of the responses."""
    latencies: list[int]
    """The latency (ns) of each request of the group, in the order of the responses."""
    packets: Callable[[int], tuple[int, int]]
    """Returns the numbers of the packets of the request with an index in the group, and of its
    response. In a group of `AnsweredRun.forms`, only index 0 is known."""
    form: int
    """A number. Groups of one batch that have equal numbers differ in their addresses only."""


class ConnectionCounts(NamedTuple):
    """Connections of one master at one link that were opened, or closed with FIN, in a batch."""

    link: str
    host: str
    """The master's host."""
    opened: int
    closed: int
    most: int
    """The most connections open at once in the batch, less those open before it."""
    first_opened_ns: int | None
    """The time (UTC ns) of the first opening; None if there is none."""


@dataclass(slots=True)
class AnsweredRun:
    """A batch of TCP transactions, in the order of their responses.

    Each transaction has the outcome OK or EXCEPTION and no retries, and its response does not come
    before its request. `kind`, `request_ns` and `response_ns` have one element for each
    transaction.
    """

    kinds: list[AlikeRequests]
    """The groups of equal requests, in the order in which they first appear in the batch."""
    kind: list[int]
    """For each transaction, the index in `kinds` of its group."""
    request_ns: list[int]
    response_ns: list[int]
    connections: Sequence[ConnectionCounts] = ()
    """The openings and closings of connections among the transactions."""
    _forms: list[AlikeRequests] | None = None

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def longest_ns(self) -> int:
        """The greatest latency of all (ns)."""
        longest: int = max(map(sub, self.response_ns, self.request_ns))
        return longest

    def forms(self) -> list[AlikeRequests]:
        """Return the groups of requests that are equal except for their addresses, in the order in
        which they first appear; `kinds` if that would hardly be less.
        """
        if self._forms is None:
            self._forms = self.kinds
            if len(self.kind) < _FEW * len(self.kinds):
                found: dict[int, list[AlikeRequests]] = {}
                for one in self.kinds:
                    found.setdefault(one.form, []).append(one)
                self._forms = [*map(_joined, found.values())]
        return self._forms

    def latencies_of(self, polls: Sequence[P]) -> dict[P, list[int]]:
        """Return for each poll the latencies (ns) of its requests, in the order of the responses.

        `polls[i]` is the poll that the group `kinds[i]` belongs to; several groups may have the
        same poll.
        """
        found: dict[P, list[int]] = {poll: [] for poll in polls}
        if len(found) == len(polls):
            return {poll: kind.latencies for poll, kind in zip(polls, self.kinds, strict=True)}
        for kind, begin_ns, end_ns in self.each():
            found[polls[kind]].append(end_ns - begin_ns)
        return found

    def count(self, places: Sequence[int], tally: RequestTally) -> None:
        """Count the requests at these places of the batch in `tally`."""
        if not places:
            return
        kinds = Counter([self.kind[place] for place in places])
        forms: dict[int, list[int]] = {}
        for kind in kinds:
            forms.setdefault(self.kinds[kind].form, []).append(kind)
        for some in forms.values():
            tally.count_alike(self.kinds[some[0]].like, sum(kinds[kind] for kind in some))
        tally.latency.add_all([self.response_ns[one] - self.request_ns[one] for one in places])

    def each(self) -> Iterator[tuple[int, int, int]]:
        """Yield for each transaction the index of its group, and the times (UTC ns) of its request
        and its response.
        """
        return zip(self.kind, self.request_ns, self.response_ns, strict=True)

    def transactions(self) -> Iterator[NamedTransaction]:
        """Yield the transactions one by one: each is its group's example, with times and latency of
        its own.

        Values, transaction id and packets are those of the example, as the batch does not keep them
        for each transaction.
        """
        for kind, begin_ns, end_ns in self.each():
            yield msgspec.structs.replace(
                self.kinds[kind].like,
                request_ns=begin_ns,
                response_ns=end_ns,
                latency_ns=end_ns - begin_ns,
            )


def _joined(groups: list[AlikeRequests]) -> AlikeRequests:
    """Return groups whose requests differ in their addresses only as one group."""
    first = groups[0]
    if len(groups) == 1:
        return first
    return AlikeRequests(
        first.like,
        sum(map(_COUNT, groups)),
        min(map(_BEGIN_NS, groups)),
        max(map(_END_NS, groups)),
        [*chain.from_iterable(map(_REQUEST_NS, groups))],
        [*chain.from_iterable(map(_LATENCIES, groups))],
        first.packets,
        first.form,
    )
