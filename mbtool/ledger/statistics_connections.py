"""Counts how the TCP connections of each master to each slave were opened, kept and closed."""

# Memory: one ConnectionTally for each pair of a master and a slave; the caller limits the number of
# pairs.

from __future__ import annotations

from dataclasses import dataclass, field

from mbtool.core import CONNECTION_JOINED, ConnectionEnd, EventKind, WireEvent

_OTHER = "other"
_REASONS = frozenset((
    "finished", "reset", "refused", "unanswered", "replaced", "idle", "discarded", "capture-end",
))  # fmt: skip


@dataclass(slots=True)
class ConnectionTally:
    """Counts the TCP connections from one master to one slave."""

    opened: int = 0
    """The number of connections that were opened during the capture and not refused."""
    joined: int = 0
    """The number of connections that were already open when the capture began."""
    refused_by_tap: int = 0
    """The number of connections that a tap (a relay between master and slave) refused, for example
    because it could not reach the slave."""
    closed: dict[str, int] = field(default_factory=dict)
    """The number of closed connections, by the reason that the CLOSED event names: finished (FIN),
    reset (RST), refused, unanswered (nobody answered the SYN), replaced by a new connection with
    the same ports, idle for long, discarded (too many connections), capture-end (still open then),
    or other."""
    keep_alives: int = 0
    """The number of TCP keep-alive probes that master and slave sent."""
    unanswered_keep_alives: int = 0
    """The number of keep-alive probes that the peer had not answered when a connection closed."""
    most_at_once: int = 0
    """The largest number of connections that were open at the same time."""
    _open: int = 0

    def add(self, event: WireEvent) -> None:
        """Count an event about a connection: OPENED, CLOSED, or REFUSED by a tap."""
        if event.kind is EventKind.REFUSED:
            self.refused_by_tap += 1
        elif event.kind is EventKind.OPENED:
            is_joined = event.message.startswith(CONNECTION_JOINED)
            self.joined += is_joined
            self.opened += not is_joined
            self._open += 1
            self.most_at_once = max(self.most_at_once, self._open)
        elif event.kind is EventKind.CLOSED:
            self._open = max(self._open - 1, 0)
            self._note_end(ConnectionEnd.of(event) or ConnectionEnd(_OTHER))

    def add_whole(self, opened: int, closed: int, most: int) -> None:
        """Count connections that were opened, and others that were closed with FIN. At some time
        `most` more than before were open.
        """
        self.opened += opened
        self.most_at_once = max(self.most_at_once, self._open + most)
        self._open = max(self._open + opened - closed, 0)
        if closed:
            self.closed["finished"] = self.closed.get("finished", 0) + closed

    def _note_end(self, end: ConnectionEnd) -> None:
        reason = end.reason if end.reason in _REASONS else _OTHER
        self.closed[reason] = self.closed.get(reason, 0) + 1
        if reason == "refused" and self.opened:  # An OPENED event was counted before the refusal.
            self.opened -= 1
        self.keep_alives += end.keep_alives
        self.unanswered_keep_alives += end.unanswered

    @property
    def resets(self) -> int:
        return self.closed.get("reset", 0)

    @property
    def refused(self) -> int:
        """The number of connections that the slave or the tap refused."""
        return self.closed.get("refused", 0) + self.refused_by_tap
