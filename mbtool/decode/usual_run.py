"""Describes consecutive usual reads and writes: the fields in which they differ, as lists."""

# The array decoder yields a UsualRun in place of single transactions (columns/usual_runs.py), so
# that a table prints all of them together.

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from mbtool.modbus import Outcome

F = TypeVar("F")


@dataclass(slots=True)
class UsualRun(Generic[F]):
    """Consecutive requests on a network with their responses, in the order of the responses.

    Each transaction has the outcome OK or EXCEPTION, and no retries. Each list has one element per
    transaction.
    """

    forms: Sequence[F]
    """For each transaction, its form: an object that the caller made from an example, such as a
    text. Example and transaction are of the same file and differ at most in the fields of this
    class."""
    refused: int
    """The number of transactions with the outcome EXCEPTION."""
    links: Sequence[str]
    sources: Sequence[str]
    """The master's address and port, as text."""
    destinations: Sequence[str]
    """The slave's address and port, as text."""
    transaction_ids: Sequence[int]
    request_ns: Sequence[int]
    """The time of the request (UTC ns)."""
    latency_ns: Sequence[int]
    request_packets: Sequence[int]
    """The number of the request's packet in its file, from 1."""
    response_packets: Sequence[int]
    values: Sequence[list[int]]
    """The registers or bits read or written; empty if there are none."""

    def __len__(self) -> int:
        return len(self.forms)

    @property
    def row_count(self) -> int:
        """The number of transactions, for a progress bar."""
        return len(self.forms)

    @property
    def outcomes(self) -> Counter[Outcome]:
        return Counter({Outcome.OK: len(self) - self.refused, Outcome.EXCEPTION: self.refused})
