"""One direction of a TCP connection: what has come, what is held, what is missing."""

# Positions count bytes from the first one known, without wrapping; sequence numbers are turned into
# positions by their distance from the next one expected, modulo 2^32.
#
# `held` is sorted and its pieces do not overlap: where segments overlap, the first copy wins.
# A piece without data stands for bytes that the capture did not keep (snaplen).
#
# A stream that is joined in the middle begins at the first byte known, and the capture may have
# swapped its first packets: so position 0 stands LEAD bytes before the first segment seen, what
# comes is held, and where it begins is settled as a hole is, without a gap. A SYN settles it.
#
# Bounds: MAX_HELD_BYTES and MAX_HELD_PIECES held (beyond, whoever drives the stream gives up the
# oldest hole), RECENT_BYTES of delivered bytes kept to compare retransmissions with, and
# the places of MAX_GAPS gaps, to know late bytes by, and MAX_ACKNOWLEDGEMENTS of bytes to come.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mbtool.core import Direction, Endpoint

MAX_HELD_BYTES = 64 * 1024
MAX_HELD_PIECES = 64
RECENT_BYTES = 1024
MAX_GAPS = 8
MAX_ACKNOWLEDGEMENTS = 8
LEAD = 64 * 1024

_MASK = 0xFFFFFFFF
_HALF = 0x80000000


class HeldBytes(NamedTuple):
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

    def part(self, start: int, end: int) -> HeldBytes:
        data = self.data[start - self.start : end - self.start]
        return self._replace(start=start, end=end, data=data)


class Stream:
    """The bytes of one direction, in order."""

    __slots__ = (
        "_acknowledgements",
        "_gaps",
        "_recent",
        "acknowledged",
        "beginning",
        "destination",
        "direction",
        "finish",
        "first",
        "held",
        "held_bytes",
        "joining",
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
        self.beginning: int | None = None
        """The sequence number of the first byte that is delivered, once settled."""
        self.joining = False
        """Where the stream begins is not settled."""
        self.position = 0
        """The next byte to deliver."""
        self.finish: int | None = None
        """The position of FIN, once seen."""
        self.acknowledged = 0
        """How far the other end has received, as it says."""
        self.held: list[HeldBytes] = []
        self.held_bytes = 0
        self.latest = (0, 0)
        """Arrival and time of whichever delivered piece was captured last."""
        self._recent = b""
        self._gaps: list[tuple[int, int]] = []
        self._acknowledgements: list[tuple[int, int, int]] = []
        """Positions that the other end has received before they came, with arrival and time."""

    def place(self, sequence: int) -> int:
        """Turn a sequence number into a position. `first` is known."""
        distance = (sequence - (self.first or 0) - self.position) & _MASK
        return self.position + (distance if distance < _HALF else distance - _MASK - 1)

    def begin(self, sequence: int) -> None:
        """Take a sequence number as that of the first byte: a SYN says so."""
        if self.first is None:
            self.first = sequence
        self.position = self.place(sequence)
        self.beginning = sequence
        self.joining = False

    def join(self, sequence: int, arrival: int, ts_ns: int) -> None:
        """Learn of a byte near the beginning of a stream without SYN."""
        self.first = (sequence - LEAD) & _MASK
        self.joining = True
        # All before it was received long ago, so no more than a swap of packets is waited for.
        self.acknowledge(LEAD, arrival, ts_ns)

    def begins_at(self, sequence: int) -> bool:
        """Tell whether a SYN before this sequence number is the one of this stream."""
        if self.joining:
            return 0 <= self.place(sequence) <= (self.held[0].start if self.held else LEAD)
        return self.beginning == sequence

    def rebase(self, sequence: int) -> None:
        """Take a sequence number as that of the next byte, whatever was expected."""
        self.first = (sequence - self.position) & _MASK
        self.joining = False
        self._gaps.clear()
        self.finish = None
        self.acknowledged = self.position
        self._acknowledgements.clear()
        self._recent = b""

    def acknowledge(self, position: int, arrival: int, ts_ns: int) -> None:
        """Note that the other end has received all before a position, which has not come."""
        if position > self.acknowledged:
            self.acknowledged = position
            known = [one for one in self._acknowledgements if one[0] > self.position]
            if len(known) == MAX_ACKNOWLEDGEMENTS:
                _, arrival, ts_ns = known.pop()
            self._acknowledgements = [*known, (position, arrival, ts_ns)]

    def is_overdue(self, arrival: int, packets: int, ts_ns: int, wait_ns: int) -> bool:
        """Bytes that the other end has received have not come within so many packets or ns."""
        for position, since, since_ns in self._acknowledgements:
            if position > self.position:
                return arrival - since >= packets or ts_ns - since_ns >= wait_ns
        return False

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

    def pass_over(self, hole: int) -> None:
        """Give up a hole. Where the stream begins with it, it begins behind it."""
        if self.joining:
            self.begin((self.first or 0) + self.position + hole & _MASK)
            return
        self._gaps = [*self._gaps[1 - MAX_GAPS :], (self.position, self.position + hole)]
        self.advance(b"", hole)

    def take_late(self, piece: HeldBytes) -> bytes:
        """The bytes of a piece whose hole was given up, told once."""
        for gap in self._gaps:
            start, end = max(gap[0], piece.start), min(gap[1], piece.end)
            if start < end:
                self._gaps.remove(gap)
                return piece.part(start, end).data
        return b""

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

    def hold(self, piece: HeldBytes) -> bool:
        """Keep what no held piece has of a piece. True where a second copy differs."""
        differs = False
        merged: list[HeldBytes] = []
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

    def release(self) -> HeldBytes:
        """Take the first held piece."""
        piece = self.held.pop(0)
        self.held_bytes -= len(piece.data)
        return piece
