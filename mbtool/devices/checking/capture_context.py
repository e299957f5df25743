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
    """The facts that the rules of `mbtool check` need beside the transactions and events of a
    capture: the user's options and the settings of serial lines.
    """

    assignments: Assignments = field(default_factory=Assignments)
    line_of: Callable[[str], SerialFormat | None] = _no_line
    """Returns the settings (baud rate, character format) of a serial link, given the link's name.

    None if the times of the link's bytes are unknown."""
    has_exact_times: Callable[[str], bool] = lambda _: False
    """Returns True if the time of every byte of a serial link is exact, as from a logic analyser;
    takes the link's name."""
    ports: frozenset[int] | None = None
    """TCP ports that should carry Modbus; None for all ports."""
    limits: SecurityLimits = field(default_factory=SecurityLimits)
    """The limits of the rules about attacks and scans."""
