"""What the rules need to know about a capture: device profiles, line settings, ports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from mbtool.core import SerialFormat
from mbtool.devices.assignment import Assignments


def _no_line(_: str) -> SerialFormat | None:
    return None


@dataclass(frozen=True, slots=True)
class CaptureContext:
    """What the rules need besides the records: the user's options and the settings of the lines."""

    assignments: Assignments = field(default_factory=Assignments)
    line_of: Callable[[str], SerialFormat | None] = _no_line
    """Returns the settings of a serial link; None if the times of the link's bytes are unknown."""
    ports: frozenset[int] | None = None
    """TCP ports that should carry Modbus; None for all ports."""
