"""Cuts what one tap hears on a Modbus ASCII line into frames."""

# A frame (modbus/adu.py) begins with a colon; a colon always begins a new frame. It ends with LF.
# It also ends with the character after its first CR, if that character is the line's delimiter or
# if the LRC is correct there. And it ends with CR alone if a colon, a second of silence or the end
# of the capture follows. A second of silence ends an incomplete frame (Serial Line V1.02, 2.5.2.1),
# and so does a clock that was set back. The silences t1.5 and t3.5 have no meaning here.
#
# The delimiter, the last character of a frame, is LF until function 08, sub-function 3 changes it
# (V1.1b3, 6.8.1). The change takes effect when the slave has responded, or when a frame ends with
# the requested delimiter.
#
# If the port has 8 data bits, bit 7 may be a parity bit. So it is ignored in colon, CR and LF.
#
# Memory: at most one incomplete frame (513 characters) and a series of skipped characters
# (skips.MAX_RUN). A frame is parsed at most twice: after its first CR, and at its end.

from __future__ import annotations

import re

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.core.limits import MAX_BACK_NS
from mbtool.framing.skips import SkipRun
from mbtool.modbus.adu import (
    CR,
    LF,
    MAX_ASCII_ADU,
    SEVEN_BITS,
    Adu,
    AsciiFrame,
    DirectionBy,
    Skipped,
    Transport,
    Verdict,
    read_frame,
    why_unreadable,
)
from mbtool.serial_line.bus_model import SURE, BusModel, Classification

CHARACTER_TIMEOUT_NS = 1_000_000_000
"""The longest silence inside a frame, in ns (Serial Line V1.02, 2.5.2.1)."""

_COLON = 0x3A
_EMPTY = 3
"""The most characters of a frame that has no content: a colon, CR and LF."""
_STOP = re.compile(rb"[:\r\n]")
_CHANGE_DELIMITER = b"\x08\x00\x03"


