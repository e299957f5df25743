"""Cuts one direction of a Modbus/TCP stream into ADUs."""

# Layout (TCP/IP Implementation Guide V1.0b, 3.1.3):
#
#     transaction id   protocol id   length   unit id   PDU
#     2 bytes          2 bytes       2 bytes  1 byte    length - 1 bytes
#
# Length counts the unit id and the PDU, so a useful ADU has a length of 2 to 254.
#
# The splitter is in step while it knows that the next byte begins a header, as it does at the
# start. In step it accepts every header with a possible length; an ADU with a protocol id other
# than 0 is reported as foreign. An impossible length puts the splitter out of step.
#
# Out of step it drops one byte and looks again. Zeros in register data look like headers, so it
# accepts a header only if its length agrees with the structure of the PDU behind it. The PDU of an
# unknown function has no structure to compare with. Its header is accepted only right behind a gap,
# where a segment begins, and so most likely an ADU.
#
# Which bytes are dropped depends on the bytes only, never on the ends of chunks.
#
# Holds at most one incomplete ADU (260 bytes) and one run of skipped bytes (skips.MAX_RUN).

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.framing.skips import SkipRun
from mbtool.framing.timed_buffer import TimedBuffer
from mbtool.modbus.adu import MAX_PDU, Adu, DirectionBy, Skipped, Transport, Verdict
from mbtool.modbus.adu_bytes import MBAP_BYTES
from mbtool.modbus.pdu import pdu_length

if TYPE_CHECKING:
    from mbtool.core import Direction

MIN_LENGTH = 2
MAX_LENGTH = 1 + MAX_PDU

_MODBUS = b"\x00\x00"
_HEADER = re.compile(rb"(?s)..\x00\x00\x00[%c-%c]" % (MIN_LENGTH, MAX_LENGTH))
"""A transaction id, protocol id 0 and a length from MIN_LENGTH to MAX_LENGTH."""


class MbapSplitter:
    """Takes the bytes of one direction of a Modbus/TCP stream; returns `Adu` and `Skipped`."""

    def __init__(self, direction: Direction) -> None:
        self._direction = direction
        self._buffer = TimedBuffer()
        self._skips = SkipRun(lambda _: (EventKind.SKIPPED, "no Modbus/TCP header", None))
        self._in_step = True
        self._behind_gap = False
        """True if the next undecided byte is the first after a gap."""

    @property
    def is_idle(self) -> bool:
        """True if the splitter holds no byte and the next byte begins a header."""
        return self._in_step and not self._buffer

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the bytes of one segment; return the ADUs and skipped bytes that they complete."""
        self._buffer.append(data, ts_ns)
        events: list[Adu | Skipped] = []
        while (size := self._first_size()) is not None and size <= len(self._buffer):
            if size:
                self._skips.end(events)
                self._emit(size, events)
            else:
                self._drop(events)
        return events

    def gap(self) -> list[Adu | Skipped]:
        """Take the information that bytes are missing here; return the bytes held, as skipped."""
        events = self.close()
        self._in_step = False
        self._behind_gap = True
        return events

    def close(self) -> list[Adu | Skipped]:
        """End the stream: return the bytes held, as skipped."""
        events: list[Adu | Skipped] = []
        self._skips.end(events)
        if self._buffer:
            ts_ns = self._buffer.first_ns
            held = self._buffer.take(len(self._buffer))
            events.append(Skipped(ts_ns, EventKind.SKIPPED, "an ADU that never ends", held))
        return events

    def _first_size(self) -> int | None:
        """The size of the ADU at the start of the buffer.

        0 if none begins there, None if more bytes are needed to know.
        """
        header = self._buffer.peek(MBAP_BYTES)
        if len(header) < MBAP_BYTES:
            return None
        length = header[4] << 8 | header[5]
        size = MBAP_BYTES - 1 + length
        if not MIN_LENGTH <= length <= MAX_LENGTH:
            return 0
        if self._in_step:
            return size
        if header[2:4] != _MODBUS:
            return 0
        pdu_size = pdu_length(self._buffer.peek(length - 1, MBAP_BYTES), self._direction)
        if pdu_size is None:
            return None if len(self._buffer) < size else 0
        if not pdu_size:
            return size if self._behind_gap else 0
        return size if pdu_size == length - 1 else 0

    def _emit(self, size: int, events: list[Adu | Skipped]) -> None:
        start_ns, end_ns = self._buffer.first_ns, self._buffer.ns_at(size - 1)
        raw = self._buffer.take(size)
        if raw[2:4] != _MODBUS:
            reason = f"protocol id {raw[2:4].hex().upper()}H, where Modbus has 0000H"
            events.append(Skipped(start_ns, EventKind.FOREIGN, reason, raw))
            return
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
        self._behind_gap = False

    def _drop(self, events: list[Adu | Skipped]) -> None:
        """Drop the bytes before the next place where a header may begin."""
        undecided = len(self._buffer) - MBAP_BYTES + 1
        next_header = self._buffer.find(_HEADER, 1)
        for piece, ts_ns in self._buffer.drain(min(next_header or undecided, undecided)):
            self._skips.add(piece, ts_ns, events)
        self._in_step = False
        self._behind_gap = False
