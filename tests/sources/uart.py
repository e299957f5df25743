"""A serial line bit by bit: what a UART with other settings than the sender's makes of it."""

# The line is a list of the times at which its level changes; it begins idle, which is 1. A receiver
# waits for the level to fall and samples each bit in its middle: data bits from the lowest up,
# parity, one stop bit. Where the stop bit is 0 the byte is damaged. Then the receiver waits for the
# level to fall again, or, like a 16550, takes that bit for the next start bit.

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import LinkError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from mbtool.core import SerialFormat
    from mbtool.ports.line_errors import ErrorCounts


@dataclass(frozen=True, slots=True)
class Heard:
    """One character as a receiver has it."""

    ts_ns: int
    """When its stop bit was sampled."""
    byte: int
    damaged: bool


def bits_of(byte: int, line: SerialFormat) -> list[int]:
    """A character on the wire, from its start bit to its last stop bit."""
    data = [byte >> number & 1 for number in range(line.data_bits)]
    parity = [] if line.parity == "N" else [parity_of(data, line)]
    return [0, *data, *parity, *[1] * line.stop_bits]


def edges_of(frames: Iterable[tuple[int, bytes]], line: SerialFormat) -> list[int]:
    """The level's changes where frames begin at these times, their characters back to back."""
    edges: list[int] = []
    for begin_ns, frame in frames:
        bits = [bit for byte in frame for bit in bits_of(byte, line)]
        level = 1
        for number, bit in enumerate(bits):
            if bit != level:
                edges.append(begin_ns + number * 1_000_000_000 // line.baud)
                level = bit
    return edges


def receive(
    edges: Sequence[int], line: SerialFormat, from_ns: int = 0, *, like_16550: bool = False
) -> Iterator[Heard]:
    """What a receiver with these settings hears from a time on."""
    bit_ns = 1_000_000_000 / line.baud
    has_parity = line.parity != "N"
    at_ns: float = from_ns
    start_ns: float | None = None
    while True:
        if start_ns is None:
            number = bisect_right(edges, at_ns)
            number += number % 2  # An even number of changes before it: this one falls.
            if number >= len(edges):
                return
            start_ns = edges[number]
        middles = [start_ns + (bit + 0.5) * bit_ns for bit in range(2 + line.data_bits + 1)]
        bits = [(bisect_right(edges, middle) + 1) % 2 for middle in middles]
        data = bits[1 : 1 + line.data_bits]
        wrong = has_parity and bits[1 + line.data_bits] != parity_of(data, line)
        stop = 1 + line.data_bits + has_parity
        at_ns = middles[stop]
        byte = sum(bit << place for place, bit in enumerate(data))
        yield Heard(int(at_ns), byte, wrong or not bits[stop])
        start_ns = at_ns - bit_ns / 2 if like_16550 and not bits[stop] else None


def parity_of(data: Sequence[int], line: SerialFormat) -> int:
    return (sum(data) + (line.parity == "O")) % 2


class UartPort:
    """A port that can only be read, on such a line, with a clock of its own that reading moves."""

    damaged: Sequence[int]

    def __init__(
        self,
        edges: Sequence[int],
        *,
        marks: bool = True,
        like_16550: bool = True,
        block_ns: int = 0,
        refuses: int = 0,
    ) -> None:
        """Bytes come in blocks; without marks the driver tells no damage.

        It refuses one baud rate.
        """
        self._edges = edges
        self._marks = marks
        self._like_16550 = like_16550
        self._block_ns = block_ns
        self._refuses = refuses
        self._heard: Iterator[Heard] = iter(())
        self._next: Heard | None = None
        self.now_ns = 1_000_000
        self.damaged = ()
        self.tuned: list[str] = []
        self.is_closed = False

    def clock(self) -> int:
        return self.now_ns

    def open(self, _port: str, _format: SerialFormat) -> UartPort:
        return self

    def tune(self, format_: SerialFormat) -> None:
        if format_.baud == self._refuses:
            raise LinkError(f"its driver does not do {format_}")
        self.tuned.append(str(format_))
        self._heard = receive(self._edges, format_, self.now_ns, like_16550=self._like_16550)
        self._next = next(self._heard, None)

    def read(self, wait_s: float) -> bytes:
        end_ns = self.now_ns + int(wait_s * 1e9)
        self.damaged = ()
        if self._next is None or self._next.ts_ns > end_ns:
            self.now_ns = end_ns
            return b""
        end_ns = max(self._next.ts_ns, self.now_ns) + self._block_ns
        taken: list[Heard] = []
        while self._next is not None and self._next.ts_ns <= end_ns:
            taken.append(self._next)
            self._next = next(self._heard, None)
        self.now_ns = end_ns
        if self._marks:
            self.damaged = [at for at, one in enumerate(taken) if one.damaged]
        return bytes(one.byte for one in taken)

    def counts(self) -> ErrorCounts | None:
        return None

    def close(self) -> None:
        self.is_closed = True