class AsciiSplitter:
    """Takes timed characters of a line; returns `Adu` (frames) and `Skipped`, in order."""

    def __init__(
        self,
        line: SerialFormat,
        bus_model: BusModel | None = None,
        *,
        speaker: Direction | None = None,
        timed: bool = True,
    ) -> None:
        """`speaker` is the direction of all frames if only one direction is heard; else None.

        `timed` is False if the times are not known; then no silence ends a frame.
        """
        self._character_ns = line.character_ns
        self._eight_bits = line.data_bits == 8
        self._model = bus_model or BusModel(timed=timed)
        self._speaker = speaker
        self._timed = timed
        self._delimiter = LF
        self._asked_delimiter = LF
        self._frame = bytearray()
        self._cr = -1
        """The offset of the first CR in the frame; -1 if there is none."""
        self._resynchronised = False
        self._first_ns = 0
        self._last_ns = 0
        self.has_disorder = False
        """True once the time of a read was a little earlier than that of the read before."""
        self._read_ns = 0
        """The time at which the first character of the current read ended, in ns."""
        self._least_ns = 0
        self._given_ns: int | None = None
        """The time at which the last frame that was returned ended, in ns; None at the start."""
        self._noise = SkipRun(lambda _: (EventKind.SKIPPED, "characters outside a frame", None))

    @property
    def is_idle(self) -> bool:
        """True if the splitter holds no incomplete frame."""
        return not self._frame

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the characters of one read; return the frames and skipped characters they complete.

        `ts_ns` is the time at which the last of the characters ended.
        """
        events: list[Adu | Skipped] = []
        if not data:
            return events
        first_ns = ts_ns - (len(data) - 1) * self._character_ns
        if self._timed and ts_ns < self._last_ns <= ts_ns + MAX_BACK_NS:
            self.has_disorder = True
            first_ns = self._last_ns + self._character_ns
        if first_ns + (len(data) - 1) * self._character_ns < self._last_ns:
            if self._timed:
                events += self.close()
            self._last_ns, self._given_ns = first_ns, None
        else:
            events += self.advance(first_ns - self._character_ns)
        self._read_ns, self._least_ns = first_ns, self._last_ns
        seen = data.translate(SEVEN_BITS) if self._eight_bits else data
        offset = 0
        while offset < len(data):
            take = self._take_inside if self._frame else self._take_outside
            offset = take(data, seen, offset, events)
        return events

    def advance(self, now_ns: int) -> list[Adu | Skipped]:
        """Note that the line was silent from the last character until `now_ns`.

        If that is more than 1 s, return the incomplete frame and the skipped characters so far.
        """
        events: list[Adu | Skipped] = []
        if self._timed and now_ns - self._last_ns > CHARACTER_TIMEOUT_NS:
            self._end(events, "a frame that ends in more than 1 s of silence")
            self._noise.end(events)
            self._resynchronised = False
        return events

    def close(self) -> list[Adu | Skipped]:
        """End the capture: return the incomplete frame and the skipped characters so far."""
        events: list[Adu | Skipped] = []
        self._end(events, "a frame that never ends")
        self._noise.end(events)
        self._resynchronised = False
        return events

    def _time(self, offset: int) -> int:
        """Return the time (ns) at which the character at an offset of the current read ended.

        The result is never before the end of the last character of the previous read.
        """
        return max(self._read_ns + offset * self._character_ns, self._least_ns)

    def _take_outside(
        self, data: bytes, seen: bytes, offset: int, events: list[Adu | Skipped]
    ) -> int:
        """Skip the characters of `data` from `offset` to a colon, and begin a frame with the colon.

        `seen` is `data`, with bit 7 cleared if the port has 8 data bits. Returns the offset of the
        next character to take.
        """
        colon = seen.find(b":", offset)
        end = colon if colon >= 0 else len(data)
        while offset < end:
            until = min(end, offset + self._noise.room)
            self._noise.add(data[offset:until], self._time(offset), events)
            offset = until
            self._last_ns = self._time(offset - 1)
        if colon < 0:
            return end
        self._begin(data, colon)
        return colon + 1

    def _take_inside(
        self, data: bytes, seen: bytes, offset: int, events: list[Adu | Skipped]
    ) -> int:
        """Add the characters of `data` from `offset` on to the frame, up to where it may end.

        `seen` is `data`, with bit 7 cleared if the port has 8 data bits. Returns the offset of the
        next character to take.
        """
        frame = self._frame
        behind_cr = self._cr == len(frame) - 1
        stop: int | None
        if behind_cr:
            end, stop = offset + 1, seen[offset]
        else:
            until = offset + MAX_ASCII_ADU - len(frame)
            match = _STOP.search(seen, offset, until)
            end = match.end() if match else min(until, len(data))
            stop = seen[end - 1] if match else None
        if stop == _COLON:
            if end - 1 > offset:
                self._add(data, offset, end - 1)
            self._end(events, "a frame that another colon cuts off")
            self._resynchronised = bool(self._noise) or isinstance(events[-1], Skipped)
            self._begin(data, end - 1)
            return end
        self._add(data, offset, end)
        if stop == LF or (behind_cr and self._is_whole(stop)):
            self._end(events)
        elif len(frame) >= MAX_ASCII_ADU:
            self._end(events, f"a frame of more than {MAX_ASCII_ADU} characters")
            self._resynchronised = True
        elif stop == CR and self._cr < 0:
            self._cr = len(frame) - 1
        return end

    def _begin(self, data: bytes, colon: int) -> None:
        self._first_ns = self._last_ns = self._time(colon)
        self._frame.append(data[colon])
        self._cr = -1

    def _add(self, data: bytes, offset: int, end: int) -> None:
        self._frame += data[offset:end]
        self._last_ns = self._time(end - 1)

    def _is_whole(self, delimiter: int | None) -> bool:
        """True if `delimiter`, the character after the frame's first CR, ends the frame."""
        if delimiter == self._delimiter:
            return True
        frame = read_frame(bytes(self._frame), eight_bits=self._eight_bits)
        return frame is not None and frame.checksum.ok

    def _end(self, events: list[Adu | Skipped], cut: str | None = None) -> None:
        """Append the characters of the frame to `events`: as an `Adu`, or as `Skipped`.

        `cut` is the reason to give for a frame without its end, as a text; None if the frame has
        its end.
        """
        if not self._frame:
            return
        raw = bytes(self._frame)
        self._frame.clear()
        if len(raw) <= _EMPTY and not raw.translate(SEVEN_BITS).strip(b":\r\n"):
            self._noise.add(raw, self._first_ns, events)
            return
        may_be_whole = cut is None or self._cr >= 0
        frame = read_frame(raw, eight_bits=self._eight_bits) if may_be_whole else None
        if frame is not None and frame.checksum.ok:
            self._give(frame, raw, events)
            return
        self._noise.end(events)
        if frame is not None:
            checksum = frame.checksum
            reason = (
                f"a frame with LRC {checksum.received:02X}H, "
                f"where {checksum.computed:02X}H would be right"
            )
            events.append(Skipped(self._first_ns, EventKind.BAD_CHECK, reason, raw, checksum))
        else:
            reason = cut or why_unreadable(raw, eight_bits=self._eight_bits)
            events.append(Skipped(self._first_ns, EventKind.SKIPPED, reason, raw))
        self._model.hear_damage()

    def _give(self, frame: AsciiFrame, raw: bytes, events: list[Adu | Skipped]) -> None:
        unit, pdu = frame.body[0], frame.body[1:]
        classification = self._classify(unit, pdu)
        verdicts = self._verdicts(frame, classification)
        self._noise.end(events)
        events.append(
            Adu(
                start_ns=self._first_ns - self._character_ns,
                end_ns=self._last_ns,
                transport=Transport.ASCII,
                direction=classification.direction,
                direction_by=classification.by,
                confidence=classification.confidence,
                unit=unit,
                pdu=pdu,
                raw=raw,
                checksum=frame.checksum,
                verdicts=verdicts,
            )
        )
        self._given_ns = self._last_ns
        self._resynchronised = False
        if pdu.startswith(_CHANGE_DELIMITER) and len(pdu) == 5:
            self._asked_delimiter = pdu[3] if self._eight_bits else pdu[3] & 0x7F
            if classification.direction is Direction.RESPONSE and classification.confidence >= SURE:
                self._delimiter = self._asked_delimiter

    def _classify(self, unit: int, pdu: bytes) -> Classification:
        if self._speaker is not None:
            return Classification(self._speaker, DirectionBy.PORT, 1.0)
        start_ns = self._first_ns - self._character_ns
        classification = self._model.classify(unit, pdu, start_ns)
        self._model.hear(classification, unit, pdu, start_ns, self._last_ns)
        return classification

    def _verdicts(self, frame: AsciiFrame, classification: Classification) -> tuple[Verdict, ...]:
        """Return the verdicts on a frame.

        If the frame ends with the delimiter that function 08, sub-function 3 requested, that
        becomes the line's delimiter.
        """
        if frame.end == bytes((CR, self._asked_delimiter)):
            self._delimiter = self._asked_delimiter
        verdicts = []
        if self._noise:
            verdicts.append(Verdict.NOISE_BEFORE)
        if self._resynchronised:
            verdicts.append(Verdict.RESYNCHRONISED)
        if self._is_glued():
            verdicts.append(Verdict.GLUED)
        if frame.parity_in_data:
            verdicts.append(Verdict.PARITY_IN_DATA)
        if frame.is_lower_case:
            verdicts.append(Verdict.LOWER_CASE)
        if frame.end != bytes((CR, self._delimiter)):
            verdicts.append(Verdict.OTHER_END)
        if classification.confidence < SURE:
            verdicts.append(Verdict.AMBIGUOUS)
        return tuple(verdicts)

    def _is_glued(self) -> bool:
        """True if the frame begins at the time at which the frame before it ended, or earlier."""
        start_ns = self._first_ns - self._character_ns
        return self._timed and self._given_ns is not None and start_ns <= self._given_ns
