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
    """The content of one of the two captures."""

    text: str
    """For readers; empty if the capture has nothing here."""
    count: int | None = None
    """Number of transactions."""
    values: list[int] | None = None
    """The values of a register that has a difference of its own."""
    median_ns: int | None = None
    p95_ns: int | None = None


class Difference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One difference between two captures."""

    kind: DifferenceKind
    unit: int
    link: str | None = None
    """Absent if the unit alone identifies the slave."""
    function: int | None = None
    reference: str | None = None
    """The addresses, in the notation of the device."""
    name: str | None = None
    """Their name in the device's manual."""
    what: str
    """`read`, `written`, or the function's name."""
    a: Side
    b: Side
    p: float | None = None
    """The probability of such a difference by chance, if a test was made."""
    alike: int = 0
    """Other requests of this function whose latencies also changed."""
