"""Facts about a capture that rules need beside its transactions: profiles, line settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from mbtool.core import SerialFormat
from mbtool.devices.assignment import Assignments
from mbtool.devices.checking.security_limits import SecurityLimits


def _no_line(_: str) -> SerialFormat | None:
    return None


@dataclass(frozen=True, slots=True)
class CaptureContext:
    """What the rules of `mbtool check` need beside the transactions and events of a capture.

    It holds the user's options and the settings of serial lines.
    """

    assignments: Assignments = field(default_factory=Assignments)
    line_of: Callable[[str], SerialFormat | None] = _no_line
    """Returns the settings (baud rate, character format) of the serial link with a name.

    None if the times of the link's bytes are unknown."""
    has_exact_times: Callable[[str], bool] = lambda _: False
    """True for a serial link if the time of every byte is exact, as from a logic analyser."""
    ports: frozenset[int] | None = None
    """TCP ports that should carry Modbus; None for all ports."""
    limits: SecurityLimits = field(default_factory=SecurityLimits)
    """The limits of the rules about attacks and scans."""
