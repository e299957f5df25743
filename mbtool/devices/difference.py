"""One difference between two captures, as `mbtool diff` reports it."""

# replay/comparing.py finds the differences, and views/differences.py shows them.

from __future__ import annotations

from enum import StrEnum

import msgspec


class DifferenceKind(StrEnum):
    """The aspect in which two captures differ, such as a latency or a value."""

    SLAVE = "slave"
    REQUEST = "request"
    OUTCOME = "outcome"
    VALUE = "value"
    LATENCY = "latency"
    CONNECTION = "connection"


class Side(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The content of one of the two captures at the place where they differ."""

    text: str
    """The content of this capture in words, for a user; empty if the capture has nothing there."""
    count: int | None = None
    """Number of transactions in this capture that the difference is about; None if they were not
    counted."""
    values: list[int] | None = None
    """The different values that the register had in this capture, in the order of their first
    appearance. None if the difference is not about a single register."""
    median_ns: int | None = None
    p95_ns: int | None = None


class Difference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A difference between two captures; `a` and `b` have the content of each where they differ."""

    kind: DifferenceKind
    unit: int | None = None
    """The unit of the slave; None for a connection, which may serve several."""
    link: str | None = None
    """The link of the slave; None if the unit alone identifies the slave."""
    function: int | None = None
    reference: str | None = None
    """The addresses that differ, in the vendor's notation, such as `HR400001`; None if the
    difference is not about addresses."""
    name: str | None = None
    """The name that the device's manual has for the addresses in `reference`; None if it has
    none."""
    what: str
    """The thing that differs: `read` (values that were read), `written` (values that were written),
    `slave`, `connection 3`, or the name of a function."""
    a: Side
    b: Side
    p: float | None = None
    """The p-value: the probability, 0 to 1, that chance alone causes such a difference; None if not
    computed."""
    alike: list[str] = []
    """Other requests with this function whose latencies changed by about the same factor in the
    same direction: the addresses of each, in the vendor's notation."""
