"""Follows which bytes of a TCP connection were captured, and which the capture lacks."""

# Two things show that the capture lacks bytes: a gap between two ADUs of one direction, and a
# segment that acknowledges more of the other direction than was captured. The lost bytes begin
# behind the last ADU. If unit and function of an ADU were captured, its missing bytes do not count
# as lost, because the ADU is known. Without unit and function, the captured part of an ADU is of no
# use.

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
    """Where an ADU stands in its TCP connection. A position counts the bytes of one direction."""

    end: int
    """The position behind the ADU's last byte, in the ADU's direction."""
    acknowledged: int | None
    """The position up to which the ADU's sender had received the other direction; None if
    unknown."""


class StreamProgress:
    """Follows up to which positions the bytes of one direction were captured and decoded."""

    def __init__(self) -> None:
        self.captured: int | None = None
        """The stream position behind the last captured byte; None before the first byte, and if the
        source gives no positions."""
        self.unread = 0
        """The number of bytes since the last ADU or skipped bytes that the splitter still holds."""
        self.received: int | None = None
        """The position in the other direction that the last segment acknowledged; None if
        unknown."""
        self.has_part = False
        """True while the capture has the start of a response but lacks its end."""
        self.lost_ns: int | None = None
        """When the receiver acknowledged all lost bytes behind the last ADU, in ns; None if
        unknown."""
        self._missing = 0
        """The number of missing bytes that gaps behind the last ADU reported."""
        self._known = 0
        """The position up to which all bytes belong to ADUs or were reported as lost."""
        self._acknowledged = 0
        """The highest position acknowledged while the splitter held a response's first bytes, up to
        its function code."""

    def is_at_rest(self, position: int) -> bool:
        """True if all bytes before a position were captured and read, and no later byte came."""
        is_open = self.unread or self._missing or self.has_part
        return not is_open and self.captured == position

    def pass_plain(self, size: int, received: int) -> None:
        """Note `size` bytes of whole ADUs that were decoded elsewhere.

        `received` is the position in the other direction that their last segment acknowledged.
        """
        assert self.captured is not None
        self.captured += size
        self._known = max(self.captured, self._known)
        self.received = received

    def take(self, place: StreamPlace, size: int) -> None:
        """Note a segment with `size` bytes of payload."""
        if self.captured is None:
            self._begin(place.position)
        self.captured = place.position + size
        self.unread += size
        self.received = place.acknowledged

    def acknowledge(self, received: int | None, *, of_responses: bool = False) -> int:
        """Note that the receiver has all bytes before a position; return the number of lost bytes.

        Returns 0 while the splitter holds a response's first bytes, up to its function code: the
        gap that follows will show what is lost. `of_responses` is True if this direction is the
        slave's.
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
        """Note a gap. `known` of the `missing` bytes belong to an ADU that was read.

        `acknowledged_ns` is when the receiver had acknowledged all of them; None if unknown.
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
        """Return the number of bytes that gaps reported since the last call.

        Used for a source whose segments have no stream positions.
        """
        missing, self._missing = self._missing, 0
        return missing

    def _begin(self, position: int) -> int:
        # Positions are this low only if the capture has the connection's beginning; then they count
        # from 0.
        self.captured = self._known = 0 if position < LEAD // 2 else position
        return self.captured

    def _tell(self, position: int, known: int) -> int:
        lost = position - self._known
        self._known = max(known, self._known)
        return max(lost, 0)
