"""Puts the bytes of one direction of a TCP connection in order, and tracks which are missing."""

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

from mbtool.core import Chunk, Connection, Direction, Origin, Stamp, StreamPlace

if TYPE_CHECKING:
    from mbtool.packets.plain_bytes import PlainBytes

MAX_HELD_BYTES = 64 * 1024
MAX_HELD_PIECES = 64
RECENT_BYTES = 1024
MAX_GAPS = 8
MAX_ACKNOWLEDGEMENTS = 8
LEAD = 64 * 1024
"""If the capture starts in the middle of a stream, the first byte seen gets this position, not 0.
The positions before it are for bytes that the stream has earlier but the capture later, because it
swapped packets."""

_MASK = 0xFFFFFFFF
_HALF = 0x80000000


class HeldBytes(NamedTuple):
    """Bytes of one segment that wait for earlier bytes.

    `start` and `end` (exclusive) are positions: byte offsets from the beginning of the stream.
    """

    start: int
    end: int
    data: bytes
    """The bytes; empty if the capture did not keep them (snaplen)."""
    acknowledged: int
    """The byte offset up to which the other direction must be delivered before these bytes, since
    their segment acknowledges it; 0 if these bytes need not wait for that."""
    ts_ns: int
    arrival: int
    """The number of the segment that brought these bytes, counted from 1 in its connection."""
    receipt: int | None = None
    """The byte offset up to which the segment of these bytes acknowledges the other direction,
    counted from that stream's beginning (not the raw ACK number); None if unknown."""
    origin: Origin | None = None
    """The packet that brought these bytes; None if unknown."""

    def part(self, start: int, end: int) -> HeldBytes:
        data = self.data[start - self.start : end - self.start]
        return self._replace(start=start, end=end, data=data)


