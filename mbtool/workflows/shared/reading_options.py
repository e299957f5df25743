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
    """The TCP ports at which slaves speak Modbus/TCP. If empty, those stored in the log, or else
    502."""
    rtu_ports: Sequence[int] = ()
    """The TCP ports at which slaves speak RTU over TCP."""
    any_port: bool = False
    """True to look for Modbus at all other TCP ports, too."""
    line: LineSettings | None = None
    """The settings (mode, baud rate, character format) of the serial line in the files; None if the
    user gave none."""
    t1_5: Silence | None = None
    """The longest silence inside an RTU frame (t1.5) that the user gave; None to compute it from
    the baud rate."""
    t3_5: Silence | None = None
    response_timeout: Silence | None = None
    """The time that the master of a serial line waits for a response before it repeats the request;
    None to estimate it from the traffic."""
    raw: bool = False
    """True to decode the packets and bytes of a log again, and not to use the transactions stored
    in it."""
