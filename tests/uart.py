"""What a UART hears of a serial line whose settings are others than its own."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.core import SerialFormat

_HALF = 0.5
"""A UART samples each bit in its middle."""


@dataclass(frozen=True, slots=True)
class HeardByte:
    end_ns: float
    value: int
    is_damaged: bool
    """True if the parity or the stop bit is wrong by the settings of the listener."""


class Wire:
    """The level of a line over time: high when idle, and for a bit that is 1."""

    def __init__(self, sent_as: SerialFormat) -> None:
        self._format = sent_as
        self._bit_ns = 1e9 / sent_as.baud
        self._edges = [0.0]
        """When the level changes, in ns; it is high before the first edge and after each even
        one."""
        self._levels = [1]
        self.now_ns = 1e6

    def send(self, data: bytes, after_ns: float) -> None:
        self.now_ns += after_ns
        for byte in data:
            for bit in _bits(byte, self._format):
                if bit != self._levels[-1]:
                    self._edges.append(self.now_ns)
                    self._levels.append(bit)
                self.now_ns += self._bit_ns

    def heard(self, heard_as: SerialFormat) -> Iterator[HeardByte]:
        """The bytes that a listener with these settings gets."""
        bit_ns = 1e9 / heard_as.baud
        at_ns = 0.0
        while (begin_ns := self._next(at_ns, level=0)) is not None:
            if self._level(begin_ns + _HALF * bit_ns):
                at_ns = begin_ns + _HALF * bit_ns
                continue
            places = range(1, heard_as.character_bits)
            bits = [self._level(begin_ns + (place + _HALF) * bit_ns) for place in places]
            data, rest = bits[: heard_as.data_bits], bits[heard_as.data_bits :]
            value = sum(bit << place for place, bit in enumerate(data))
            at_ns = begin_ns + (heard_as.data_bits + 1 + len(rest) - _HALF) * bit_ns
            is_right = rest == _bits(value, heard_as)[1 + heard_as.data_bits :]
            yield HeardByte(at_ns, value, not is_right)
            if not rest[-1]:  # No stop bit: the next start bit can only follow a high level.
                high_ns = self._next(at_ns, level=1)
                if high_ns is None:
                    return
                at_ns = high_ns

    def _level(self, at_ns: float) -> int:
        return self._levels[bisect_right(self._edges, at_ns) - 1]

    def _next(self, at_ns: float, *, level: int) -> float | None:
        """When the line next changes to this level."""
        place = bisect_right(self._edges, at_ns)
        while place < len(self._edges) and self._levels[place] != level:
            place += 1
        return self._edges[place] if place < len(self._edges) else None


def on_the_wire(frames: Iterable[bytes], sent_as: SerialFormat, *, pause_ns: float = 8e6) -> Wire:
    wire = Wire(sent_as)
    for frame in frames:
        wire.send(frame, pause_ns)
    return wire


def _bits(byte: int, line: SerialFormat) -> list[int]:
    """The bits of a character on the line: start, data, parity and stop bits."""
    data = [byte >> place & 1 for place in range(line.data_bits)]
    odd = sum(data) % 2
    parity = {"N": [], "E": [odd], "O": [1 - odd]}[line.parity]
    return [0, *data, *parity, *[1] * line.stop_bits]
