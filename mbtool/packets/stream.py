"""Keeps one direction of a TCP connection in order: delivered bytes, waiting bytes, missing
bytes.
"""

# A position counts the bytes of the stream from its beginning and, unlike a sequence number, does
# not wrap. A sequence number becomes a position by its distance from the next expected sequence
# number, modulo 2^32.
#
# `held` has the bytes that came before earlier ones. It is sorted, and its pieces do not overlap:
# where segments overlap, the first copy wins. A piece without data stands for bytes that the
# capture did not keep (snaplen).
#
# If the capture starts in the middle of a stream, the stream begins at the first byte captured. But
# the capture may have swapped its first packets. So position 0 lies LEAD bytes before the first
# segment seen, and for a short time all bytes wait for possible earlier ones. If none come, the
# stream begins with the first bytes seen, without a gap. A SYN decides the beginning at once.
#
# Limits: at most MAX_HELD_BYTES and MAX_HELD_PIECES wait for earlier bytes; above that, the
# connection treats the oldest missing bytes as lost. The last RECENT_BYTES delivered are kept to
# compare retransmissions with, the positions of the last MAX_GAPS gaps to recognise bytes that come
# late, and the last MAX_ACKNOWLEDGEMENTS acknowledgements of bytes that have not come.

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
"""The position given to the first segment seen of a stream if the capture starts in its middle.
Earlier positions are for bytes that precede the segment but come after it, because the capture
swapped packets."""

_MASK = 0xFFFFFFFF
_HALF = 0x80000000


class HeldBytes(NamedTuple):
    """Bytes of one segment that wait for earlier bytes, at the positions `start` to `end`
    (exclusive).
    """

    start: int
    end: int
    data: bytes
    """Empty if the capture did not keep the bytes."""
    acknowledged: int
    """The position that the other direction must reach before these bytes are delivered, since
    their segment acknowledges it; 0 if they need not wait for it."""
    ts_ns: int
    arrival: int
    """The number of the segment that brought these bytes, counted from 1 in its connection."""
    receipt: int | None = None
    """The position in the other direction that the segment acknowledges; None if unknown."""
    origin: Origin | None = None
    """The packet that brought these bytes."""

    def part(self, start: int, end: int) -> HeldBytes:
        data = self.data[start - self.start : end - self.start]
        return self._replace(start=start, end=end, data=data)


