"""Follows which bytes of a TCP connection were captured, and which the capture lacks."""

# Two things show that the capture lacks bytes: a gap between two ADUs of one direction, and a
# segment that acknowledges more of the other direction than was captured. Bytes count as lost from
# the end of the last ADU on. If the start of an ADU with its unit and function was captured, the
# ADU can be paired, and its missing bytes do not count as lost. A start without unit and function
# cannot be paired, so it counts as lost like the bytes behind it.

from __future__ import annotations

import msgspec

from mbtool.core import Direction, StreamPlace
from mbtool.packets.stream import LEAD

_KNOWN_START = 8
"""The number of first bytes of a response that tell its unit and function: MBAP and function
code."""

OTHER = {Direction.REQUEST: Direction.RESPONSE, Direction.RESPONSE: Direction.REQUEST}


class AduPlace(msgspec.Struct, frozen=True, gc=False):
    """The position of an ADU in its TCP connection.

    A stream position counts the bytes of one direction: from the connection's beginning or, if the
    capture lacks that, from LEAD bytes before the first captured byte.
    """

    end: int
    """The stream position of the first byte behind the ADU, in the ADU's direction."""
    acknowledged: int | None
    """The stream position in the opposite direction up to which the ADU's sender had received all
    bytes; None if unknown."""


class StreamProgress:
    """Follows up to which positions the bytes of one direction were captured and decoded."""

    def __init__(self) -> None:
        self.captured: int | None = None
        """The stream position behind the last captured byte; None before the first byte, and if the
        source gives no positions."""
        self.unread = 0
        """The number of bytes that the splitter still holds: those captured behind the last ADU and
        behind the last skipped bytes."""
        self.received: int | None = None
        """The stream position in the opposite direction that this direction's last segment
        acknowledged; None if unknown."""
        self.has_part = False
        """True while the splitter holds the start of a response whose end the capture lacks."""
        self.lost_ns: int | None = None
        """The time, in UTC ns, at which all lost bytes behind the last ADU had been sent, at the
        latest; None if unknown."""
        self._missing = 0
        """The number of missing bytes in the gaps behind the last ADU, as they were reported."""
        self._known = 0
        """The stream position up to which all bytes belong to ADUs or were reported as lost."""
        self._acknowledged = 0
        """The highest stream position that was acknowledged while the splitter held the first bytes
        of a response, with its function code."""

    def is_at_rest(self, position: int) -> bool:
        """True if all bytes before a stream position were captured and cut into ADUs.

        False also if a later byte came.
        """
        is_open = self.unread or self._missing or self.has_part
        return not is_open and self.captured == position

    def pass_plain(self, size: int, received: int) -> None:
        """Note `size` bytes of whole ADUs that the array decoder (columns/) decoded.

        `received` is the stream position in the opposite direction that their last segment
        acknowledged.
        """
        assert self.captured is not None
        self.captured += size
        self._known = max(self.captured, self._known)
        self.received = received

    def take(self, place: StreamPlace, size: int) -> None:
        """Note a segment of this direction with `size` bytes of payload, which begin at `place`."""
        if self.captured is None:
            self._begin(place.position)
        self.captured = place.position + size
        self.unread += size
        self.received = place.acknowledged

    def acknowledge(self, received: int | None, *, of_responses: bool = False) -> int:
        """Note that the receiver has all bytes before the stream position `received`.

        Returns the number of bytes that this shows to be lost; 0 if `received` is None. Returns 0
        also while the splitter holds the first bytes of a response, with its function code: the gap
        that follows will show what is lost. `of_responses` is True if this is the slave's
        direction.
        """
        if received is None:
            return 0
        if of_responses and self.unread >= _KNOWN_START:
            self._acknowledged = max(received, self._acknowledged)
            self.has_part = received > (self.captured or 0)
            return 0
        captured = self._begin(received) if self.captured is None else self.captured
        if received > captured:
            self.captured, self.lost_ns = received, None
        elif not self._missing:
            return 0
        return self._bytes_lost_before(received, received)

    def read(self, start: int, end: int) -> int:
        """Note an ADU; return the number of bytes lost between the ADU before it and this one.

        `start` and `end` are the stream positions of its first byte and of the byte behind it.
        """
        lost = self._bytes_lost_before(start, end) if self._missing else 0
        self._known = max(end, self._known)
        self._missing = 0
        self.has_part = False
        return lost

    def skip(self, missing: int, known: int, known_ns: int | None = None) -> None:
        """Note a gap of `missing` bytes; `known` of them belong to an ADU whose start was captured.

        `known_ns` is the time at which the capture shows that all missing bytes had been sent; None
        if unknown.
        """
        self.lost_ns = known_ns
        self.unread = 0
        self._missing += missing - known
        if self.captured is not None:
            self.captured += missing

    def end(self) -> int:
        """End this direction; return the number of bytes lost behind its last ADU."""
        if self.captured is None:
            return self.take_missing_bytes()  # Nothing of this direction was captured.
        end = max(self.captured, self._acknowledged)
        return self._bytes_lost_before(end, end) if self._missing or end > self.captured else 0

    def take_missing_bytes(self) -> int:
        """Return the number of bytes that are missing in the gaps since the last call.

        Used if the source gives its segments no stream positions, and if it gives no segments.
        """
        missing, self._missing = self._missing, 0
        return missing

    def _begin(self, position: int) -> int:
        # Positions count from 0 if the capture has the connection's beginning, else from LEAD bytes
        # before the first captured byte (packets/stream.py). So a first position below LEAD // 2
        # shows that they count from 0.
        self.captured = self._known = 0 if position < LEAD // 2 else position
        return self.captured

    def _bytes_lost_before(self, position: int, known: int) -> int:
        lost = position - self._known
        self._known = max(known, self._known)
        return max(lost, 0)
