"""Limits that several packages of mbtool use, and the times that a master observes on a link."""

from __future__ import annotations

from dataclasses import dataclass

MODBUS_PORT = 502
"""The TCP and UDP port of Modbus slaves (TCP guide V1.0b, 4.3.1.1)."""

LAST_UNIT = 247
"""The last unit of a serial line (Serial Line V1.02, 2.2); 248 to 255 are reserved."""

MAX_OPEN_REQUESTS = 256
"""The most requests of one link that wait for a response. If one more comes, the decoder no longer
waits for the response to the oldest."""

MAX_CLOCK_STEP_NS = 1_000_000_000
"""If a chunk's time is earlier than the previous chunk's by more than this, in ns, the clock was
set back. A smaller difference is normal: two ports on one line are read at different moments."""

MAX_BACK_NS = 20_000_000
"""If a read of a serial line has an earlier time than the read before it, by at most this many ns,
the time is wrong: its bytes count as sent right behind those of the read before. If it is earlier
by more, the clock was set back."""

SLAVE_CONNECTIONS = 32
"""The default of the most masters that are connected to a slave that mbtool plays."""
SLAVE_IDLE_S = 600.0
"""A slave closes a connection on which no byte came for this time (s), unless the user gives
another one."""
TAP_CONNECTIONS = 64
"""The number of masters that may be connected to a tap at one time, unless the user gives another
one."""
TAP_IDLE_S = 3600.0
"""A tap closes a connection on which no byte came for this time (s), unless the user gives another
one."""
CONNECTIONS_PER_SECOND = 100.0
"""The default of the most new TCP connections that a slave or a tap accepts in a second."""

RESPONSE_TIMEOUT_S = 1.0
"""The default time in s that a master waits for a response."""
TURNAROUND_NS = 100_000_000
"""The default pause of a master after a broadcast, in ns (Serial Line V1.02, 2.4.1: typically 100
to 200 ms)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkLimits:
    """The rules that a master keeps on a link: its timeout, its pauses, one request at a time."""

    timeout_ns: int = round(RESPONSE_TIMEOUT_S * 1_000_000_000)
    """The longest time that the master waits for a response, in ns."""
    one_at_a_time: bool = False
    """True on a serial line and on RTU over TCP: the master sends no request while another one
    waits for its response."""
    pause_ns: int = 0
    """The shortest pause between the last byte on the link and the next request, in ns; 0 for
    none."""
    turnaround_ns: int = TURNAROUND_NS
    """The pause in ns after a broadcast, which has no response, before the next request."""
