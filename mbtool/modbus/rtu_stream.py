"""Cuts one direction of RTU over TCP into frames."""

# A stream has no silences, but its direction is known, so a frame's length follows from its
# structure, and its CRC confirms it. Where it does not, one byte is dropped and the next tried.
# A function that no table knows has no length here, and its bytes are skipped.
#
# Holds at most one incomplete frame (256 bytes) and a run of skipped bytes (skips.MAX_RUN).

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.adu import (
    MAX_RTU_ADU,
    Adu,
    Checksum,
    DirectionBy,
    Skipped,
    Transport,
    Verdict,
)
from mbtool.modbus.framing import RTU_EXTRA_BYTES, crc
from mbtool.modbus.pdu import pdu_length
from mbtool.modbus.skips import SkipRun
from mbtool.modbus.timed_buffer import TimedBuffer

if TYPE_CHECKING:
    from mbtool.core import Direction


class RtuStreamSplitter:
    """Bytes of one direction in, `Adu` and `Skipped` out, in order."""

    def __init__(self, direction: Direction) -> None:
        self._direction = direction
        self._buffer = TimedBuffer()
        self._skips = SkipRun("no frame with a correct CRC begins here")

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the bytes of one segment."""
        self._buffer.append(data, ts_ns)
        events: list[Adu | Skipped] = []
        while self._step(events):
            pass
        return events

    def gap(self) -> list[Adu | Skipped]:
        """Bytes are missing here: what is held cannot be completed."""
        return self.close()

    def close(self) -> list[Adu | Skipped]:
        """The stream ends; what is held comes out as skipped."""
        events: list[Adu | Skipped] = []
        while self._buffer:
            self._drop_byte(events)
        self._skips.end(events)
        return events

    def _step(self, events: list[Adu | Skipped]) -> bool:
        """Consume one frame or one byte; False where more bytes are needed to decide."""
        buffer = self._buffer
        if len(buffer) < RTU_EXTRA_BYTES:
            return False
        head = buffer.peek(MAX_RTU_ADU)
        length = pdu_length(head[1:], self._direction)
        if length is None:
            return len(head) == MAX_RTU_ADU and self._drop_byte(events)
        size = length + RTU_EXTRA_BYTES
        if length == 0 or size > MAX_RTU_ADU:
            return self._drop_byte(events)
        if len(head) < size:
            return False
        body, received = head[: size - 2], head[size - 2 : size]
        checksum = Checksum(int.from_bytes(received, "little"), crc(body))
        if not checksum.ok:
            return self._drop_byte(events)
        verdicts = (Verdict.RESYNCHRONISED,) if self._skips else ()
        self._skips.end(events)
        start_ns, end_ns = buffer.first_ns, buffer.ns_at(size - 1)
        events.append(
            Adu(
                start_ns=start_ns,
                end_ns=end_ns,
                transport=Transport.RTU_TCP,
                direction=self._direction,
                direction_by=DirectionBy.PORT,
                confidence=1.0,
                unit=body[0],
                pdu=body[1:],
                raw=buffer.take(size),
                checksum=checksum,
                verdicts=verdicts,
            )
        )
        return True

    def _drop_byte(self, events: list[Adu | Skipped]) -> bool:
        ts_ns = self._buffer.first_ns
        self._skips.add(self._buffer.take(1), ts_ns, events)
        return True
