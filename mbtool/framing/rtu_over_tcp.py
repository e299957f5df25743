"""Cuts one direction of RTU over TCP into frames."""

# A TCP stream has no silences, but its direction is known. So function and byte count give the
# length of a frame, and the CRC confirms it. If the CRC is wrong, one byte is skipped, and the next
# byte is tried as the beginning of a frame. The length of a frame of an unknown function is not
# known, so its bytes are skipped. All bytes up to the next known function code are skipped in one
# search, because bytes that are not Modbus would otherwise cost as much time as frames.
#
# Memory: at most one incomplete frame (256 bytes) and the last skipped bytes (skips.MAX_RUN).

from __future__ import annotations

import re
from functools import partial

from mbtool.core import Direction, Origin
from mbtool.framing.rtu_lengths import frame_size, why_skipped
from mbtool.framing.skips import SkipRun
from mbtool.framing.timed_buffer import TimedBuffer
from mbtool.modbus.adu import (
    MAX_RTU_ADU,
    Adu,
    Checksum,
    DirectionBy,
    Skipped,
    Transport,
    Verdict,
    crc,
)
from mbtool.modbus.pdu import LAYOUTS


def _beginnings(direction: Direction) -> re.Pattern[bytes]:
    """Return a pattern that matches where a frame may begin.

    A frame may begin at any byte (the unit) before a function code that tells the frame's length,
    and at the last byte received, since the function code may follow.
    """
    known = bytes(code for code in range(256) if frame_size(bytes((0, code)), direction) != 0)
    return re.compile(rb"(?s).(?:[" + re.escape(known) + rb"]|\Z)")


_BEGINNINGS = {direction: _beginnings(direction) for direction in LAYOUTS}


class RtuStreamSplitter:
    """Takes the bytes of one direction of RTU over TCP; returns `Adu` and `Skipped` in order."""

    def __init__(self, direction: Direction, *, is_udp: bool = False) -> None:
        """`is_udp` is True if each call of `feed` brings one datagram of UDP."""
        self._transport = Transport.RTU_UDP if is_udp else Transport.RTU_TCP
        self._direction = direction
        self._beginnings = _BEGINNINGS[direction]
        self._buffer = TimedBuffer()
        self._skips = SkipRun(partial(why_skipped, directions=(direction,)))

    @property
    def is_idle(self) -> bool:
        """True if the splitter holds no incomplete frame."""
        return not self._buffer

    def feed(self, data: bytes, ts_ns: int, origin: Origin | None = None) -> list[Adu | Skipped]:
        """Take the bytes of one segment; return the frames and skipped bytes that they complete.

        `ts_ns` is the segment's time in ns, `origin` the packet that it came in (None if unknown).
        """
        self._buffer.append(data, ts_ns, origin)
        return self._frames(ended=False)

    def take_rest(self) -> bytes:
        """Return the bytes of which no event has been returned, and forget them."""
        return self._skips.take() + self._buffer.take(len(self._buffer))

    def gap(self, missing: int = 0) -> list[Adu | Skipped]:
        """Note that the capture lacks bytes here: return the buffered bytes, as `close` does.

        A frame whose end is missing is skipped, since no CRC confirms it. `missing`, the number of
        missing bytes, has no influence.
        """
        return self.close()

    def close(self) -> list[Adu | Skipped]:
        """End the stream: return the buffered bytes, as skipped bytes and whole frames."""
        events = self._frames(ended=True)
        self._skips.end(events)
        return events

    def restart(self) -> list[Adu | Skipped]:
        """End a datagram: return the buffered bytes, as `close` does."""
        return self.close()

    def _frames(self, *, ended: bool) -> list[Adu | Skipped]:
        """Remove and return frames and the bytes between them, up to an incomplete frame.

        `ended` is True if no more bytes come, so that an incomplete frame is removed as well.
        """
        events: list[Adu | Skipped] = []
        place = 0
        while (found := self._buffer.find(self._beginnings, place)) is not None:
            place = found
            size = self._size_at(place)
            if size is None and not ended:
                break
            if size:
                self._skip(place, events)
                self._emit(size, events)
                place = 0
            else:
                place += 1
        else:
            place = len(self._buffer)
        self._skip(place, events)
        return events

    def _size_at(self, place: int) -> int | None:
        """Return the size in bytes of the frame that begins at an index of the buffer.

        0 if no frame with a correct CRC begins there, None if more bytes are needed to know.
        """
        start = self._buffer.peek(MAX_RTU_ADU, place)
        size = frame_size(start, self._direction)
        if size is None:
            return None if len(start) < MAX_RTU_ADU else 0
        if size > MAX_RTU_ADU:
            return 0
        if size > len(start):
            return None
        return size if size and crc(start[:size]) == 0 else 0

    def _emit(self, size: int, events: list[Adu | Skipped]) -> None:
        verdicts = (Verdict.RESYNCHRONISED,) if self._skips else ()
        self._skips.end(events)
        start_ns, (end_ns, origin) = self._buffer.first_ns, self._buffer.mark_at(size - 1)
        raw = self._buffer.take(size)
        events.append(
            Adu(
                start_ns=start_ns,
                end_ns=end_ns,
                transport=self._transport,
                direction=self._direction,
                direction_by=DirectionBy.PORT,
                confidence=1.0,
                unit=raw[0],
                pdu=raw[1:-2],
                raw=raw,
                checksum=Checksum(int.from_bytes(raw[-2:], "little"), crc(raw[:-2])),
                origin=origin,
                verdicts=verdicts,
            )
        )

    def _skip(self, size: int, events: list[Adu | Skipped]) -> None:
        for piece, ts_ns in self._buffer.drain(size):
            self._skips.add(piece, ts_ns, events)
