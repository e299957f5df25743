"""A TCP connection: its two directions, delivered in order and in the order of cause."""

# Order of cause. A segment that acknowledges bytes was sent after they were received, so it is
# delivered after them: a response never before the request that it answers, even where the capture
# swapped the two. A segment whose cause has not come waits for it, as one behind a hole does.
#
# When a hole is given up. Held bytes behind a hole wait for the retransmission that fills it:
#
# - The other end acknowledges bytes behind the hole: it has received them, only the capture has
#   not, and no retransmission will come. Captures swap packets by a few places, so PATIENCE further
#   packets of the connection, or PATIENCE_NS, are waited for. The same patience holds for a cause.
# - Without such a word the missing bytes may still be sent again. The hole is given up when more
#   is held than a stream's bounds, after HOLE_NS, or when the connection ends.
#
# An acknowledgement alone moves nothing: only later bytes make a gap, so a false one loses none.
#
# Bytes whose hole was given up and that come after all are an event: their gap stands.
#
# Keep-alive probes, as the alive check of the FA3 modules sends them, repeat the byte before the
# next expected, or no byte at its place (RFC 1122, 4.2.3.6). They are counted. A single byte at the
# beginning of a stream that is joined, with nothing behind it in time, is one too.
#
# Times. Bytes were complete when they and all before them had been captured: a piece that waited
# for an earlier one has the earlier one's time where that was captured later.
#
# A sequence number further than WINDOW from the next expected belongs to no segment in flight. The
# direction goes on from there, behind a gap of unknown length.

from __future__ import annotations

from mbtool.core import Chunk, Connection, Direction, EventKind, Stamp, WireEvent
from mbtool.packets.segment import ACK, FIN, RST, SYN, TcpSegment
from mbtool.packets.stream import LEAD, HeldBytes, Stream
from mbtool.packets.stream_events import (
    CloseReason,
    StreamClosed,
    StreamEvent,
    StreamGap,
    StreamItem,
    StreamOpened,
)

PATIENCE = 3
PATIENCE_NS = 100_000_000
HOLE_NS = 10_000_000_000
WINDOW = 1024 * 1024


