"""Decodes UART characters from the edges of a sampled signal, and finds the line's settings."""

# A character is a start bit (low), data bits from the lowest on, a parity bit if there is one, and
# a stop bit (high). Each bit is sampled in its middle, counted from the falling edge of the start
# bit; the next character may begin from the middle of the stop bit on. A start bit that is high in
# its middle is ignored as a disturbance. A character with a wrong parity or stop bit is decoded
# like any other, because the CRC or LRC of its frame decides whether it is right. A break, which is
# low from end to end, is not decoded.
#
# The settings found are those with the fewest wrong characters. Only those baud rates are tried
# whose bit time is about the length of the shortest pulses.
#
# Memory: the edges of one character, and the edges passed in the last call.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from mbtool.core import SerialFormat

BAUDS = (
    300, 600, 1200, 2400, 4800, 9600, 14400, 19200, 28800, 38400, 57600, 76800, 115200, 230400,
    250000, 460800, 500000, 921600, 1000000,
)  # fmt: skip
MIN_SAMPLES = 4
"""The least number of samples for one bit at which characters can be decoded."""
_PARITIES = "ENO"
"""The parities (even, none, odd) in the order in which they are tried. Even comes first, as 8E1 is
the standard's default. A second stop bit need not be tried: it looks like silence."""
_SHORTEST = 0.02
"""The share of pulses (times between two edges), 0 to 1, that are left out as disturbances when the
shortest pulse is looked for."""
_LEAST_BIT, _MOST_BIT = 0.7, 1.4
"""A baud rate is tried if its bit time is between these multiples of the length of the shortest
pulses."""


class Character(NamedTuple):
    """A UART character that was decoded from a sampled signal."""

    start: int
    """The number of the sample at which its start bit begins."""
    byte: int
    is_wrong: bool
    """True if the parity or the stop bit of the character is wrong."""


class UartChannel:
    """Decodes the UART characters of one channel of a recording."""

    def __init__(self, line: SerialFormat, rate: int, level: int) -> None:
        """`rate` is in samples per second; `level` is that of the first sample, 0 or 1."""
        self._bit = rate / line.baud
        self._data_bits = line.data_bits
        self._parity = line.parity
        self._level = level
        """The level of the signal, 0 or 1, before the first edge in `_edges`."""
        self._edges: list[int] = []
        self._free = 0.0
        """The sample, counted from the start of the recording, from which on the next character may
        begin."""

    def feed(self, edges: Sequence[int], end: int) -> Iterator[Character]:
        """Take the next edges of the channel; yield the characters that are complete.

        `edges` are the numbers of the samples at which the level changes, ascending. There are no
        further edges before the sample `end`.
        """
        self._edges.extend(edges)
        at = 0
        bits = 1 + self._data_bits + (self._parity != "N") + 1
        while (at := self._start_at(at)) < len(self._edges):
            start = self._edges[at]
            if start + bits * self._bit > end:
                break
            levels, after = self._levels(at, bits)
            if levels[0]:  # High in its middle: a disturbance, not a start bit.
                at += 1
                continue
            at = after
            self._free = start + (bits - 0.5) * self._bit
            if any(levels):
                yield self._character(start, levels)
        self._drop(at)

    def _start_at(self, at: int) -> int:
        """Return the index in `_edges` of the next falling edge at which a character may begin.

        The search begins at index `at`. Returns len(_edges) if there is none.
        """
        while at < len(self._edges) and (
            not self._level ^ (at & 1) or self._edges[at] < self._free
        ):
            at += 1
        return at

    def _levels(self, at: int, bits: int) -> tuple[list[int], int]:
        """Sample `bits` bits; the first one begins at the edge with index `at` in `_edges`.

        Returns the level in the middle of each bit, and the index in `_edges` of the first edge
        after the middle of the last bit.
        """
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
    """Find the line settings that fit a channel best; None if no character fits any settings.

    `edges` are the numbers of the samples at which the level changes, up to the sample `end`;
    `rate` is in samples per second, and `level` is that of the first sample.
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
    """The share of characters, 0 to 1, whose parity or stop bit is wrong."""
    return sum(one.is_wrong for one in characters) / len(characters)


def _likely_bauds(edges: Sequence[int], rate: int) -> list[int]:
    """The baud rates whose bit time is about the length of the shortest pulses.

    `edges` are the numbers of the samples at which the level changes; `rate` is in samples per
    second.
    """
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
