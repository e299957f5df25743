"""Common reads and writes that came one after another, with what differs between them."""

# The array decoder gives these instead of single transactions (columns/usual_runs.py), so that a
# table makes their rows together.

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from mbtool.modbus import Outcome

F = TypeVar("F")


@dataclass(slots=True)
class UsualRun(Generic[F]):
    """Requests on a network with their responses, in the order of the responses.

    Each transaction has the outcome OK or EXCEPTION, and no retries. Each list has one element per
    transaction.
    """

    forms: Sequence[F]
    """What the caller made of an example: of a transaction of the same file that differs from this
    one at most in what the lists below tell."""
    refused: int
    """The number of transactions with the outcome EXCEPTION."""
    links: Sequence[str]
    sources: Sequence[str]
    """Address and port of the master."""
    destinations: Sequence[str]
    """Address and port of the slave."""
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
