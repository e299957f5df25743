"""Follows one direction of a TCP connection: delivered, held and missing bytes."""

# A position counts the bytes of the stream from its beginning and, unlike a sequence number, does
# not wrap. A sequence number becomes a position by its distance from the next expected sequence
# number, modulo 2^32.
#
# `held` is sorted, and its pieces do not overlap: where segments overlap, the first copy wins.
# A piece without data stands for bytes that the capture did not keep (snaplen).
#
# If the capture joins a stream in the middle, the stream begins at the first byte captured. But the
# capture may have swapped its first packets. So position 0 lies LEAD bytes before the first segment
# seen, and all bytes are held at first. The bytes before them are awaited like those of a hole, and
# given up without a gap; then the stream begins. A SYN decides the beginning at once.
#
# Limits: MAX_HELD_BYTES and MAX_HELD_PIECES are held (above that, the connection gives up the
# oldest hole). The last RECENT_BYTES delivered are kept to compare retransmissions with, and the
# places of the last MAX_GAPS gaps to recognise bytes that come late. Of acknowledgements of bytes
# that have not come, MAX_ACKNOWLEDGEMENTS are kept.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Chunk, Stamp, StreamPlace

if TYPE_CHECKING:
    from mbtool.core import Connection, Direction, Origin
    from mbtool.packets.plain_bytes import PlainBytes

MAX_HELD_BYTES = 64 * 1024
MAX_HELD_PIECES = 64
RECENT_BYTES = 1024
MAX_GAPS = 8
MAX_ACKNOWLEDGEMENTS = 8
LEAD = 64 * 1024
"""The position of the first segment seen of a stream that the capture joins in the middle. It
leaves room for bytes that precede the segment and come after it, because the capture swapped
packets."""

_MASK = 0xFFFFFFFF
_HALF = 0x80000000


class HeldBytes(NamedTuple):
    """A run of bytes of one segment that waits for earlier bytes."""

    start: int
    end: int
    data: bytes
    """Empty if the capture did not keep the bytes."""
    acknowledged: int
    """The position that the other direction must reach before these bytes are delivered, since
    their segment acknowledges it. 0 if the bytes need not wait, for example because that position
    was reached before.
    """
    ts_ns: int
    arrival: int
    """The number of the packet that brought these bytes, counted in the connection."""
    receipt: int | None = None
    """The position in the other direction that the segment acknowledges; None if unknown."""
    origin: Origin | None = None
    """The packet that brought these bytes."""

    def part(self, start: int, end: int) -> HeldBytes:
        data = self.data[start - self.start : end - self.start]
        return self._replace(start=start, end=end, data=data)


