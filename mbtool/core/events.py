"""What is worth telling about a wire beside its transactions."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class EventKind(StrEnum):
    """What happened. Stands in the log and in filters, so a value keeps its meaning."""

    SKIPPED = "skipped"
    """Bytes that were captured and could not be read as Modbus."""
    BAD_CHECK = "bad-check"
    """A frame whose CRC or LRC is wrong."""
    FOREIGN = "foreign"
    """Well-formed, but of another protocol."""
    LINE_ERROR = "line-error"
    """What a port's driver tells of its line: parity, framing, break, overrun. Up to 1 s late."""
    GAP = "gap"
    """Bytes that are known to be missing from the capture."""
    OVERLAP = "overlap"
    """A retransmission whose bytes differ from the first copy."""
    DISCARDED = "discarded"
    """What a bound of this program threw away."""
    REFUSED = "refused"
    """A connection through a tap that was not made: the slave cannot be reached, or TLS failed."""
    OPENED = "opened"
    CLOSED = "closed"
    UNREADABLE = "unreadable"
    """A packet or link type this program cannot look into."""
    MISPLACED = "misplaced"
    """What is heard does not fit how the link was named: two ports are exchanged."""
    SPOILT = "spoilt"
    """This program, as the slave, has spoilt an answer on purpose."""
    CUT = "cut"
    """The file ends in the middle of a record, or the capture kept only part of a packet."""


CONNECTION_OPENED, CONNECTION_JOINED = "connection opened", "connection joined"
"""What OPENED events say: the beginning of a connection is in the capture, or is not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WireEvent:
    """Something on a link that is no transaction."""

    ts_ns: int
    link: str
    kind: EventKind
    message: str
    """One sentence for a reader."""
    source: str = ""
    destination: str = ""
    raw: bytes = b""
    """The bytes concerned, where there are any."""
    missing: int = 0
    """How many bytes are lost, as far as that is known."""
    packets: int = 0
    """How many packets of an interface are lost."""
