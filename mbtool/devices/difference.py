"""A difference between two captures, with the names of their devices."""

# replay/comparing.py finds differences, and views/differences.py shows them.

from __future__ import annotations

from enum import StrEnum

import msgspec


class DifferenceKind(StrEnum):
    """The aspect in which two captures differ."""

    SLAVE = "slave"
    REQUEST = "request"
    OUTCOME = "outcome"
    VALUE = "value"
    LATENCY = "latency"


class Side(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The content of one of the two captures where they differ."""

    text: str
    """The content in words, for readers; empty if the capture has nothing there."""
    count: int | None = None
    """Number of transactions in this capture that the difference is about."""
    values: list[int] | None = None
    """The values of the register, if the difference is about a single register; otherwise None."""
    median_ns: int | None = None
    p95_ns: int | None = None


class Difference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One difference between two captures."""

    kind: DifferenceKind
    unit: int
    link: str | None = None
    """The link of the slave; None if the unit alone identifies the slave."""
    function: int | None = None
    reference: str | None = None
    """The addresses that differ, in the vendor's notation."""
    name: str | None = None
    """The name that the device's manual has for the addresses in `reference`."""
    what: str
    """What differs: `read` or `written` values, the function with this name, or the `slave`."""
    a: Side
    b: Side
    p: float | None = None
    """The p-value: the probability, 0 to 1, that chance alone causes such a difference; None if not
    computed."""
    alike: list[str] = []
    """Other requests with this function whose latencies changed by about the same factor in the
    same direction: the addresses of each, in the vendor's notation."""