class TcpConnection:
    """Two streams and what their segments say of each other. Items are appended to `out`."""

    __slots__ = (
        "_arrivals",
        "_master_is_lower",
        "_now_ns",
        "_out",
        "_requests",
        "_responses",
        "closed",
        "identity",
        "keep_alives",
        "last_ns",
    )

    def __init__(
        self,
        identity: Connection,
        ts_ns: int,
        out: list[StreamItem],
        *,
        joined: bool,
        master_is_lower: bool,
    ) -> None:
        self.identity = identity
        self.closed = False
        self.last_ns = ts_ns
        """The time of the last segment."""
        self.keep_alives = 0
        self._master_is_lower = master_is_lower
        self._arrivals = 0
        self._now_ns = ts_ns
        self._out = out
        self._requests = Stream(Direction.REQUEST, identity.master, identity.slave)
        self._responses = Stream(Direction.RESPONSE, identity.slave, identity.master)
        out.append(StreamOpened(ts_ns, identity, joined))

    @property
    def waiting(self) -> bool:
        """Bytes are held for what precedes them."""
        return bool(self._requests.held or self._responses.held)

    def is_replaced_by(self, segment: TcpSegment, *, from_lower: bool) -> bool:
        """Tell whether a segment belongs to another connection between the same ends."""
        sender = self._requests if from_lower == self._master_is_lower else self._responses
        if segment.flags & SYN:
            known = sender.first is not None
            same = sender.begins_at(segment.sequence + 1 & 0xFFFFFFFF)
            return (known and not same) or (self.closed and not segment.flags & ACK)
        if not self.closed or segment.flags & RST or not (segment.payload or segment.missing):
            return False
        # Bytes after the end, and not a second copy: the end was none (a stray RST), or the SYN of
        # the next connection is not in the capture.
        if sender.first is None:
            return True
        start = sender.place(segment.sequence)
        end = start + len(segment.payload) + segment.missing
        return end > sender.position or start < sender.position - WINDOW

    def feed(self, segment: TcpSegment, ts_ns: int, *, from_lower: bool) -> None:
        """Take a segment of this connection. After its end, nothing happens.

        `from_lower` says which end sent it, in the order that the caller gives the two ends.
        """
        self.last_ns = self._now_ns = ts_ns
        if self.closed:
            return
        self._arrivals += 1
        from_master = from_lower == self._master_is_lower
        if from_master:
            sender, other = self._requests, self._responses
        else:
            sender, other = self._responses, self._requests
        flags = segment.flags
        after = 0
        if flags & ACK and other.first is not None:
            after = self._acknowledge(other, segment.acknowledgement)
        if flags & RST:
            unasked = other.position == 0 and not other.held
            refused = not from_master and sender.first is None and unasked
            self.close(ts_ns, CloseReason.REFUSED if refused else CloseReason.RESET)
            return
        sequence = segment.sequence
        if flags & SYN:
            sequence = sequence + 1 & 0xFFFFFFFF
        data, missing = segment.payload, segment.missing
        if flags & SYN:
            if sender.beginning is None:
                sender.begin(sequence)
        elif sender.first is None and (data or missing):
            sender.join(sequence, self._arrivals, ts_ns)
        if data or missing:
            if flags & ACK and other.first is None and not flags & SYN:
                # What it answers may come behind it.
                other.join(segment.acknowledgement, self._arrivals, ts_ns)
                after = LEAD
            start = sender.place(sequence)
            if not -WINDOW <= start - sender.position <= WINDOW:
                start = self._leap(sender, sequence)
            end = start + len(data)
            if data:
                self._take(sender, other, HeldBytes(start, end, data, after, ts_ns, self._arrivals))
            if missing:
                cut = HeldBytes(end, end + missing, b"", after, ts_ns, self._arrivals)
                self._take(sender, other, cut)
        elif (
            flags == ACK
            and sender.first is not None
            and not (sequence + 1 - sender.first - sender.position) & 0xFFFFFFFF
        ):
            self.keep_alives += 1
        if flags & FIN and sender.first is not None:
            finish = sender.place(sequence) + len(data) + missing
            if abs(finish - sender.position) <= WINDOW:
                sender.finish = finish
        if sender.held or other.held:
            self._settle()
        if sender.finish is not None and other.finish is not None and self._is_finished():
            self.close(ts_ns, CloseReason.FINISHED)

    def advance(self, now_ns: int) -> None:
        """Let time pass: what has waited for too long is given up."""
        self._now_ns = now_ns
        self._settle()
        if not self.closed and self._is_finished():
            self.close(now_ns, CloseReason.FINISHED)

    def flush(self) -> None:
        """Deliver what is held, its holes as gaps."""
        self._settle(force=True)

    def close(self, ts_ns: int, reason: CloseReason) -> None:
        """Deliver what is held and end the connection, unless it has ended."""
        if not self.closed:
            self.flush()
            self.closed = True
            self._out.append(StreamClosed(ts_ns, self.identity, reason, self.keep_alives))

    def _acknowledge(self, stream: Stream, acknowledgement: int) -> int:
        """Note an acknowledgement of a stream. Gives the position to wait for, 0 for none."""
        position = stream.place(acknowledgement)
        if stream.finish is not None:
            position = min(position, stream.finish)  # FIN takes a sequence number, and is no byte.
        if not stream.position < position <= stream.position + WINDOW:
            return 0
        stream.acknowledge(position, self._arrivals, self._now_ns)
        return position

    def _leap(self, stream: Stream, sequence: int) -> int:
        self._settle(force=True)
        if not stream.joining:
            self._out.append(StreamGap(self._now_ns, self.identity, stream.direction, missing=0))
        stream.rebase(sequence)
        return stream.position

    def _take(self, sender: Stream, other: Stream, piece: HeldBytes) -> None:
        """Deliver or hold a piece, less what was delivered before."""
        differs = False
        behind = sender.position - piece.start
        if behind > 0:
            if behind == 1 and len(piece.data) == 1:
                self.keep_alives += 1
            late = sender.take_late(piece)
            if late:
                message = "bytes that came after their gap was told"
                self._tell(sender, EventKind.DISCARDED, message, piece.ts_ns, late)
            differs = sender.differs_from_delivered(piece.start, piece.data)
        if piece.end > sender.position:
            fresh = piece if behind <= 0 else piece.part(sender.position, piece.end)
            if fresh.start == sender.position and not sender.held and self._follows(fresh, other):
                self._deliver(sender, fresh)
            else:
                differs |= sender.hold(fresh)
        if differs:
            message = "a segment sent again differs from its first copy, which is kept"
            self._tell(sender, EventKind.OVERLAP, message, piece.ts_ns, piece.data)

    def _tell(self, sender: Stream, kind: EventKind, text: str, ts_ns: int, raw: bytes) -> None:
        event = WireEvent(
            ts_ns=ts_ns,
            link=self.identity.link,
            kind=kind,
            message=text,
            source=str(sender.source),
            destination=str(sender.destination),
            raw=raw,
        )
        self._out.append(StreamEvent(self.identity, event))

    def _follows(self, piece: HeldBytes, other: Stream) -> bool:
        """What a piece acknowledges has been delivered, or is no longer waited for."""
        if piece.after <= other.position:
            return True
        # Where the hole in the other direction shows, its gap comes first.
        shows = other.held and other.held[0].start <= piece.after
        return not shows and self._is_overdue(other)

    def _is_overdue(self, stream: Stream) -> bool:
        return stream.is_overdue(self._arrivals, PATIENCE, self._now_ns, PATIENCE_NS)

    def _settle(self, *, force: bool = False) -> None:
        """Deliver what has become ready, and give up what is not worth waiting for."""
        # Each turn delivers a piece or closes a hole, so it ends.
        streams = ((self._requests, self._responses), (self._responses, self._requests))
        moved = True
        while moved:
            moved = False
            for stream, other in streams:
                while stream.held and stream.held[0].start == stream.position:
                    if not self._follows(stream.held[0], other):
                        break
                    self._deliver(stream, stream.release())
                    moved = True
            if not moved:
                # Where a stream begins is settled first: what is forced would go before it.
                waiting = sorted(streams, key=lambda both: not both[0].joining)
                moved = any(self._give_up(stream, force) for stream, _ in waiting)

    def _give_up(self, stream: Stream, force: bool) -> bool:
        """Pass over what the first held piece waits for, where the bounds or `force` say so."""
        if not stream.held:
            return False
        front = stream.held[0]
        hole = front.start - stream.position
        waited_ns = self._now_ns - min(piece.ts_ns for piece in stream.held)
        if not (
            force
            or stream.is_overfull()
            or waited_ns >= HOLE_NS
            or (hole and front.start <= stream.acknowledged and self._is_overdue(stream))
        ):
            return False
        if stream.joining and hole and _is_probe(stream):
            age, age_ns = self._arrivals - front.arrival, self._now_ns - front.ts_ns
            if not force and age < PATIENCE and age_ns < PATIENCE_NS:
                return False
            stream.release()
            stream.pass_over(hole + 1)
            self.keep_alives += 1
        elif hole:
            if not stream.joining:
                self._out.append(StreamGap(front.ts_ns, self.identity, stream.direction, hole))
            stream.pass_over(hole)
        else:
            self._deliver(stream, stream.release())
        return True

    def _deliver(self, stream: Stream, piece: HeldBytes) -> None:
        length = piece.end - piece.start
        stream.advance(piece.data, length)
        if piece.arrival >= stream.latest[0]:
            stream.latest = (piece.arrival, piece.ts_ns)
        ts_ns = stream.latest[1]
        identity = self.identity
        if piece.data:
            self._out.append(
                Chunk(
                    ts_ns=ts_ns,
                    link=identity.link,
                    data=piece.data,
                    direction=stream.direction,
                    stamp=Stamp.AT_ONCE,
                    connection=identity,
                )
            )
        else:
            self._out.append(StreamGap(ts_ns, identity, stream.direction, length, EventKind.CUT))

    def _is_finished(self) -> bool:
        return all(
            stream.finish is not None
            and not stream.held
            and (stream.joining or stream.position >= stream.finish)
            for stream in (self._requests, self._responses)
        )


def _is_probe(stream: Stream) -> bool:
    """One byte is held before all others, and none that follows it."""
    front, *behind = stream.held
    return len(front.data) == 1 and not (behind and behind[0].start == front.end)
