"""Answered reads and writes of a network, grouped by poll, for values over time."""

# Capture files are decoded as arrays (columns/), which yield many such reads at once.

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol


class ValueChanges(NamedTuple):
    """The changes of one register or bit: their times and new values. Each list has one element per
    change.
    """

    rows: list[int]
    """The index of the read's transaction among those of its block of packets, which tells the
    order of the reads of several polls."""
    at_ns: list[int]
    """The time (UTC ns) of the response that shows the change."""
    values: list[int]


class ReadValues(Protocol):
    """The values of registers or bits that the reads or writes of one poll bring."""

    def last(self) -> list[int]:
        """Return the last values, one for each register or bit."""
        ...

    def words(self) -> bytes:
        """Return all values, those of the first read or write first, with two bytes each in the
        machine's order.
        """
        ...

    def changes(
        self, before: Sequence[int] | None, place: int, *, every: bool = False
    ) -> ValueChanges:
        """The changes of the value at index `place` of each read or write; with `every`, all of
        its values.

        `before` holds the values before the first one; None if they are unknown.
        """
        ...


class AnsweredReads(NamedTuple):
    """Reads or writes of one poll, of one or more masters: outcome OK, no verdicts, no retries."""

    request_ns: list[int]
    """The time of each, in the order of the responses."""
    values: ReadValues


class AnsweredValues(Protocol):
    """The values of answered reads and of writes, by poll; the polls are sorted by their first
    requests.
    """

    @property
    def asked(self) -> list[tuple[str, int, int, int, int]]:
        """Link, unit, function, address and quantity of each poll."""
        ...

    def __getitem__(self, index: int) -> AnsweredReads: ...
