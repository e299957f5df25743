"""Cuts what one tap hears on a Modbus ASCII line into frames."""

# A frame is a colon, an even number of hexadecimal digits, CR and LF (Serial Line V1.02, 2.5.2.1).
# A colon always begins a frame anew, and a second of silence ends one that is incomplete. So does
# a clock that was set back.
#
# Holds at most one incomplete frame (513 characters) and a run of skipped ones (skips.MAX_RUN).

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.modbus.adu import MAX_ASCII_ADU, Adu, Checksum, Skipped, Transport, Verdict
from mbtool.modbus.framing import lrc
from mbtool.modbus.skips import SkipRun
from mbtool.modbus.turns import Turns

if TYPE_CHECKING:
    from mbtool.core import SerialFormat

CHARACTER_TIMEOUT_NS = 1_000_000_000
"""The longest silence inside a frame (Serial Line V1.02, 2.5.2.1)."""

_COLON = 0x3A
_LF = 0x0A
_FRAME = re.compile(rb":((?:[0-9A-Fa-f]{2}){3,})\r\n")


class AsciiSplitter:
    """Timed characters of a line in, `Adu` and `Skipped` out, in order."""

    def __init__(self, line: SerialFormat, turns: Turns | None = None) -> None:
        self._character_ns = line.character_ns
        self._turns = turns or Turns()
        self._frame = bytearray()
        self._first_ns = 0
        self._last_ns = 0
        self._noise = SkipRun(lambda _: (EventKind.SKIPPED, "characters outside a frame"))

    @property
    def is_idle(self) -> bool:
        """Whether no frame has begun."""
        return not self._frame

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the characters of one read; `ts_ns` is the time of the last one."""
        events: list[Adu | Skipped] = []
        if not data:
            return events
        first_ns = ts_ns - (len(data) - 1) * self._character_ns
        if ts_ns < self._last_ns:
            events += self.close()
            self._last_ns = first_ns
        events += self.advance(first_ns - self._character_ns)
        for index, byte in enumerate(data):
            self._last_ns = max(self._last_ns, first_ns + index * self._character_ns)
            self._take(byte, events)
        return events

    def advance(self, now_ns: int) -> list[Adu | Skipped]:
        """Learn that the line was silent from the last character until now."""
        events: list[Adu | Skipped] = []
        if now_ns - self._last_ns > CHARACTER_TIMEOUT_NS:
            self._give_up("a frame that ends in a second of silence", events)
            self._noise.end(events)
        return events

    def close(self) -> list[Adu | Skipped]:
        """The capture ends; what is held comes out."""
        events: list[Adu | Skipped] = []
        self._give_up("a frame that never ends", events)
        self._noise.end(events)
        return events

    def _take(self, byte: int, events: list[Adu | Skipped]) -> None:
        if byte == _COLON:
            self._give_up("a frame that another colon cuts off", events)
            self._first_ns = self._last_ns
        elif not self._frame:
            self._noise.add(bytes([byte]), self._last_ns, events)
            return
        self._frame.append(byte)
        if byte == _LF:
            self._finish(events)
        elif len(self._frame) >= MAX_ASCII_ADU:
            self._give_up(f"a frame of more than {MAX_ASCII_ADU} characters", events)

    def _finish(self, events: list[Adu | Skipped]) -> None:
        raw = bytes(self._frame)
        match = _FRAME.fullmatch(raw)
        if match is None:
            self._give_up("a frame that is not pairs of hexadecimal digits, CR and LF", events)
            return
        body = bytes.fromhex(match[1].decode("ascii"))
        checksum = Checksum(body[-1], lrc(body[:-1]))
        if not checksum.ok:
            self._give_up(
                f"a frame with LRC {checksum.received:02X}H, "
                f"where {checksum.computed:02X}H would be right",
                events,
                EventKind.BAD_CHECK,
            )
            return
        verdicts = (Verdict.NOISE_BEFORE,) if self._noise else ()
        self._noise.end(events)
        unit, pdu = body[0], body[1:-1]
        judgement = self._turns.judge(unit, pdu, self._first_ns)
        self._turns.spoke(judgement, unit, pdu, self._last_ns)
        self._frame.clear()
        events.append(
            Adu(
                start_ns=self._first_ns - self._character_ns,
                end_ns=self._last_ns,
                transport=Transport.ASCII,
                direction=judgement.direction,
                direction_by=judgement.by,
                confidence=judgement.confidence,
                unit=unit,
                pdu=pdu,
                raw=raw,
                checksum=checksum,
                verdicts=verdicts,
            )
        )

    def _give_up(
        self, reason: str, events: list[Adu | Skipped], kind: EventKind = EventKind.SKIPPED
    ) -> None:
        """Give the incomplete or wrong frame out as skipped."""
        if self._frame:
            self._noise.end(events)
            events.append(Skipped(self._first_ns, kind, reason, bytes(self._frame)))
            self._frame.clear()
