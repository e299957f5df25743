"""Doubts whether a file's bytes went over the line that they are taken to have gone over."""

# Packets of serial link types do not say how fast the line was. Each piece ends at its time and
# began by so many characters earlier. Where the rate is taken for lower than it was, pieces begin
# before the one before them has ended, and the latency between them comes out as 0. One character
# is left to the clock of who captured. Of sigrok's recordings one overlaps nowhere at 19200 baud,
# three nowhere at 9600; at half of that rate half of their packets do.
#
# Only neighbours of one link are looked at, so nothing is held but the last one.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Chunk

if TYPE_CHECKING:
    from mbtool.core import SerialFormat


class HeardLine:
    """The pieces of one file, at the rate that they are taken to have had."""

    def __init__(self, name: str, format_: SerialFormat) -> None:
        self.name = name
        self._format = format_
        self._last: Chunk | None = None
        self._pieces = 0
        self._overlaps = 0

    def note(self, piece: object) -> None:
        """Look at the next piece; all but bytes of the line is passed over."""
        if not isinstance(piece, Chunk):
            return
        self._pieces += 1
        last, self._last = self._last, piece
        if last is None or last.link != piece.link or last.ts_ns > piece.ts_ns:
            return
        character_ns = self._format.character_ns
        begin_ns = piece.ts_ns - len(piece.data) * character_ns
        self._overlaps += begin_ns + character_ns < last.ts_ns

    @property
    def has_bytes(self) -> bool:
        return self._pieces > 0

    @property
    def doubt(self) -> str | None:
        """One line for a reader where pieces overlap."""
        if not self._overlaps:
            return None
        return (
            f"{self.name}: {self._overlaps} of {self._pieces} packets overlap "
            f"at {self._format.baud} baud: is the rate right?"
        )
