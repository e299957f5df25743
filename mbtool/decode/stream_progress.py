"""Follows which bytes of a TCP connection were captured, and which the capture lacks."""

# Two things show that the capture lacks bytes: a gap between two ADUs of one direction, and a
# segment that acknowledges more of the other direction than was captured. What is lost begins
# behind the last ADU. The missing bytes of an ADU whose unit and function were captured are not
# lost: the ADU is known. Without unit and function, the captured part of an ADU is of no use.

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.packets.stream import LEAD

if TYPE_CHECKING:
    from mbtool.core import StreamPlace

_KNOWN_START = 8
"""The number of first bytes of a response that tell its unit and function: MBAP and function
code."""

OTHER = {Direction.REQUEST: Direction.RESPONSE, Direction.RESPONSE: Direction.REQUEST}


class AduPlace(msgspec.Struct, frozen=True, gc=False):
    """Where an ADU stands in its TCP connection. Positions count bytes."""

    end: int
    """The position behind its last byte, in its direction."""
    acknowledged: int | None
    """The position in the other direction that its sender had received; None if unknown."""


class StreamProgress:
    """The positions up to which the bytes of one direction were captured, and are known."""

    def __init__(self) -> None:
        self.captured: int | None = None
        """The position behind the last byte captured; None before the first one, and if positions
        are unknown."""
        self.unread = 0
        """Bytes behind the last ADU or skipped bytes, which the splitter holds."""
        self.received: int | None = None
        """The position in the other direction that the last segment acknowledged; None if
        unknown."""
        self.has_part = False
        """True while the capture has the start of a response but lacks its end."""
        self.lost_ns: int | None = None
        """When the other end acknowledged all lost bytes behind the last ADU; None if unknown."""
        self._missing = 0
        """Bytes of the gaps behind the last ADU, as they were reported."""
        self._known = 0
        """The position behind the last ADU, or behind the lost bytes already reported."""
        self._acknowledged = 0
        """The highest position acknowledged while the splitter held the known start of a
        response."""

    def is_at_rest(self, position: int) -> bool:
        """True if all bytes before a position were captured and read, and no later byte came."""
        is_open = self.unread or self._missing or self.has_part
        return not is_open and self.captured == position

    def pass_plain(self, size: int, received: int) -> None:
        """Note whole ADUs that were read elsewhere; their last segment acknowledged `received`."""
        assert self.captured is not None
        self.captured += size
        self._known = max(self.captured, self._known)
        self.received = received

    def take(self, place: StreamPlace, size: int) -> None:
        """Note a segment."""
        if self.captured is None:
            self._begin(place.position)
        self.captured = place.position + size
        self.unread += size
        self.received = place.acknowledged

    def acknowledge(self, received: int | None, *, of_responses: bool = False) -> int:
        """Note that the other end received all before a position; return the number of lost bytes.

        Returns 0 while the splitter holds the known start of a response: the gap behind it will
        tell what is lost.
        """
        if received is None:
            return 0
        if of_responses and self.unread >= _KNOWN_START:
            self._acknowledged = max(received, self._acknowledged)
            self.has_part = received > (self.captured or 0)
            return 0
        captured = self._begin(received) if self.captured is None else self.captured
        if received > captured:
            self.captured = received
        elif not self._missing:
            return 0
        return self._tell(received, received)

    def read(self, start: int, end: int) -> int:
        """Note an ADU; return the number of bytes lost between the last ADU and this one."""
        lost = self._tell(start, end) if self._missing else 0
        self._known = max(end, self._known)
        self._missing = 0
        self.has_part = False
        return lost

    def skip(self, missing: int, known: int, acknowledged_ns: int | None = None) -> None:
        """Note a gap. `known` of the missing bytes belong to an ADU that was read.

        `acknowledged_ns` is when the other end had acknowledged all of them; None if unknown.
        """
        self.lost_ns = acknowledged_ns
        self.unread = 0
        self._missing += missing - known
        if self.captured is not None:
            self.captured += missing

    def end(self) -> int:
        """End the stream; return the number of bytes lost at its end."""
        if self.captured is None:
            return 0
        end = max(self.captured, self._acknowledged)
        return self._tell(end, end) if self._missing or end > self.captured else 0

    def without_places(self) -> int:
        """Return the number of bytes that gaps have reported, for a source without positions."""
        missing, self._missing = self._missing, 0
        return missing

    def _begin(self, position: int) -> int:
        # Positions count from 0 if the capture has the beginning of the connection.
        self.captured = self._known = 0 if position < LEAD // 2 else position
        return self.captured

    def _tell(self, position: int, known: int) -> int:
        lost = position - self._known
        self._known = max(known, self._known)
        return max(lost, 0)
