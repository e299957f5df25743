"""Checks if the baud rate that is assumed for the serial line in a file is too low."""

# Packets of serial link types, and the text of a port monitor, do not contain the baud rate. The
# bytes in such a file come in pieces, each with the time of its last byte. So a piece began as many
# character times earlier as it has bytes. If the assumed rate is too low, a piece seems to begin
# before the previous piece ended: the pieces overlap, and a latency between them would be 0. An
# overlap of one character is allowed, as the recorder's clock is not exact. Measured with
# recordings of sigrok: at the true rate (one at 19200 baud, three at 9600) no pieces overlap, at
# half the true rate half of them do.
#
# Memory: one piece, as only consecutive pieces of one link are compared.

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

from mbtool.core import Chunk, LineSettings, SerialFormat
from mbtool.packets import SERIAL_LINK_TYPES, USER_LINK_TYPES


def serial_types(line: LineSettings | None) -> AbstractSet[int]:
    """Return the link types of packets that contain bytes of a serial line.

    USER0 to USER15 have no fixed meaning. They are among these types only if `line` is not None,
    that is if the user gave the settings of a line.
    """
    return SERIAL_LINK_TYPES if line is None else SERIAL_LINK_TYPES | USER_LINK_TYPES


class HeardLine:
    """Counts the pieces of bytes (packets of a serial line) in one file, and those that overlap at
    an assumed baud rate.
    """

    def __init__(self, name: str, format_: SerialFormat) -> None:
        self.name = name
        self._format = format_
        self._last: Chunk | None = None
        self._pieces = 0
        self._overlaps = 0

    def note(self, piece: object) -> None:
        """Look at the next item of the file; only a chunk (bytes of the line) is counted."""
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
        """A line for the user that asks whether the baud rate is right; None if no pieces
        overlap.
        """
        if not self._overlaps:
            return None
        return (
            f"{self.name}: {self._overlaps:,} of {self._pieces:,} packets overlap "
            f"at {self._format.baud} baud: is the rate right?"
        )


def heard_remarks(heard: Sequence[HeardLine], *, is_named: bool) -> list[str]:
    """Return lines for the user: one that names the files read with the default line settings, and
    one for each file whose assumed baud rate seems wrong.

    `is_named` is True if the user gave the settings, so that no defaults were used.
    """
    remarks = []
    names = [one.name for one in heard if one.has_bytes]
    if names and not is_named:
        first, *others = names
        said = f"{first} and {len(others)} more" if others else first
        usual = SerialFormat()
        remarks.append(f"{said}: taken as {usual}; name the line with --link rtu@{usual}")
    return remarks + [one.doubt for one in heard if one.doubt is not None]