class Stream:
    """One direction of a TCP connection: the position up to which it was delivered, and the bytes
    that wait for earlier ones.

    A position is a byte offset from the stream's beginning; unlike a sequence number it does not
    wrap. If the capture starts in the middle of the stream, the first byte seen has position LEAD.
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
        "sent",
        "sent_again",
        "syn_end",
    )

    def __init__(self, direction: Direction, connection: Connection) -> None:
        self.direction = direction
        self._connection = connection
        self._link = connection.link
        self.origin: int | None = None
        """The sequence number that position 0 stands for; None until it is known."""
        self.beginning: int | None = None
        """The sequence number of the first byte to deliver; None until that byte is known."""
        self.joining = False
        """True if the capture starts in the middle of the stream, and earlier bytes than those seen
        may still come, so that the first byte to deliver is not yet known."""
        self.position = 0
        """The byte offset in the stream of the next byte to deliver."""
        self.finish: int | None = None
        """The byte offset of the stream's end, as the sender's FIN shows; None before the FIN."""
        self.syn_end: int | None = None
        """None, except after a SYN segment that carried bytes, until it is known whether the sender
        counts the SYN itself as one sequence number. Meanwhile this is the stream position behind
        these bytes, calculated as if the SYN counts."""
        self.acknowledged = 0
        """The highest byte offset that the receiver acknowledged before all bytes up to it came."""
        self.sent = 0
        """The highest byte offset up to which the sender had sent its bytes, as the sequence number
        of a segment without bytes shows."""
        self.sent_again = -1
        """The byte offset of the last segment that was reported as sent again."""
        self.held: list[HeldBytes] = []
        self.held_bytes = 0
        self.latest = (0, 0)
        """The number, counted from 1 in the connection, and the time in UTC ns of the latest
        segment whose bytes were delivered; both 0 before the first."""
        self._recent = b""
        self._gaps: list[tuple[int, int]] = []
        self._acknowledgements: list[tuple[int, int, int]] = []
        """Acknowledgements of bytes that had not come, in order. Each has the position up to which
        bytes were acknowledged, and the number and the time (UTC ns) of the acknowledging
        segment."""

    def position_of(self, sequence: int) -> int:
        """Convert a sequence number to a position, which does not wrap. `origin` must be known."""
        distance = (sequence - (self.origin or 0) - self.position) & _MASK
        return self.position + (distance if distance < _HALF else distance - _MASK - 1)

    def begin(self, sequence: int) -> None:
        """Make the byte with this sequence number the first one to deliver."""
        if self.origin is None:
            self.origin = sequence
        self.position = self.position_of(sequence)
        self.beginning = sequence
        self.joining = False

    def take_syn(self, sequence: int) -> int:
        """Begin the stream behind a SYN, unless its beginning is already known.

        `sequence` is the SYN's sequence number. Returns the sequence number of the first byte
        behind the SYN.
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
        """Note the first sequence number seen of a stream whose SYN is not in the capture.

        `arrival` is the number of its segment in the connection, `ts_ns` the segment's time.
        """
        self.origin = (sequence - LEAD) & _MASK
        self.joining = True
        # Bytes before the first segment seen (at position LEAD) count as acknowledged. So the wait
        # for them is short: they come only if the capture swapped packets.
        self.acknowledge(LEAD, arrival, ts_ns)

    def begins_at(self, sequence: int) -> bool:
        """True if the stream begins, or may begin, with the byte of this sequence number.

        A SYN with the sequence number before it is then the stream's own.
        """
        if self.joining:
            return 0 <= self.position_of(sequence) <= (self.held[0].start if self.held else LEAD)
        return self.beginning == sequence

    def is_new(self, sequence: int, size: int, window: int) -> bool:
        """True if `size` bytes from a sequence number on are not all a retransmission.

        Bytes that lie more than `window` bytes before the next byte to deliver count as new.
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
        """True if a segment with this sequence number can be delivered at once.

        It then begins with the next byte to deliver, no bytes wait for earlier ones, no FIN has
        come, and the stream's beginning is known.
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
        """Move the stream past bytes that the array decoder has read.

        `arrivals` is the number of segments of the connection before these bytes.
        """
        self.advance(passed.tail, passed.size)
        self.latest = (arrivals + passed.last_segment, passed.last_ns)

    @property
    def holds_a_probe(self) -> bool:
        """True if the first waiting bytes may be a keep-alive probe.

        They are then a single byte, and the byte behind it has not come.
        """
        first, *later = self.held
        return len(first.data) == 1 and not (later and later[0].start == first.end)

    def note_finish(self, sequence: int, size: int, window: int) -> None:
        """Note the FIN of a segment that has `size` bytes from a sequence number on.

        A FIN more than `window` bytes from the next byte to deliver is ignored.
        """
        if self.origin is not None:
            finish = self.position_of(sequence) + size
            if abs(finish - self.position) <= window:
                self.finish = finish

    def note_sent(self, sequence: int, window: int) -> None:
        """Note that the sender has sent all bytes before a sequence number.

        A number more than `window` bytes from the next byte to deliver is ignored.
        """
        position = self.position_of(sequence)
        if abs(position - self.position) <= window:
            self.sent = max(position, self.sent)

    def rebase(self, sequence: int) -> None:
        """Give the next byte to deliver this sequence number, because the sequence numbers have
        jumped.

        Gaps, FIN, acknowledgements and the bytes kept for comparison are forgotten.
        """
        self.origin = (sequence - self.position) & _MASK
        self.joining = False
        self._gaps.clear()
        self.finish = None
        self.acknowledged = self.sent = self.position
        self._acknowledgements.clear()
        self._recent = b""

    def acknowledge(self, position: int, arrival: int, ts_ns: int) -> None:
        """Note that the receiver has acknowledged the first `position` bytes of the stream.

        Some of these bytes have not come yet. `arrival` is the number of the acknowledging segment
        in the connection, `ts_ns` its time in UTC ns.
        """
        if position > self.acknowledged:
            self.acknowledged = position
            known = [one for one in self._acknowledgements if one[0] > self.position]
            if len(known) == MAX_ACKNOWLEDGEMENTS:
                _, arrival, ts_ns = known.pop()
            self._acknowledgements = [*known, (position, arrival, ts_ns)]

    def acknowledged_ns(self, position: int) -> int | None:
        """Return the time, in UTC ns, at which the receiver first acknowledged the first `position`
        bytes.

        The byte before `position` is not delivered yet. Returns None if it was not acknowledged.
        """
        return next((ts_ns for end, _, ts_ns in self._acknowledgements if end >= position), None)

    def acknowledged_position(self, acknowledgement: int, window: int) -> int | None:
        """Convert a raw ACK number to a position: the byte offset up to which it acknowledges.

        Returns None if sequence numbers of the stream are not known yet, or if the position is more
        than `window` bytes from the next byte to deliver.
        """
        if self.origin is None:
            return None
        position = self.position_of(acknowledgement)
        if self.finish is not None:
            position = min(position, self.finish)
        return position if -window <= position - self.position <= window else None

    def is_overdue(self, arrival: int, packets: int, ts_ns: int, wait_ns: int, needed: int) -> bool:
        """True if acknowledged bytes have not come within `packets` segments or `wait_ns`.

        `arrival` is the number and `ts_ns` the time of the connection's newest segment. The wait
        counts from the first acknowledgement of undelivered bytes that reaches at least the
        position `needed`. Returns False if there is none.
        """
        for position, since, since_ns in self._acknowledgements:
            if position > self.position and position >= needed:
                return arrival - since >= packets or ts_ns - since_ns >= wait_ns
        return False

    def is_overfull(self) -> bool:
        """True if more than MAX_HELD_BYTES bytes, or more than MAX_HELD_PIECES pieces, wait."""
        return self.held_bytes > MAX_HELD_BYTES or len(self.held) > MAX_HELD_PIECES

    def advance(self, data: bytes, length: int) -> None:
        """Move the next byte to deliver on by `length` bytes.

        `data` are the last of these bytes, to compare retransmissions with; b"" if they are
        missing.
        """
        self.position += length
        if not data:
            self._recent = b""
        elif len(data) >= RECENT_BYTES:
            self._recent = data[-RECENT_BYTES:]
        else:
            self._recent = (self._recent + data)[-RECENT_BYTES:]

    def deliver(self, data: bytes, receipt: int | None, origin: Origin | None) -> Chunk:
        """Return `data`, the next bytes of the stream, as a chunk with the time of `latest`.

        `receipt` is the byte offset up to which their segment acknowledges the other direction;
        None if unknown. `origin` is the packet that brought them; None if unknown.
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

        If the first byte to deliver is not known yet (`joining`), it is the one behind them.
        """
        if self.joining:
            self.begin((self.origin or 0) + self.position + hole & _MASK)
            return
        self._gaps = [*self._gaps[1 - MAX_GAPS :], (self.position, self.position + hole)]
        self.advance(b"", hole)

    def take_late(self, piece: HeldBytes) -> bytes:
        """Return the bytes of a segment that belong to a gap already reported; b"" if there are
        none.

        For each gap, bytes are returned only for the first segment that reaches into it.
        """
        for gap in self._gaps:
            start, end = max(gap[0], piece.start), min(gap[1], piece.end)
            if start < end:
                self._gaps.remove(gap)
                return piece.part(start, end).data
        return b""

    def differs_from_delivered(self, start: int, data: bytes) -> bool:
        """True if `data`, sent again from position `start` on, differs from the delivered bytes.

        Only the last RECENT_BYTES bytes that were delivered are compared.
        """
        # A keep-alive probe may carry one byte of any value, with the sequence number of the last
        # byte delivered (RFC 1122, 4.2.3.6).
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
        """Keep bytes of a segment until earlier ones have come.

        Where bytes are already kept, the first copy stays. Returns True if the new copy differs
        from it.
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

    def skip_to(self, sequence: int, size: int) -> None:
        """Treat `size` bytes from a sequence number on, and all before them, as delivered."""
        if self.origin is None or self.joining:
            self.begin(sequence)
        self.position = max(self.position, self.position_of(sequence) + size)

    def drop_held(self) -> None:
        """Drop the bytes that wait for earlier ones."""
        self.held, self.held_bytes = [], 0

    def release(self) -> HeldBytes:
        """Remove and return the bytes with the lowest position of those that wait."""
        piece = self.held.pop(0)
        self.held_bytes -= len(piece.data)
        return piece
