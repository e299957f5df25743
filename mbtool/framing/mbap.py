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
# unknown function has no structure to compare with, and its header is skipped.
#
# If each call of `feed` brings one TCP segment (`by_segments`), the ends of segments are evidence,
# as masters and slaves begin and end their ADUs with a segment:
#
# - In step, a length of up to LONGEST_LENGTH is possible if the ADU ends with a segment, or if the
#   next header follows. Schneider's UMAS (function 5AH) sends such ADUs.
# - Out of step, an ADU of an unknown function, or one longer than 260 bytes, is accepted if it
#   begins with a segment and ends with one, or is followed by a header. An ADU of a known function
#   needs only one of these: it begins with a segment, it ends with a segment, or a header follows
#   it. If its PDU does not have the length of its function, it must be one whole segment.
# - While an ADU of an unknown function, or one longer than 260 bytes, is incomplete, its header is
#   rejected if a whole ADU behind the header begins and ends with a segment. If the header's
#   function is known, a whole ADU that only ends with a segment is enough to reject the header.
#
# Without `by_segments`, which bytes are dropped depends on the bytes only, never on the ends of
# chunks.
#
# If the capture lacks the end of an ADU whose unit and function it has, the ADU is reported with
# the bytes that are there.
#
# Memory: at most one incomplete ADU (260 bytes; 1460 with `by_segments`) and the last skipped bytes
# (skips.MAX_RUN).

from __future__ import annotations

import re

from mbtool.core import Direction, EventKind, Origin
from mbtool.framing.skips import SkipRun
from mbtool.framing.timed_buffer import TimedBuffer
from mbtool.modbus.adu import (
    MAX_PDU,
    MBAP_BYTES,
    Adu,
    DirectionBy,
    Skipped,
    Transport,
    Verdict,
    mbap_size,
)
from mbtool.modbus.pdu import pdu_length

MIN_LENGTH = 2
MAX_LENGTH = 1 + MAX_PDU
LONGEST_LENGTH = 1454
"""The largest length field that is accepted: that of an ADU which fills the TCP segment of an
Ethernet packet, 1460 bytes. Schneider's UMAS has messages of up to about 1 KB."""

MAX_REQUEST_NS = 1_000_000_000
"""A request gets the verdict LATE_PARTS if its first and last byte are further apart than this, in
ns. It is the shortest time after which an FA3 module can be set to disconnect such a master (its
manual, 10.3, register 00F5H)."""

PARTS_NS = 30_000_000
"""If more than this (ns) passed between the first and the last byte of a request, the transaction
tells how much. A sender that waits for a delayed acknowledgement before it sends the rest waits
longer; a sender that makes two segments at once does not."""

_LENGTH_END = MBAP_BYTES - 1
_MODBUS = b"\x00\x00"
_HEADER = re.compile(rb"(?s)..\x00\x00\x00[%c-%c]" % (MIN_LENGTH, MAX_LENGTH))
"""Matches a transaction id, protocol id 0 and a length from MIN_LENGTH to MAX_LENGTH."""
LONG_HEADER = re.compile(
    rb"(?s)..\x00\x00(?:\x00[%c-\xff]|[\x01-%c].|%c[\x00-%c])"
    % (MIN_LENGTH, (LONGEST_LENGTH >> 8) - 1, LONGEST_LENGTH >> 8, LONGEST_LENGTH & 0xFF)
)
"""Matches a transaction id, protocol id 0 and a length from MIN_LENGTH to LONGEST_LENGTH."""


