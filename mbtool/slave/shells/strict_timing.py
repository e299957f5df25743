"""Decides, for a slave that demands the standard's silences, which RTU requests get a response."""

# Serial Line V1.02, 2.5.1.1, and the manual of FT1A Touch, 4.1: at least 3.5 characters of silence
# come before each message and after it, and no such silence is inside. A real slave takes all bytes
# between two silences as one message. So a request gets no answer if
#
#     a silence of t3.5 or longer is inside it                 it is two messages, both incomplete
#     a shorter silence, or none, is before or after it        it is part of a longer message
#
# A silence between t1.5 and t3.5 inside a request is accepted: it may be caused by this machine
# reading the port late.
#
# Memory: one request, which waits until the line has been silent for t3.5.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.adu import Verdict

if TYPE_CHECKING:
    from mbtool.core import SerialFormat
    from mbtool.modbus.adu import Adu


class StrictTiming:
    """Holds a request back until the line was silent for t3.5 after it; drops a request if a
    silence before, inside or after it is wrong.
    """

    def __init__(self, line: SerialFormat) -> None:
        self._t3_5_ns = line.t3_5_ns
        self._character_ns = line.character_ns
        self._held: Adu | None = None

    def hear(self, size: int, now_ns: int) -> None:
        """Note a read of the port: `size` bytes, the last of which came at `now_ns`.

        Drops the waiting request if the first of these bytes came less than t3.5 after its end.
        """
        if self._held is not None:
            silence_ns = now_ns - size * self._character_ns - self._held.end_ns
            if silence_ns < self._t3_5_ns:
                self._held = None

    def hold(self, request: Adu) -> None:
        """Keep a complete request until the line was silent for t3.5 after it (`due`).

        A request is dropped at once if the silence before it is too short or one inside it too
        long.
        """
        before_ns, inside_ns = request.silence_before_ns, request.longest_silence_ns
        is_apart = before_ns is None or before_ns >= self._t3_5_ns
        is_apart &= Verdict.GLUED not in request.verdicts
        is_whole = inside_ns is None or inside_ns < self._t3_5_ns
        self._held = request if is_apart and is_whole else None

    def due(self, now_ns: int) -> Adu | None:
        """Return the waiting request once the line has been silent for t3.5 after it; else None."""
        held = self._held
        if held is None or now_ns - held.end_ns < self._t3_5_ns:
            return None
        self._held = None
        return held
