"""One direction of a TCP connection: what has come, what is held, what is missing."""

# Positions count bytes from the first one known, without wrapping; sequence numbers are turned into
# positions by their distance from the next one expected, modulo 2^32.
#
# `held` is sorted and its pieces do not overlap: where segments overlap, the first copy wins.
# A piece without data stands for bytes that the capture did not keep (snaplen).
#
# Bounds: MAX_HELD_BYTES and MAX_HELD_PIECES held (beyond, whoever drives the stream gives up the
# oldest hole), RECENT_BYTES of delivered bytes kept to compare retransmissions with.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mbtool.core import Direction, Endpoint

MAX_HELD_BYTES = 64 * 1024
MAX_HELD_PIECES = 64
RECENT_BYTES = 1024

_MASK = 0xFFFFFFFF
_HALF = 0x80000000


class Piece(NamedTuple):
    """A run of bytes that waits for what precedes it."""

    start: int
    end: int
    data: bytes
    """Empty where the capture did not keep the bytes."""
    after: int
    """The position in the other direction that this one's sender had received."""
    ts_ns: int
    arrival: int
    """The number of its packet in the connection."""

    def part(self, start: int, end: int) -> Piece:
        data = self.data[start - self.start : end - self.start]
        return self._replace(start=start, end=end, data=data)


class Stream:
    """The bytes of one direction, in order."""

    __slots__ = (
        "_doubted_arrival",
        "_doubted_ns",
        "_recent",
        "acknowledged",
        "destination",
        "direction",
        "finish",
        "first",
        "held",
        "held_bytes",
        "latest",
        "position",
        "source",
    )

    def __init__(self, direction: Direction, source: Endpoint, destination: Endpoint) -> None:
        self.direction = direction
        self.source = source
        self.destination = destination
        self.first: int | None = None
        """The sequence number of position 0, once known."""
        self.position = 0
        """The next byte to deliver."""
        self.finish: int | None = None
        """The position of FIN, once seen."""
        self.acknowledged = 0
        """How far the other end has received, as it says."""
        self.held: list[Piece] = []
        self.held_bytes = 0
        self.latest = (0, 0)
        """Arrival and time of whichever delivered piece was captured last."""
        self._recent = b""
        self._doubted_arrival = 0
        self._doubted_ns = 0

    def place(self, sequence: int) -> int:
        """Turn a sequence number into a position. `first` is known."""
        distance = (sequence - (self.first or 0) - self.position) & _MASK
        return self.position + (distance if distance < _HALF else distance - _MASK - 1)

    def rebase(self, sequence: int) -> None:
        """Take a sequence number as that of the next byte, whatever was expected."""
        self.first = (sequence - self.position) & _MASK
        self.finish = None
        self.acknowledged = self.position
        self._recent = b""

    def acknowledge(self, position: int, arrival: int, ts_ns: int) -> None:
        """Note that the other end has received all before a position."""
        if position > self.acknowledged:
            if self.acknowledged <= self.position < position:
                self._doubted_arrival, self._doubted_ns = arrival, ts_ns
            self.acknowledged = position

    def is_overdue(self, arrival: int, packets: int, ts_ns: int, wait_ns: int) -> bool:
        """Bytes that the other end has received have not come within so many packets or ns."""
        return self.acknowledged > self.position and (
            arrival - self._doubted_arrival >= packets or ts_ns - self._doubted_ns >= wait_ns
        )

    def is_overfull(self) -> bool:
        return self.held_bytes > MAX_HELD_BYTES or len(self.held) > MAX_HELD_PIECES

    def advance(self, data: bytes, length: int) -> None:
        """Move on by delivered bytes, or by `length` bytes that are missing (data is empty)."""
        self.position += length
        if not data:
            self._recent = b""
        elif len(data) >= RECENT_BYTES:
            self._recent = data[-RECENT_BYTES:]
        else:
            self._recent = (self._recent + data)[-RECENT_BYTES:]

    def differs_from_delivered(self, start: int, data: bytes) -> bool:
        """Compare a second copy with what was delivered, as far as that is kept."""
        # A keep-alive probe may carry one arbitrary byte, the one before the next expected
        # (RFC 1122, 4.2.3.6).
        if len(data) == 1 and start == self.position - 1:
            return False
        oldest = self.position - len(self._recent)
        begin = max(start, oldest)
        end = min(start + len(data), self.position)
        return (
            begin < end
            and data[begin - start : end - start] != (self._recent[begin - oldest : end - oldest])
        )

    def hold(self, piece: Piece) -> bool:
        """Keep what no held piece has of a piece. True where a second copy differs."""
        differs = False
        merged: list[Piece] = []
        cursor = piece.start
        for other in self.held:
            if other.end <= cursor or other.start >= piece.end:
                continue
            if other.start > cursor:
                merged.append(piece.part(cursor, other.start))
            begin, end = max(cursor, other.start), min(piece.end, other.end)
            first, second = other.part(begin, end).data, piece.part(begin, end).data
            differs = differs or (bool(first) and bool(second) and first != second)
            cursor = end
        if cursor < piece.end:
            merged.append(piece.part(cursor, piece.end))
        if merged:
            self.held = sorted(self.held + merged)
            self.held_bytes += sum(len(part.data) for part in merged)
        return differs

    def release(self) -> Piece:
        """Take the first held piece."""
        piece = self.held.pop(0)
        self.held_bytes -= len(piece.data)
        return piece
