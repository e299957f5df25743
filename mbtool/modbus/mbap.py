"""Cuts one direction of a Modbus/TCP stream into ADUs."""

# Layout (TCP/IP Implementation Guide V1.0b, 3.1.3):
#
#     transaction id   protocol id   length   unit id   PDU
#     2 bytes          2 bytes       2 bytes  1 byte    length - 1 bytes
#
# Length counts the unit id and the PDU, so a useful ADU has length 2..254.
#
# In step, a plausible header is believed; one with another protocol id is one foreign ADU. A header
# that cannot be puts the splitter out of step: it drops one byte and looks again, and then believes
# only a header whose length agrees with the structure of the PDU behind it, since zeros in register
# data look like headers. Whether to drop depends only on bytes, never on where a chunk ended.
#
# Holds at most one incomplete ADU (260 bytes) and a run of skipped bytes (skips.MAX_RUN).

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.modbus.adu import Adu, DirectionBy, Skipped, Transport, Verdict
from mbtool.modbus.framing import MBAP_BYTES
from mbtool.modbus.pdu import pdu_length
from mbtool.modbus.skips import SkipRun
from mbtool.modbus.timed_buffer import TimedBuffer

if TYPE_CHECKING:
    from mbtool.core import Direction

MIN_LENGTH = 2
MAX_LENGTH = 254


class MbapSplitter:
    """Bytes of one direction in, `Adu` and `Skipped` out, in order."""

    def __init__(self, direction: Direction) -> None:
        self._direction = direction
        self._buffer = TimedBuffer()
        self._skips = SkipRun("no Modbus/TCP header")
        self._in_step = True

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the bytes of one segment."""
        self._buffer.append(data, ts_ns)
        events: list[Adu | Skipped] = []
        while self._step(events):
            pass
        return events

    def gap(self) -> list[Adu | Skipped]:
        """Bytes are missing here: what is held cannot be completed."""
        events = self.close()
        self._in_step = False
        return events

    def close(self) -> list[Adu | Skipped]:
        """The stream ends; what is held comes out as skipped."""
        events: list[Adu | Skipped] = []
        self._skips.end(events)
        if self._buffer:
            ts_ns = self._buffer.first_ns
            held = self._buffer.take(len(self._buffer))
            events.append(Skipped(ts_ns, EventKind.SKIPPED, "an ADU that never ends", held))
        return events

    def _step(self, events: list[Adu | Skipped]) -> bool:
        """Consume one ADU or one byte; False where more bytes are needed to decide."""
        buffer = self._buffer
        if len(buffer) < MBAP_BYTES:
            return False
        head = buffer.peek(MBAP_BYTES)
        length = head[4] << 8 | head[5]
        if not MIN_LENGTH <= length <= MAX_LENGTH:
            return self._drop_byte(events)
        foreign = head[2] != 0 or head[3] != 0
        if foreign and not self._in_step:
            return self._drop_byte(events)
        size = 6 + length
        if not self._in_step:
            verdict = self._agrees(size)
            if verdict is None:
                return False
            if not verdict:
                return self._drop_byte(events)
        if len(buffer) < size:
            return False
        self._skips.end(events)
        start_ns = buffer.first_ns
        end_ns = buffer.ns_at(size - 1)
        raw = buffer.take(size)
        if foreign:
            protocol = raw[2] << 8 | raw[3]
            reason = f"protocol id {protocol:04X}H, where Modbus has 0000H"
            events.append(Skipped(start_ns, EventKind.FOREIGN, reason, raw))
            return True
        events.append(
            Adu(
                start_ns=start_ns,
                end_ns=end_ns,
                transport=Transport.TCP,
                direction=self._direction,
                direction_by=DirectionBy.PORT,
                confidence=1.0,
                unit=raw[6],
                pdu=raw[MBAP_BYTES:],
                raw=raw,
                transaction_id=raw[0] << 8 | raw[1],
                verdicts=() if self._in_step else (Verdict.RESYNCHRONISED,),
            )
        )
        self._in_step = True
        return True

    def _agrees(self, size: int) -> bool | None:
        """Whether the PDU's structure has the header's length; None where more bytes are needed."""
        available = min(size, len(self._buffer))
        expected = pdu_length(self._buffer.peek(available)[MBAP_BYTES:], self._direction)
        if expected is None:
            return None if available < size else False
        return expected == size - MBAP_BYTES

    def _drop_byte(self, events: list[Adu | Skipped]) -> bool:
        ts_ns = self._buffer.first_ns
        self._skips.add(self._buffer.take(1), ts_ns, events)
        self._in_step = False
        return True
