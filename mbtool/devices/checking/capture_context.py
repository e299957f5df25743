"""What the rules ask of what is around a record: the devices' profiles, and the lines' settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from mbtool.core import SerialFormat
from mbtool.devices.assignment import Assignments


def _no_line(_: str) -> SerialFormat | None:
    return None


@dataclass(frozen=True, slots=True)
class CaptureContext:
    """What is known of a capture beside its records."""

    assignments: Assignments = field(default_factory=Assignments)
    line_of: Callable[[str], SerialFormat | None] = _no_line
    """The settings of a serial link; None where the times of its bytes are not known."""
    ports: frozenset[int] | None = None
    """The TCP ports at which Modbus is expected; None for all."""
