"""The options of a user for reading captures and logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from mbtool.core import LineSettings, Silence
from mbtool.devices import Assignments


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions:
    """Options for reading files: ports with Modbus, profiles, line settings and silences."""

    assignments: Assignments = field(default_factory=Assignments)
    ports: Sequence[int] = ()
    """TCP ports of slaves. If empty, the ports stored in the log, or 502 if there is no log."""
    rtu_ports: Sequence[int] = ()
    """TCP ports of slaves with RTU over TCP."""
    any_port: bool = False
    """True to look for Modbus on all other TCP ports, too."""
    line: LineSettings | None = None
    """The settings of the serial line in the files; None if the user gave none."""
    t1_5: Silence | None = None
    """The longest silence inside a frame (t1.5), in place of the one from the line's settings."""
    t3_5: Silence | None = None
    response_timeout: Silence | None = None
    """How long the master of a serial line waits before it repeats a request; None to learn it."""
    raw: bool = False
    """True to decode the packets and bytes of a log again."""