class Stream:
    """One direction of a connection: how far its bytes were delivered, and those that wait."""

    __slots__ = (
        "_acknowledgements",
        "_connection",
        "_gaps",
        "_link",
        "_recent",
        "acknowledged",
        "beginning",
        "direction",
        "finish",
        "held",
        "held_bytes",
        "joining",
        "latest",
        "origin",
        "position",
        "syn_end",
    )

    def __init__(self, direction: Direction, connection: Connection) -> None:
        self.direction = direction
        self._connection = connection
        self._link = connection.link
        self.origin: int | None = None
        """The sequence number of position 0; None until it is known."""
        self.beginning: int | None = None
        """The sequence number of the first byte to deliver; None until it is decided."""
        self.joining = False
        """True while it is undecided where a stream begins that the capture joins in the middle."""
        self.position = 0
        """The position of the next byte to deliver."""
        self.finish: int | None = None
        """The position of the sender's FIN, behind the last byte; None until the FIN has come."""
        self.syn_end: int | None = None
        """The position behind the bytes that came with the SYN, while it is unknown if the sender
        counts the SYN in its sequence numbers; else None."""
        self.acknowledged = 0
        """The highest position that the other end has acknowledged."""
        self.held: list[HeldBytes] = []
        self.held_bytes = 0
        self.latest = (0, 0)
        """The number and the time (ns) of the latest packet whose bytes were delivered."""
        self._recent = b""
        self._gaps: list[tuple[int, int]] = []
        self._acknowledgements: list[tuple[int, int, int]] = []
        """Positions that were acknowledged before their bytes came, each with the number and the
        time of the packet that acknowledged it."""

    def position_of(self, sequence: int) -> int:
        """The position of a sequence number. `origin` must be known."""
        distance = (sequence - (self.origin or 0) - self.position) & _MASK
        return self.position + (distance if distance < _HALF else distance - _MASK - 1)

    def begin(self, sequence: int) -> None:
        """Decide that the stream begins with the byte of a sequence number."""
        if self.origin is None:
            self.origin = sequence
        self.position = self.position_of(sequence)
        self.beginning = sequence
        self.joining = False

    def take_syn(self, sequence: int) -> int:
        """Begin the stream behind a SYN, if it has no beginning yet.

        `sequence` is the number of the SYN. Returns the next number, which is that of the first
        byte.
        """
        sequence = sequence + 1 & _MASK
        if self.beginning is None:
            self.begin(sequence)
        return sequence

    def decide_syn(self, sequence: int) -> None:
        """Find out if the sender counts its SYN (one with bytes) as one sequence number.

        `sequence` is the number of the first byte after those in the SYN, or the acknowledgement of
        the bytes in the SYN. RFC 793 (3.3) says that a SYN counts. The stacks of some test tools do
        not count it: then `sequence` is one lower than expected.
        """
        if self.syn_end is None:
            return
        position = self.position_of(sequence)
        if position == self.syn_end - 1 and self.origin is not None:
            self.origin = self.origin - 1 & _MASK
        if position >= self.syn_end - 1:
            self.syn_end = None

    def join(self, sequence: int, arrival: int, ts_ns: int) -> None:
        """Note the first sequence number seen of a stream whose SYN is not in the capture."""
        self.origin = (sequence - LEAD) & _MASK
        self.joining = True
        # The other end received all earlier bytes long ago, so only swapped packets may still come.
        self.acknowledge(LEAD, arrival, ts_ns)

    def begins_at(self, sequence: int) -> bool:
        """True if a SYN that directly precedes this sequence number can be the stream's own SYN."""
        if self.joining:
            return 0 <= self.position_of(sequence) <= (self.held[0].start if self.held else LEAD)
        return self.beginning == sequence

    def is_new(self, sequence: int, size: int, window: int) -> bool:
        """True if `size` bytes from a sequence number on are no second copy of earlier bytes."""
        if self.origin is None:
            return True
        start = self.position_of(sequence)
        return start + size > self.position or start < self.position - window

    def is_before_next(self, sequence: int) -> bool:
        """True if a sequence number is one less than that of the next expected byte."""
        origin = self.origin
        return origin is not None and not (sequence + 1 - origin - self.position) & _MASK

    @property
    def is_at_rest(self) -> bool:
        """True if nothing is held or undecided, and no FIN has come."""
        undecided = self.origin is None or self.joining or self.syn_end is not None
        return not (undecided or self.held or self.finish is not None)

    def awaits(self, sequence: int) -> bool:
        """True if the stream is at rest, and its next byte has this sequence number."""
        origin = self.origin
        return (
            origin is not None
            and sequence == origin + self.position & _MASK
            and not (self.held or self.joining)
            and self.finish is None
            and self.syn_end is None
        )

    @property
    def next_sequence(self) -> int:
        """The sequence number of the next byte to deliver. `origin` must be known."""
        return (self.origin or 0) + self.position & _MASK

    def pass_plain(self, passed: PlainBytes, arrivals: int) -> None:
        """Take bytes that were read elsewhere, in order; `arrivals` segments came before them."""
        self.advance(passed.tail, passed.size)
        self.latest = (arrivals + passed.last_segment, passed.last_ns)

    @property
    def holds_a_probe(self) -> bool:
        """True if the first held piece is a single byte and the byte behind it has not come."""
        first, *later = self.held
        return len(first.data) == 1 and not (later and later[0].start == first.end)

    def note_finish(self, sequence: int, size: int, window: int) -> None:
        """Note the position of a FIN behind `size` bytes, unless it is more than `window` away."""
        if self.origin is not None:
            finish = self.position_of(sequence) + size
            if abs(finish - self.position) <= window:
                self.finish = finish

    def rebase(self, sequence: int) -> None:
        """Give the next byte this sequence number, and forget gaps, FIN and acknowledgements."""
        self.origin = (sequence - self.position) & _MASK
        self.joining = False
        self._gaps.clear()
        self.finish = None
        self.acknowledged = self.position
        self._acknowledgements.clear()
        self._recent = b""

    def acknowledge(self, position: int, arrival: int, ts_ns: int) -> None:
        """Note that the other end has acknowledged all bytes before `position`.

        Some of these bytes have not come yet. `arrival` and `ts_ns` are number and time of the
        packet that acknowledged them.
        """
        if position > self.acknowledged:
            self.acknowledged = position
            known = [one for one in self._acknowledgements if one[0] > self.position]
            if len(known) == MAX_ACKNOWLEDGEMENTS:
                _, arrival, ts_ns = known.pop()
            self._acknowledgements = [*known, (position, arrival, ts_ns)]

    def acknowledged_ns(self, position: int) -> int | None:
        """When the other end first acknowledged all bytes before a position that is still ahead."""
        return next((ts_ns for end, _, ts_ns in self._acknowledgements if end >= position), None)

    def receipt(self, acknowledgement: int, window: int) -> int | None:
        """The position that the other end acknowledges, unless it is more than `window` away."""
        if self.origin is None:
            return None
        position = self.position_of(acknowledgement)
        if self.finish is not None:
            position = min(position, self.finish)
        return position if -window <= position - self.position <= window else None

    def is_overdue(self, arrival: int, packets: int, ts_ns: int, wait_ns: int, needed: int) -> bool:
        """True if acknowledged bytes have not come within `packets` packets or `wait_ns`.

        `arrival` and `ts_ns` are the number and the time of the newest packet. The time counts from
        when the bytes up to the position `needed` were acknowledged.
        """
        for position, since, since_ns in self._acknowledgements:
            if position > self.position and position >= needed:
                return arrival - since >= packets or ts_ns - since_ns >= wait_ns
        return False

    def is_overfull(self) -> bool:
        """True if more is held than MAX_HELD_BYTES or MAX_HELD_PIECES."""
        return self.held_bytes > MAX_HELD_BYTES or len(self.held) > MAX_HELD_PIECES

    def advance(self, data: bytes, length: int) -> None:
        """Move on by `length` bytes, whose last ones are `data`; empty if they are missing."""
        self.position += length
        if not data:
            self._recent = b""
        elif len(data) >= RECENT_BYTES:
            self._recent = data[-RECENT_BYTES:]
        else:
            self._recent = (self._recent + data)[-RECENT_BYTES:]

    def deliver(self, data: bytes, receipt: int | None, origin: Origin | None) -> Chunk:
        """Take the next bytes, and give them as a chunk with the time of `latest`.

        `receipt` and `origin` are as in HeldBytes.
        """
        place = StreamPlace(self.position, receipt, origin)
        self.advance(data, len(data))
        return Chunk(
            ts_ns=self.latest[1],
            link=self._link,
            data=data,
            direction=self.direction,
            stamp=Stamp.AT_ONCE,
            connection=self._connection,
            place=place,
        )

    def pass_over(self, hole: int) -> None:
        """Give up the hole at the current position; `hole` is its length in bytes.

        If it is still undecided where the stream begins, it begins behind the hole.
        """
        if self.joining:
            self.begin((self.origin or 0) + self.position + hole & _MASK)
            return
        self._gaps = [*self._gaps[1 - MAX_GAPS :], (self.position, self.position + hole)]
        self.advance(b"", hole)

    def take_late(self, piece: HeldBytes) -> bytes:
        """The bytes of a piece that come after their hole was given up; empty if there are none.

        Bytes are returned only once for each hole that was given up.
        """
        for gap in self._gaps:
            start, end = max(gap[0], piece.start), min(gap[1], piece.end)
            if start < end:
                self._gaps.remove(gap)
                return piece.part(start, end).data
        return b""

    def differs_from_delivered(self, start: int, data: bytes) -> bool:
        """True if `data`, sent again from position `start` on, differs from what was delivered.

        Only the last RECENT_BYTES delivered are compared.
        """
        # A keep-alive probe may carry any one byte in place of the one before the next expected
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
        """Hold those bytes of a piece that are not held yet.

        Returns True if bytes of the piece that are held already differ from the held copy.
        """
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
        """Remove and return the first held piece."""
        piece = self.held.pop(0)
        self.held_bytes -= len(piece.data)
        return piece
