"""Events of a link: all that is reported beside transactions, such as a gap or skipped bytes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Self


class EventKind(StrEnum):
    """The kind of an event. Logs and filters contain these values, so they never change."""

    SKIPPED = "skipped"
    """Captured bytes that could not be read as Modbus."""
    BAD_CHECK = "bad-check"
    """A frame whose CRC or LRC is wrong."""
    FOREIGN = "foreign"
    """Well-formed bytes of another protocol, such as an MBAP header whose protocol id is not 0."""
    LINE_ERROR = "line-error"
    """Errors that a port's driver reports: parity, framing, break, overrun. The time of the event
    may be up to 1 s after the error."""
    GAP = "gap"
    """Bytes that are known to be missing from the capture."""
    OVERLAP = "overlap"
    """A retransmission whose bytes differ from the first copy."""
    DISCARDED = "discarded"
    """Data that was dropped because a limit of this program was exceeded."""
    REFUSED = "refused"
    """A tap could not make a connection: the master is not allowed, the slave cannot be reached, or
    TLS failed."""
    BLOCKED = "blocked"
    """A read-only tap did not pass a request on to the slave, and answered it itself."""
    OPENED = "opened"
    CLOSED = "closed"
    UNREADABLE = "unreadable"
    """A packet or link type that this program cannot read."""
    MISPLACED = "misplaced"
    """The two ports of a link are in the wrong order: the one for the master receives responses."""
    ECHO = "echo"
    """The second copy of a request, from an adapter that also receives its own bytes."""
    REPEATED = "repeated"
    """The second copy of a response, from a repeater that sends each frame again, or from two taps
    of one line."""
    TWO_MASTERS = "two-masters"
    """Several masters seem to be on a serial line: requests come while other requests still wait
    for their response. Reported once for each line."""
    SPOILT = "spoilt"
    """This program, playing the slave, distorted a response on purpose, as the user asked."""
    UNRECORDED = "unrecorded"
    """This program, playing a recording, was asked what the recording has no request for."""
    CLOCK_STEP = "clock-step"
    """Somebody set the system's clock during the recording. The times in the log do not jump."""
    DISORDER = "disorder"
    """Reads of a serial line have times a little before those of the reads before, so that its
    silences are uncertain. Reported once for each line."""
    CUT = "cut"
    """The file ends in the middle of a record, or the capture kept only part of a packet."""


CONNECTION_CLOSED = "connection closed: "
"""The beginning of the message of CLOSED events; ConnectionEnd reads the rest."""
CONNECTION_OPENED, CONNECTION_JOINED = "connection opened", "connection joined"
"""The messages of OPENED events. The first is for a connection whose beginning is in the capture,
the second for one that had begun before the capture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WireEvent:
    """Something that happened on a link and is no transaction, such as a gap."""

    ts_ns: int
    link: str
    kind: EventKind
    message: str
    """A sentence for the user that says what happened."""
    source: str = ""
    destination: str = ""
    raw: bytes = b""
    """The bytes that the event is about, such as the skipped ones; empty if there are none."""
    missing: int = 0
    """Number of bytes that the capture lacks; 0 if unknown."""
    packets: int = 0
    """Number of packets of a network interface that the capture lacks; 0 if none or unknown."""


@dataclass(frozen=True, slots=True)
class ConnectionEnd:
    """How a TCP connection ended, as the message of its CLOSED event says it. A log stores this
    message, so it is read from the text.
    """

    reason: str
    """A value of CloseReason (packets/stream_events.py), such as `reset`; a text of another version
    of mbtool is kept as it is."""
    by: str = ""
    """`master` or `slave`: who sent the RST or the first FIN; empty if nobody did or it is
    unknown."""
    keep_alives: int = 0
    """The number of keep-alive probes of both ends."""
    unanswered: int = 0
    """The number of keep-alive probes of one end to which the other end never replied, at the end
    of the connection."""

    @classmethod
    def of(cls, event: WireEvent) -> Self | None:
        """Read the message of a CLOSED event; None for an event of another kind."""
        match = _CLOSED.match(event.message) if event.kind is EventKind.CLOSED else None
        if match is None:
            return None
        probes, unanswered = (int(number or 0) for number in match.group("probes", "unanswered"))
        return cls(match["reason"], match["by"] or "", probes, unanswered)


_CLOSED = re.compile(
    rf"{CONNECTION_CLOSED}(?P<reason>.+?)(?: by the (?P<by>master|slave))?"
    r"(?:, (?P<probes>\d+) keep-alive probes)?(?:, the last (?P<unanswered>\d+) unanswered)?$"
)
