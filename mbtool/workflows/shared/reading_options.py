"""The user's options for reading captures and logs."""

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
    """The TCP ports of slaves with Modbus/TCP. If empty, the ports stored in the log, or 502."""
    rtu_ports: Sequence[int] = ()
    """The TCP ports of slaves with RTU over TCP."""
    any_port: bool = False
    """True to search for Modbus on all other TCP ports, too."""
    line: LineSettings | None = None
    """The settings (mode, baud rate, character format) of the serial line in the files; None if the
    user gave none."""
    t1_5: Silence | None = None
    """The longest silence inside an RTU frame (t1.5); None to compute it from the baud rate."""
    t3_5: Silence | None = None
    response_timeout: Silence | None = None
    """How long the master of a serial line waits before it repeats a request; None to estimate it
    from the traffic."""
    raw: bool = False
    """True to decode the packets and bytes of a log again, in place of reading its transactions."""
