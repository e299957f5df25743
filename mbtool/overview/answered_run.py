"""Answered requests that came one after another, many of them alike, as arrays give them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import msgspec

from mbtool.devices.named_transaction import NamedTransaction

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Sequence

P = TypeVar("P", bound="Hashable")


@dataclass(slots=True)
class AlikeRequests:
    """Requests of a run that differ only in times, ids, values, packets and the master's port."""

    like: NamedTransaction
    """One of them, of this run or an earlier one."""
    count: int
    begin_ns: int
    """The time of the first request, in UTC ns."""
    end_ns: int
    """The time of the last response."""
    latencies: list[int]
    """In ns, in the order of the responses."""


@dataclass(slots=True)
class AnsweredRun:
    """Requests on a network with their responses, in the order of the responses.

    Each has the outcome OK or EXCEPTION, no retries, and a response that does not come before it.
    Each list but `kinds` has an element for each request.
    """

    kinds: list[AlikeRequests]
    """In the order in which they first appear."""
    kind: list[int]
    """The index in `kinds`."""
    request_ns: list[int]
    response_ns: list[int]

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def row_count(self) -> int:
        """The number of its transactions, for a progress bar."""
        return len(self.kind)

    def latencies_of(self, polls: Sequence[P]) -> dict[P, list[int]]:
        """The latencies of each poll, in order; `polls` are those of the kinds."""
        found: dict[P, list[int]] = {poll: [] for poll in polls}
        if len(found) == len(polls):
            return {poll: kind.latencies for poll, kind in zip(polls, self.kinds, strict=True)}
        for kind, begin_ns, end_ns in self._each():
            found[polls[kind]].append(end_ns - begin_ns)
        return found

    def _each(self) -> Iterator[tuple[int, int, int]]:
        return zip(self.kind, self.request_ns, self.response_ns, strict=True)

    def transactions(self) -> Iterator[NamedTransaction]:
        """The requests one by one, equal to the decoder's in all that their kinds have alike."""
        for kind, begin_ns, end_ns in self._each():
            yield msgspec.structs.replace(
                self.kinds[kind].like,
                request_ns=begin_ns,
                response_ns=end_ns,
                latency_ns=end_ns - begin_ns,
            )
