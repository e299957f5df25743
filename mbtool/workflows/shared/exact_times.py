"""Decides for which serial lines the recorded times of bytes are exact."""

# A file with a time for each byte comes from a logic analyser, whose times are exact, or from a
# program that noted when it read each byte. On a wire a byte ends at least one character time after
# the byte before it. A program now and then reads several bytes at once, and so notes nearly the
# same time for them. So the times of a line count as exact if at most MAX_NEAR_SHARE of its bytes
# come less than MIN_CHARACTERS after the byte before.
#
# Memory: three numbers for each line.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Chunk

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import SerialFormat
    from mbtool.sources.byte_files import SerialPiece

MIN_CHARACTERS = 0.9
"""The shortest plausible time from the end of one byte to the end of the next, in character times.
It is below 1, as the clocks of senders and analysers are a few percent fast or slow."""
MAX_NEAR_SHARE = 0.01
"""A line's times are exact only if at most this share (0 to 1) of its bytes come less than
MIN_CHARACTERS after the byte before. Some may, because a disturbance on the wire can look like a
byte."""


@dataclass(slots=True)
class _LineBytes:
    heard: int = 0
    near: int = 0


class ExactTimes:
    """Counts the bytes of each serial line that come too soon after the byte before them, and so
    decides if the line's times are exact.
    """

    def __init__(self) -> None:
        self._lines: dict[str, _LineBytes] = {}

    def noted(self, pieces: Iterator[SerialPiece], line: SerialFormat) -> Iterator[SerialPiece]:
        """Yield chunks of one byte each, all of a line with the format `line`, and count those that
        come too soon.
        """
        least_ns = MIN_CHARACTERS * line.character_ns
        last_ns = -(1 << 63)
        for piece in pieces:
            if not isinstance(piece, Chunk):
                yield piece
                continue
            noted = self._lines.setdefault(piece.link, _LineBytes())
            noted.heard += 1
            noted.near += piece.ts_ns - last_ns < least_ns
            last_ns = piece.ts_ns
            yield piece

    def is_exact(self, link: str) -> bool:
        """True if the byte times of the line with this link name are exact, as far as they were
        read; False if none were read.
        """
        noted = self._lines.get(link)
        return noted is not None and noted.near <= MAX_NEAR_SHARE * noted.heard