class MbapSplitter:
    """Takes the bytes of one direction of a Modbus/TCP stream; returns `Adu` and `Skipped`."""

    def __init__(
        self, direction: Direction, *, by_segments: bool = False, is_udp: bool = False
    ) -> None:
        """`by_segments` is True if each call of `feed` brings the payload of one TCP segment,
        `is_udp` if it brings one datagram.
        """
        self._transport = Transport.UDP if is_udp else Transport.TCP
        self._direction = direction
        self._by_segments = by_segments
        self._longest = LONGEST_LENGTH if by_segments else MAX_LENGTH
        self._header = LONG_HEADER if by_segments else _HEADER
        self._buffer = TimedBuffer()
        self._skips = SkipRun(lambda _: (EventKind.SKIPPED, "no Modbus/TCP header", None))
        self._in_step = True

    @property
    def is_idle(self) -> bool:
        """True if no byte is buffered and the next byte begins a header."""
        return self._in_step and not self._buffer

    def feed(self, data: bytes, ts_ns: int, origin: Origin | None = None) -> list[Adu | Skipped]:
        """Take the bytes of one segment; return the ADUs and skipped bytes that they complete.

        `ts_ns` is the segment's time in ns, `origin` the packet that it came in (None if unknown).
        """
        is_idle = self._in_step and not self._buffer.data
        if is_idle and _HEADER.match(data) and data[5] == len(data) - _LENGTH_END:
            # Most segments are one whole ADU, which needs no buffer.
            return [self._adu(data, ts_ns, ts_ns, origin)]
        self._buffer.append(data, ts_ns, origin)
        events: list[Adu | Skipped] = []
        while (size := self._first_size()) is not None and size <= len(self._buffer):
            if size:
                self._skips.end(events)
                self._emit(size, events)
            else:
                self._drop(events)
        return events

    def gap(self, missing: int = 0) -> list[Adu | Skipped]:
        """Note that the capture lacks `missing` bytes here; 0 if the number is unknown.

        Returns the buffered bytes. They become an ADU if its header was captured and its other
        bytes can be among the missing ones; else they become skipped bytes.
        """
        events: list[Adu | Skipped] = []
        held = len(self._buffer)
        size = self._cut_size(missing)
        if size:
            self._skips.end(events)
            self._emit(held, events, missing=size - held)
        events += self.close()
        self._in_step = size > 0 and size == held + missing
        return events

    def close(self) -> list[Adu | Skipped]:
        """End the stream: return the buffered bytes as `Skipped`."""
        events: list[Adu | Skipped] = []
        self._skips.end(events)
        if self._buffer:
            ts_ns = self._buffer.first_ns
            held = self._buffer.take(len(self._buffer))
            events.append(Skipped(ts_ns, EventKind.SKIPPED, "an ADU that never ends", held))
        return events

    def restart(self) -> list[Adu | Skipped]:
        """End a datagram: return the buffered bytes as `Skipped`; the next byte begins an ADU."""
        events = self.close()
        self._in_step = True
        return events

    def _first_size(self) -> int | None:
        """Return the size in bytes of the ADU at the start of the buffer.

        0 if no ADU begins there, None if more bytes are needed to know.
        """
        header = self._buffer.peek(MBAP_BYTES)
        if len(header) < MBAP_BYTES:
            return None
        size = mbap_size(header)
        length = size - _LENGTH_END
        if self._in_step and MIN_LENGTH <= length <= MAX_LENGTH:
            return size
        if header[2:4] != _MODBUS or not MIN_LENGTH <= length <= self._longest:
            return 0
        if length <= MAX_LENGTH:
            pdu_size = pdu_length(self._buffer.peek(length - 1, MBAP_BYTES), self._direction)
            if pdu_size is None:
                return None if len(self._buffer) < size else self._whole_segment(size)
            if pdu_size:
                return (
                    self._known_size(size) if pdu_size == length - 1 else self._whole_segment(size)
                )
        return self._size_by_segments(size)

    def _known_size(self, size: int) -> int | None:
        """Return `size` if an ADU of `size` bytes starts the buffer; 0 if not, None if undecided.

        Used out of step, for a known function: the ends of TCP segments must confirm the ADU.
        """
        if not self._by_segments or self._buffer.is_append_boundary(0):
            return size
        if len(self._buffer) < size:
            return None
        return size if self._may_end_at(size) else 0

    def _whole_segment(self, size: int) -> int:
        """Return `size` if the buffer holds exactly one TCP segment of `size` bytes; else 0.

        An ADU with a malformed PDU is accepted only in this case.
        """
        is_whole = (
            self._by_segments and self._buffer.is_append_boundary(0) and len(self._buffer) == size
        )
        return size if is_whole else 0

    def _size_by_segments(self, size: int) -> int | None:
        """Return `size` if the ends of segments confirm that the first `size` bytes are an ADU.

        0 if they do not, None if more bytes are needed to know.
        """
        if not self._by_segments or not (self._in_step or self._buffer.is_append_boundary(0)):
            return 0
        if len(self._buffer) < size:
            return 0 if self._is_refuted() else None
        return size if self._may_end_at(size) else 0

    def _may_end_at(self, end: int) -> bool:
        """True if a segment ends before index `end` of the buffer, or a header follows."""
        if self._buffer.is_append_boundary(end):
            return True
        following = self._buffer.peek(_LENGTH_END, end)
        if any(following[2:4]):
            return False
        length = mbap_size(following) - _LENGTH_END
        return len(following) < _LENGTH_END or MIN_LENGTH <= length <= LONGEST_LENGTH

    def _is_refuted(self) -> bool:
        """True if an ADU behind the buffer's first byte shows that no ADU begins with that byte."""
        is_unknown = pdu_length(self._buffer.peek(1, MBAP_BYTES), self._direction) == 0
        place = 1
        while (at := self._buffer.find(self._header, place)) is not None:
            place = at + 1
            if self._is_whole_adu(at) and (not is_unknown or self._buffer.is_append_boundary(at)):
                return True
        return False

    def _is_whole_adu(self, at: int) -> bool:
        """True if an ADU begins at an index of the buffer and ends with a segment.

        If its function is unknown, it must begin with a segment.
        """
        end = at + mbap_size(self._buffer.peek(MBAP_BYTES, at))
        if end > len(self._buffer) or not self._buffer.is_append_boundary(end):
            return False
        pdu = self._buffer.peek(end - at - MBAP_BYTES, at + MBAP_BYTES)
        pdu_size = pdu_length(pdu, self._direction)
        return pdu_size == len(pdu) or (pdu_size == 0 and self._buffer.is_append_boundary(at))

    def _cut_size(self, missing: int) -> int:
        """Return the size in bytes of the ADU whose first bytes the buffer holds.

        0 if the buffer does not begin with an ADU, or if the ADU lacks more than `missing` bytes.
        """
        held = len(self._buffer)
        start = self._buffer.peek(held)
        if held <= MBAP_BYTES or start[2:4] != _MODBUS:
            return 0
        size = mbap_size(start)
        if not held < size <= min(held + missing, _LENGTH_END + self._longest):
            return 0
        if self._in_step or self._buffer.is_append_boundary(0):
            return size
        fits = pdu_length(start, self._direction, MBAP_BYTES) == size - MBAP_BYTES
        return size if fits else 0

    def _emit(self, size: int, events: list[Adu | Skipped], missing: int = 0) -> None:
        start_ns, (end_ns, origin) = self._buffer.first_ns, self._buffer.mark_at(size - 1)
        raw = self._buffer.take(size)
        if raw[2:4] != _MODBUS:
            reason = f"protocol id {raw[2:4].hex().upper()}H, where Modbus has 0000H"
            events.append(Skipped(start_ns, EventKind.FOREIGN, reason, raw))
            return
        verdicts = self._verdicts(size, missing, end_ns - start_ns)
        events.append(self._adu(raw, start_ns, end_ns, origin, missing, verdicts))
        self._in_step = True

    def _adu(
        self,
        raw: bytes,
        start_ns: int,
        end_ns: int,
        origin: Origin | None,
        missing: int = 0,
        verdicts: tuple[Verdict, ...] = (),
    ) -> Adu:
        return Adu(
            start_ns=start_ns,
            end_ns=end_ns,
            transport=self._transport,
            direction=self._direction,
            direction_by=DirectionBy.PORT,
            confidence=1.0,
            unit=raw[6],
            pdu=raw[MBAP_BYTES:],
            raw=raw,
            missing=missing,
            transaction_id=raw[0] << 8 | raw[1],
            origin=origin,
            verdicts=verdicts,
        )

    def _verdicts(self, size: int, missing: int, duration_ns: int) -> tuple[Verdict, ...]:
        is_late = self._direction is Direction.REQUEST and duration_ns > MAX_REQUEST_NS
        verdicts = (
            (not self._in_step, Verdict.RESYNCHRONISED),
            (missing > 0, Verdict.CUT),
            (size + missing > _LENGTH_END + MAX_LENGTH, Verdict.OVER_LENGTH),
            (is_late, Verdict.LATE_PARTS),
        )
        return tuple(verdict for is_true, verdict in verdicts if is_true)

    def _drop(self, events: list[Adu | Skipped]) -> None:
        """Skip at least one byte, and all further bytes before the next possible header.

        Appends an event to `events` for every MAX_RUN skipped bytes.
        """
        undecided = len(self._buffer) - MBAP_BYTES + 1
        next_header = self._buffer.find(self._header, 1)
        for piece, ts_ns in self._buffer.drain(min(next_header or undecided, undecided)):
            self._skips.add(piece, ts_ns, events)
        self._in_step = False