class Stream:
    """One direction of a TCP connection: how far it was delivered, and bytes that wait for earlier
    ones.
    """

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
        """The sequence number that position 0 stands for; None until it is known."""
        self.beginning: int | None = None
        """The sequence number of the first byte to deliver; None until it is decided."""
        self.joining = False
        """True if the capture starts in the middle of the stream, and its first byte is still
        undecided."""
        self.position = 0
        """The position of the next byte to deliver."""
        self.finish: int | None = None
        """The position of the sender's FIN, behind the last byte; None until the FIN has come."""
        self.syn_end: int | None = None
        """The position behind the bytes in the SYN, as long as it is unknown if the sender counts
        the SYN itself as one sequence number; else None."""
        self.acknowledged = 0
        """The highest position that the other end has acknowledged."""
        self.held: list[HeldBytes] = []
        self.held_bytes = 0
        self.latest = (0, 0)
        """Of the latest segment whose bytes were delivered: its number in the connection, and its
        time in UTC ns."""
        self._recent = b""
        self._gaps: list[tuple[int, int]] = []
        self._acknowledgements: list[tuple[int, int, int]] = []
        """Positions that were acknowledged before their bytes came, each with the number and the
        time (UTC ns) of the acknowledging segment."""

    def position_of(self, sequence: int) -> int:
        """Convert a sequence number to a position, which does not wrap. `origin` must be known."""
        distance = (sequence - (self.origin or 0) - self.position) & _MASK
        return self.position + (distance if distance < _HALF else distance - _MASK - 1)

    def begin(self, sequence: int) -> None:
        """Let the stream begin with the byte that has this sequence number."""
        if self.origin is None:
            self.origin = sequence
        self.position = self.position_of(sequence)
        self.beginning = sequence
        self.joining = False

    def take_syn(self, sequence: int) -> int:
        """Let the stream begin behind a SYN, if it has no beginning yet.

        `sequence` is the number of the SYN. Returns the next number, which is that of the first
        byte.
        """
        sequence = sequence + 1 & _MASK
        if self.beginning is None:
            self.begin(sequence)
        return sequence

    def decide_syn(self, sequence: int) -> None:
        """Find out if the sender counts a SYN that carries bytes as one sequence number.

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
        # All earlier bytes were acknowledged before the capture; only swapped packets may bring
        # more.
        self.acknowledge(LEAD, arrival, ts_ns)

    def begins_at(self, sequence: int) -> bool:
        """True if the stream may begin with this sequence number, so that a SYN just before it is
        its own.
        """
        if self.joining:
            return 0 <= self.position_of(sequence) <= (self.held[0].start if self.held else LEAD)
        return self.beginning == sequence

    def is_new(self, sequence: int, size: int, window: int) -> bool:
        """True if `size` bytes from a sequence number on are new, and no retransmission of
        delivered ones.

        Bytes more than `window` before the stream's position count as new.
        """
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
        """True if the stream has begun, no bytes wait for earlier ones, and no FIN has come."""
        undecided = self.origin is None or self.joining or self.syn_end is not None
        return not (undecided or self.held or self.finish is not None)

    def awaits(self, sequence: int) -> bool:
        """True if the next byte has this sequence number, no bytes wait for earlier ones, and no
        FIN has come.
        """
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
        """Move the stream past bytes that columns/ has decoded from arrays.

        `arrivals` is the number of segments of the connection before them.
        """
        self.advance(passed.tail, passed.size)
        self.latest = (arrivals + passed.last_segment, passed.last_ns)

    @property
    def holds_a_probe(self) -> bool:
        """True if the first waiting piece is a single byte, possibly a keep-alive probe, and the
        next byte has not come.
        """
        first, *later = self.held
        return len(first.data) == 1 and not (later and later[0].start == first.end)

    def note_finish(self, sequence: int, size: int, window: int) -> None:
        """Note a FIN behind `size` bytes at a sequence number; ignore one more than `window` bytes
        away.
        """
        if self.origin is not None:
            finish = self.position_of(sequence) + size
            if abs(finish - self.position) <= window:
                self.finish = finish

    def rebase(self, sequence: int) -> None:
        """Continue with this sequence number after a jump; forget gaps, FIN and
        acknowledgements.
        """
        self.origin = (sequence - self.position) & _MASK
        self.joining = False
        self._gaps.clear()
        self.finish = None
        self.acknowledged = self.position
        self._acknowledgements.clear()
        self._recent = b""

    def acknowledge(self, position: int, arrival: int, ts_ns: int) -> None:
        """Note that the other end has acknowledged all bytes before `position`.

        Some of these bytes have not come yet. `arrival` is the number of the acknowledging segment
        in the connection, `ts_ns` its time.
        """
        if position > self.acknowledged:
            self.acknowledged = position
            known = [one for one in self._acknowledgements if one[0] > self.position]
            if len(known) == MAX_ACKNOWLEDGEMENTS:
                _, arrival, ts_ns = known.pop()
            self._acknowledgements = [*known, (position, arrival, ts_ns)]

    def acknowledged_ns(self, position: int) -> int | None:
        """When the other end first acknowledged all bytes before a position not yet delivered, in
        UTC ns.
        """
        return next((ts_ns for end, _, ts_ns in self._acknowledgements if end >= position), None)

    def receipt(self, acknowledgement: int, window: int) -> int | None:
        """The position of an acknowledgement number; None if unknown or more than `window` bytes
        away.
        """
        if self.origin is None:
            return None
        position = self.position_of(acknowledgement)
        if self.finish is not None:
            position = min(position, self.finish)
        return position if -window <= position - self.position <= window else None

    def is_overdue(self, arrival: int, packets: int, ts_ns: int, wait_ns: int, needed: int) -> bool:
        """True if acknowledged bytes have not come within `packets` segments or `wait_ns`.

        `arrival` and `ts_ns` are the number and the time of the newest segment. The wait counts
        from when the bytes up to the position `needed` were acknowledged.
        """
        for position, since, since_ns in self._acknowledgements:
            if position > self.position and position >= needed:
                return arrival - since >= packets or ts_ns - since_ns >= wait_ns
        return False

    def is_overfull(self) -> bool:
        """True if more than MAX_HELD_BYTES or MAX_HELD_PIECES wait for earlier bytes."""
        return self.held_bytes > MAX_HELD_BYTES or len(self.held) > MAX_HELD_PIECES

    def advance(self, data: bytes, length: int) -> None:
        """Advance by `length` bytes; `data` are the last of them, empty if they are missing."""
        self.position += length
        if not data:
            self._recent = b""
        elif len(data) >= RECENT_BYTES:
            self._recent = data[-RECENT_BYTES:]
        else:
            self._recent = (self._recent + data)[-RECENT_BYTES:]

    def deliver(self, data: bytes, receipt: int | None, origin: Origin | None) -> Chunk:
        """Return the next bytes as a chunk with the time of `latest`, and advance behind them.

        `receipt` is the position in the other direction that their segment acknowledges, `origin`
        their packet.
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
        """Treat the next `hole` bytes as lost.

        If it is still undecided where the stream begins, it begins behind them.
        """
        if self.joining:
            self.begin((self.origin or 0) + self.position + hole & _MASK)
            return
        self._gaps = [*self._gaps[1 - MAX_GAPS :], (self.position, self.position + hole)]
        self.advance(b"", hole)

    def take_late(self, piece: HeldBytes) -> bytes:
        """Return the bytes of a segment that belong to a gap already reported; empty if there are
        none.

        Bytes are returned only once for each gap.
        """
        for gap in self._gaps:
            start, end = max(gap[0], piece.start), min(gap[1], piece.end)
            if start < end:
                self._gaps.remove(gap)
                return piece.part(start, end).data
        return b""

    def differs_from_delivered(self, start: int, data: bytes) -> bool:
        """True if `data`, a retransmission from position `start` on, differs from what was
        delivered.

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
        """Keep bytes of a segment until earlier ones have come; bytes already kept are ignored.

        Returns True if these differ from their first copy.
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
        """Remove and return the first of the waiting pieces."""
        piece = self.held.pop(0)
        self.held_bytes -= len(piece.data)
        return piece
