"""Decodes UART characters from the edges of a sampled signal, and finds the line's settings."""

# A character is a start bit (low), data bits from the lowest on, a parity bit if there is one, and
# a stop bit (high). Each bit is sampled in its middle, counted from the falling edge of the start
# bit; the next character may begin from the middle of the stop bit on. A start bit that is high in
# its middle is a disturbance. A character with a wrong parity or stop bit is a byte like any other,
# as the check of the frame decides; a break, which is low from end to end, is none.
#
# The settings are those with the fewest wrong characters. The baud rates that are tried are those
# whose bit is about as long as the shortest pulses.
#
# Memory: the edges of one character, and those of the samples that were given last.

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import SerialFormat

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

BAUDS = (
    300, 600, 1200, 2400, 4800, 9600, 14400, 19200, 28800, 38400, 57600, 76800, 115200, 230400,
    250000, 460800, 500000, 921600, 1000000,
)  # fmt: skip
MIN_SAMPLES = 4
"""The least samples of a bit."""
_PARITIES = "ENO"
"""8E1 first, as the standard demands it. A listener hears a second stop bit as silence."""
_SHORTEST = 0.02
"""The share of pulses, 0 to 1, that may be shorter than a bit: disturbances."""
_LEAST_BIT, _MOST_BIT = 0.7, 1.4
"""A bit that is tried has this many times the length of the shortest pulses."""


class Character(NamedTuple):
    """A character on the line."""

    start: int
    """The sample at which its start bit begins."""
    byte: int
    is_wrong: bool
    """True if its parity or its stop bit is wrong."""


class UartChannel:
    """Decodes the characters of one channel."""

    def __init__(self, line: SerialFormat, rate: int, level: int) -> None:
        """`rate` is in samples per second; `level` is that of the first sample, 0 or 1."""
        self._bit = rate / line.baud
        self._data_bits = line.data_bits
        self._parity = line.parity
        self._level = level
        """The level before the first edge in `_edges`."""
        self._edges: list[int] = []
        self._free = 0.0
        """Where the next character may begin, in samples."""

    def feed(self, edges: Sequence[int], end: int) -> Iterator[Character]:
        """Take the samples at which the level changes, up to the sample `end`; give characters."""
        self._edges.extend(edges)
        at = 0
        bits = 1 + self._data_bits + (self._parity != "N") + 1
        while (at := self._start_at(at)) < len(self._edges):
            start = self._edges[at]
            if start + bits * self._bit > end:
                break
            levels, after = self._levels(at, bits)
            if levels[0]:  # A disturbance, not a start bit.
                at += 1
                continue
            at = after
            self._free = start + (bits - 0.5) * self._bit
            if any(levels):
                yield self._character(start, levels)
        self._drop(at)

    def _start_at(self, at: int) -> int:
        """The index of the next falling edge at which a character may begin."""
        while at < len(self._edges) and (
            not self._level ^ (at & 1) or self._edges[at] < self._free
        ):
            at += 1
        return at

    def _levels(self, at: int, bits: int) -> tuple[list[int], int]:
        """The level in the middle of each bit, and the index of the first edge behind the last."""
        levels = []
        start = self._edges[at]
        for bit in range(bits):
            middle = start + (bit + 0.5) * self._bit
            while at < len(self._edges) and self._edges[at] <= middle:
                at += 1
            levels.append(self._level ^ (at & 1))
        return levels, at

    def _character(self, start: int, levels: Sequence[int]) -> Character:
        data = levels[1 : 1 + self._data_bits]
        byte = sum(level << bit for bit, level in enumerate(data))
        is_wrong = not levels[-1]
        if self._parity != "N":
            ones = sum(data) + levels[1 + self._data_bits]
            is_wrong = is_wrong or ones % 2 != (self._parity == "O")
        return Character(start, byte, is_wrong)

    def _drop(self, count: int) -> None:
        count = min(count, len(self._edges))
        self._level ^= count & 1
        del self._edges[:count]


def find_format(edges: Sequence[int], end: int, rate: int, level: int) -> SerialFormat | None:
    """The settings that explain a channel best; None if no character fits any.

    `edges` are the samples at which its level changes, up to the sample `end`.
    """
    best: tuple[float, SerialFormat] | None = None
    for baud in _likely_bauds(edges, rate):
        for parity in _PARITIES:
            line = SerialFormat(baud, 8, parity, 1)
            found = list(UartChannel(line, rate, level).feed(edges, end))
            if found:
                share = wrong_share(found)
                if best is None or share < best[0]:
                    best = share, line
    return None if best is None else best[1]


def wrong_share(characters: Sequence[Character]) -> float:
    """The share of characters with a wrong parity or stop bit, 0 to 1."""
    return sum(one.is_wrong for one in characters) / len(characters)


def _likely_bauds(edges: Sequence[int], rate: int) -> list[int]:
    """The baud rates whose bit is about as long as the shortest pulses."""
    pulses = sorted(after - before for before, after in pairwise(edges))
    if not pulses:
        return []
    shortest = pulses[int(len(pulses) * _SHORTEST)]
    bits = {baud: rate / baud for baud in BAUDS}
    return [
        baud
        for baud, bit in bits.items()
        if bit >= MIN_SAMPLES and _LEAST_BIT <= bit / shortest <= _MOST_BIT
    ]
