"""In what two captures differ, in the words of their devices."""

# replay/comparing.py finds it, and views/differences.py shows it.

from __future__ import annotations

from enum import StrEnum

import msgspec


class DifferenceKind(StrEnum):
    """In what two captures differ."""

    SLAVE = "slave"
    REQUEST = "request"
    OUTCOME = "outcome"
    VALUE = "value"
    LATENCY = "latency"


class Side(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What one capture has."""

    text: str
    """For readers; empty where it has nothing."""
    count: int | None = None
    """How many transactions that is."""
    values: list[int] | None = None
    """The values of a register that is told alone."""
    median_ns: int | None = None
    p95_ns: int | None = None


class Difference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One thing in which two captures differ."""

    kind: DifferenceKind
    unit: int
    link: str | None = None
    """Where the unit alone does not tell the slave."""
    function: int | None = None
    reference: str | None = None
    """What it is about, in the notation of the device."""
    name: str | None = None
    """What the device's manual calls that."""
    what: str
    """`read`, `written`, or the function's name."""
    a: Side
    b: Side
    p: float | None = None
    """How likely a difference like this is by chance, where that was tested."""
    alike: int = 0
    """How many other requests of this function have their latencies shifted, too."""
