"""Reassembles a TCP connection: delivers both directions in order, requests before responses."""

# A hole is a run of bytes that has not come yet although later ones have. A hole that is given up
# becomes a gap, and the bytes behind it are delivered.
#
# Causes before effects. The sender of a segment had received the bytes that the segment
# acknowledges, so the segment is delivered after these bytes: a response never precedes its
# request, even if the capture swapped the two. So a segment is held until the bytes that it
# acknowledges have come, just as a segment behind a hole is held.
#
# When a hole is given up. Bytes behind a hole are held until a retransmission fills it.
#
# - If the other end acknowledges bytes behind the hole, it has received the missing bytes. Only the
#   capture lacks them, and no retransmission will come. Captures swap packets by a few places, so
#   the hole is given up after PATIENCE further packets of the connection or after PATIENCE_NS. The
#   wait for acknowledged bytes of the other direction ends in the same way.
# - Without such an acknowledgement the missing bytes may still be sent again. The hole is given up
#   when the held bytes exceed the limits of a stream, after HOLE_NS, or when the connection ends.
#
# An acknowledgement alone delivers nothing and makes no gap before the connection ends: only bytes
# behind a hole do. So a wrong acknowledgement loses no bytes.
#
# When the connection ends, bytes that were acknowledged, or that precede a FIN, and never came
# become a gap.
#
# Bytes that come after their hole was given up are reported as an event; the gap stays.
#
# Keep-alive probes, as the alive check of the FA3 modules sends them, repeat the byte before the
# next expected one, or carry its sequence number and no byte (RFC 1122, 4.2.3.6). They are counted.
# If the capture begins in the middle of a stream with a single byte, and the next byte does not
# come in time, that single byte is a probe, too.
#
# Times. A byte has the time at which it and all bytes before it had been captured. So bytes that
# waited for earlier bytes get the time of those earlier bytes.
#
# A SYN that carries bytes counts as one sequence number before them (RFC 793, 3.3). If the next
# segment or the first acknowledgement shows that the sender does not count it, it is not counted.
#
# A segment whose sequence number is further than WINDOW from the next expected one cannot belong to
# the bytes in flight. Its bytes are then taken as the next ones, behind a gap of unknown length.

from __future__ import annotations

from mbtool.core import Connection, Direction, EventKind, Origin, WireEvent
from mbtool.core.moments import in_ms
from mbtool.packets.ended_connection import WINDOW, begins_another
from mbtool.packets.plain_bytes import PlainBytes, RestPlace
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
"""Bytes behind a hole wait for this many further segments of the connection: if the capture swapped
two packets, at most this many lie between them."""
PATIENCE_NS = 100_000_000
"""Bytes behind a hole wait at most this long (ns) for a swapped packet."""
SYN_PATIENCE_NS = 1_000_000_000
"""A SYN that nobody answered counts as unanswered only if the connection's last sign is this long
(ns) after it: a master waits at least 1 s before it sends a SYN again (RFC 6298, 2)."""
HOLE_NS = 10_000_000_000
"""Bytes behind a hole (missing bytes) wait this long, in ns, for a retransmission to fill it."""
RETRANSMISSION_NS = 50_000_000
"""A copy of a segment that comes at least this long (ns) after the last new bytes of its sender was
sent again. Senders wait 200 ms or longer (RFC 6298, 2.4 says 1 s; Linux and Windows take less); a
mirror port, or a capture of both sides of a router, gives its copy within some ms."""

_WITHOUT_END = frozenset((CloseReason.REPLACED, CloseReason.IDLE, CloseReason.CAPTURE_END))

_STATE_FLAGS = ACK | FIN | RST | SYN
"""The flags to check: a segment that has only ACK of these neither opens nor ends a connection."""


class TcpConnection:
    """Reassembles the two directions of a TCP connection.

    It appends the connection's chunks, gaps, events, begin and end to the list `out`, in order.
    """

    __slots__ = (
        "_arrivals",
        "_directions",
        "_finisher",
        "_has_acknowledged",
        "_master_is_lower",
        "_now_ns",
        "_opened_ns",
        "_out",
        "_prober",
        "closed",
        "identity",
        "keep_alives",
        "last_ns",
        "unanswered_probes",
        "wants_bytes",
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
        """The time of the segment that was taken last, in UTC ns."""
        self.keep_alives = 0
        self.unanswered_probes = 0
        """The number of keep-alive probes of one end since the other end last sent a segment."""
        self._opened_ns = ts_ns
        self.wants_bytes = True
        """False once the bytes of this connection are not wanted; then only its end is reported."""
        self._has_acknowledged = False
        """True once a segment other than one that continues both streams in order had an
        acknowledgement."""
        self._finisher: Stream | None = None
        """The stream of the end that sent the first FIN, or the RST; None before that."""
        self._prober: Stream | None = None
        """The stream of the end that sent the last keep-alive probe; None before the first
        probe."""
        self._master_is_lower = master_is_lower
        self._arrivals = 0
        """The number of segments of this connection so far, both directions together."""
        self._now_ns = ts_ns
        self._out = out
        requests = Stream(Direction.REQUEST, identity)
        responses = Stream(Direction.RESPONSE, identity)
        self._directions = ((requests, responses), (responses, requests))
        """Two pairs of streams (sender's, receiver's): the first for segments from the master, the
        second for segments from the slave."""
        out.append(StreamOpened(ts_ns, identity, joined))

    @property
    def holds_bytes(self) -> bool:
        """True if bytes are held back because earlier or acknowledged bytes are missing."""
        requests, responses = self._directions[0]
        return bool(requests.held or responses.held)

    @property
    def rest_place(self) -> RestPlace | None:
        """The next byte of both directions; None if the connection has ended or bytes wait."""
        ways = self._directions[0]
        if self.closed or not all(way.is_at_rest for way in ways):
            return None
        return RestPlace(*(way.next_sequence for way in ways), *(way.position for way in ways))

    def pass_plain(self, requests: PlainBytes, responses: PlainBytes) -> None:
        """Move both directions past segments that the array decoder has read."""
        asking, answering = self._directions[0]
        asking.pass_plain(requests, self._arrivals)
        answering.pass_plain(responses, self._arrivals)
        self._arrivals += responses.last_segment
        self.last_ns = self._now_ns = responses.last_ns
        self.unanswered_probes = 0

    def ignore(self) -> None:
        """Deliver no more bytes of this connection; drop those that are held."""
        self.wants_bytes = False
        for stream, _ in self._directions:
            stream.drop_held()

    def note_time(self, ts_ns: int) -> None:
        self._now_ns = max(self._now_ns, ts_ns)

    def is_replaced_by(self, segment: TcpSegment, *, from_lower: bool) -> bool:
        """True if a segment belongs to a new connection between the same ends.

        Called for a segment with SYN, or if this connection is closed. `from_lower` is True if the
        segment's sender is the end with the lower port (with equal ports, the lower address).
        """
        sender, _ = self._directions[from_lower != self._master_is_lower]
        return begins_another(segment, sender, is_closed=self.closed)

    def feed(
        self, segment: TcpSegment, ts_ns: int, *, from_lower: bool, origin: Origin | None = None
    ) -> bool:
        """Take a segment of this connection; a closed connection ignores it.

        `from_lower` is True if the segment's sender is the end with the lower port (with equal
        ports, the lower address). `origin` is the packet that brought the segment. Returns True if
        bytes of the connection are then held back because others have not come.
        """
        self.last_ns = self._now_ns = ts_ns
        if self.closed:
            return False
        self._arrivals += 1
        sender, other = self._directions[from_lower != self._master_is_lower]
        if not self.wants_bytes and segment.payload and segment.flags & _STATE_FLAGS == ACK:
            sender.skip_to(segment.sequence, len(segment.payload) + segment.missing)
            return False
        if sender is not self._prober:
            self.unanswered_probes = 0
        if (
            segment.payload
            and segment.flags & _STATE_FLAGS == ACK
            and not segment.missing
            and sender.awaits(segment.sequence)
            and other.awaits(segment.acknowledgement)
        ):  # Most segments: without this, a segment takes four times as many calls.
            sender.latest = (self._arrivals, ts_ns)
            self._out.append(sender.deliver(segment.payload, other.position, origin))
            return False
        self._take(segment, sender, other, origin)
        return self.holds_bytes

    def _take(
        self, segment: TcpSegment, sender: Stream, other: Stream, origin: Origin | None
    ) -> None:
        """Take a segment with SYN, FIN or RST, without bytes, or out of order.

        `sender` and `other` are the streams of bytes from the segment's sender and to it.
        """
        probes, ts_ns = self.keep_alives, self._now_ns
        flags, sequence = segment.flags, segment.sequence
        self._has_acknowledged = self._has_acknowledged or flags & ACK > 0
        if flags & ACK and other.syn_end is not None:
            other.decide_syn(segment.acknowledgement)
        acknowledged = 0
        if flags & ACK and other.origin is not None:
            acknowledged = self._acknowledge(other, segment.acknowledgement)
        if flags & (RST | FIN) and (flags & RST or self._finisher is None):
            self._finisher = sender
        if flags & RST:
            self.close(ts_ns, self._reset_reason(sender))
            return
        if flags & SYN:
            if flags & ACK and other.origin is None:
                # The capture lacks the SYN that this one answers, and which it acknowledges.
                other.begin(segment.acknowledgement)
            sequence = sender.take_syn(sequence)
            if len(segment.payload) > 1:
                sender.syn_end = sender.position_of(sequence) + len(segment.payload)
        elif len(segment.payload) > 1 and sender.syn_end is not None:
            sender.decide_syn(sequence)
        if segment.payload or segment.missing:
            self._take_payload(segment, sequence, acknowledged, sender, other, origin)
        elif flags == ACK:
            if other.origin is None and sender.beginning == sequence and not sender.sent:
                # The third segment of the handshake; the capture lacks the second, with the SYN.
                other.begin(segment.acknowledgement)
            if sender.is_before_next(sequence):
                self.keep_alives += 1
            elif sender.origin is not None:
                sender.note_sent(sequence, WINDOW)
        if self.keep_alives > probes:
            self._prober = sender
            self.unanswered_probes += 1
        if flags & FIN:
            sender.note_finish(sequence, len(segment.payload) + segment.missing, WINDOW)
        if sender.held or other.held:
            self._deliver_held()
        if sender.finish is not None and self._is_finished():
            self.close(ts_ns, CloseReason.FINISHED)

    def advance(self, now_ns: int) -> None:
        """Set the capture's time to `now_ns`; treat bytes missing for too long as lost."""
        self._now_ns = now_ns
        self._deliver_held()
        if not self.closed and self._is_finished():
            self.close(now_ns, CloseReason.FINISHED)

    def flush(self) -> None:
        """Deliver all bytes that wait for earlier ones; the missing earlier bytes become gaps."""
        self._deliver_held(force=True)

    def close(self, ts_ns: int, reason: CloseReason) -> None:
        """Deliver all waiting bytes and end the connection, unless it has ended already."""
        if not self.closed:
            self.flush()
            for stream, _ in self._directions:
                self._report_missing_end(stream)
            self.closed = True
            last, last_ns = max(stream.latest for stream, _ in self._directions)
            self._out.append(
                StreamClosed(
                    ts_ns,
                    self.identity,
                    self._seen_reason(reason, ts_ns),
                    self._ended_by(reason),
                    self.keep_alives,
                    self.unanswered_probes,
                    last_ns if last == self._arrivals else None,
                )
            )

    def _seen_reason(self, reason: CloseReason, ts_ns: int) -> CloseReason:
        """UNANSWERED if the connection consists only of the master's SYN, for at least
        SYN_PATIENCE_NS; otherwise `reason`.
        """
        requests, responses = self._directions[0]
        has_more = self._has_acknowledged or responses.origin is not None or requests.position > 0
        is_silent = not has_more and ts_ns - self._opened_ns >= SYN_PATIENCE_NS
        return CloseReason.UNANSWERED if is_silent and reason in _WITHOUT_END else reason

    def _ended_by(self, reason: CloseReason) -> Direction | None:
        is_known = reason in (CloseReason.FINISHED, CloseReason.RESET)
        return self._finisher.direction if is_known and self._finisher is not None else None

    def _report_missing_end(self, stream: Stream) -> None:
        """Report a gap if a FIN or an acknowledgement shows that the last bytes are missing."""
        if stream.joining and not stream.held:
            # No byte of this direction was captured. Its first one is known from the first
            # acknowledgement by the other end.
            stream.pass_over(LEAD)
        end = max(stream.acknowledged, stream.sent) if stream.finish is None else stream.finish
        missing = end - stream.position
        if 0 < missing <= WINDOW and not stream.joining:
            gap = StreamGap(self._now_ns, self.identity, stream.direction, missing=missing)
            self._out.append(gap)
            stream.pass_over(missing)

    def _acknowledge(self, stream: Stream, acknowledgement: int) -> int:
        """Note that the receiver of `stream` has sent `acknowledgement`, a raw ACK number.

        Returns that number as a byte position in `stream` if bytes before it are missing, else 0.
        """
        position = stream.position_of(acknowledgement)
        if stream.finish is not None:
            position = min(position, stream.finish)  # FIN takes a sequence number, and is no byte.
        if not stream.position < position <= stream.position + WINDOW:
            return 0
        stream.acknowledge(position, self._arrivals, self._now_ns)
        return position

    def _reset_reason(self, sender: Stream) -> CloseReason:
        """REFUSED if the slave sent the RST before either end had sent a byte; otherwise RESET."""
        requests, _ = self._directions[0]
        is_first_word = sender is not requests and sender.origin is None
        if is_first_word and not requests.position and not requests.held:
            return CloseReason.REFUSED
        return CloseReason.RESET

    def _take_payload(
        self,
        segment: TcpSegment,
        sequence: int,
        acknowledged: int,
        sender: Stream,
        other: Stream,
        origin: Origin | None,
    ) -> None:
        """Deliver the segment's bytes, or hold them back; bytes cut by the snaplen become a gap.

        `acknowledged` is the byte position in `other` up to which bytes must come first; 0 if none.
        """
        ts_ns, arrival = self._now_ns, self._arrivals
        if sender.origin is None:
            sender.join(sequence, arrival, ts_ns)
        if other.origin is None and segment.flags & (ACK | SYN) == ACK:
            # The bytes of `other` may come later: the capture may have swapped the packets.
            other.join(segment.acknowledgement, arrival, ts_ns)
            acknowledged = LEAD
        start = sender.position_of(sequence)
        if not -WINDOW <= start - sender.position <= WINDOW:
            start = self._continue_at(sender, sequence)
        data, missing = segment.payload, segment.missing
        end = start + len(data)
        receipt = (
            other.acknowledged_position(segment.acknowledgement, WINDOW)
            if segment.flags & ACK
            else None
        )
        if data:
            piece = HeldBytes(start, end, data, acknowledged, ts_ns, arrival, receipt, origin)
            self._take_piece(sender, other, piece)
        if missing:
            cut = HeldBytes(end, end + missing, b"", acknowledged, ts_ns, arrival, receipt)
            self._take_piece(sender, other, cut)

    def _continue_at(self, stream: Stream, sequence: int) -> int:
        """Continue a stream at a sequence number more than WINDOW bytes from the expected one.

        Returns the byte position in `stream` that the sequence number now has.
        """
        self._deliver_held(force=True)
        if not stream.joining:
            self._out.append(StreamGap(self._now_ns, self.identity, stream.direction, missing=0))
        stream.rebase(sequence)
        return stream.position

    def _take_piece(self, sender: Stream, other: Stream, piece: HeldBytes) -> None:
        """Deliver the new bytes of a segment, or hold them back until earlier ones have come.

        Bytes of a reported gap, and bytes that differ from their first copy, become events.
        """
        differs = False
        fresh, behind = piece, sender.position - piece.start
        if behind > 0:
            if behind == 1 and len(piece.data) == 1:
                self.keep_alives += 1
            late = sender.take_late(piece)
            if late:
                message = "bytes that came after their gap was told"
                self._report(sender, EventKind.DISCARDED, message, piece.ts_ns, late)
            differs = sender.differs_from_delivered(piece.start, piece.data)
            if not (late or differs):
                self._note_sent_again(sender, piece)
            fresh = piece.part(sender.position, piece.end)
        if piece.end > sender.position:
            if fresh.start == sender.position and not sender.held and self._is_due(fresh, other):
                self._deliver(sender, fresh)
            else:
                differs |= sender.hold(fresh)
        if differs:
            message = "a segment sent again differs from its first copy, which is kept"
            self._report(sender, EventKind.OVERLAP, message, piece.ts_ns, piece.data)

    def _note_sent_again(self, sender: Stream, piece: HeldBytes) -> None:
        """Report the first retransmission of a segment; a keep-alive probe of one byte does not
        count.
        """
        waited_ns = piece.ts_ns - sender.latest[1]
        is_new = sender.latest[1] > 0 and sender.sent_again != piece.start
        if len(piece.data) > 1 and waited_ns >= RETRANSMISSION_NS and is_new:
            sender.sent_again = piece.start
            message = f"a TCP segment sent again after {in_ms(waited_ns)} ms"
            self._report(sender, EventKind.SENT_AGAIN, message, piece.ts_ns, piece.data)

    def _report(self, sender: Stream, kind: EventKind, text: str, ts_ns: int, raw: bytes) -> None:
        ends = self.identity.master, self.identity.slave
        source, destination = ends if sender.direction is Direction.REQUEST else ends[::-1]
        event = WireEvent(
            ts_ns=ts_ns,
            link=self.identity.link,
            kind=kind,
            message=text,
            source=str(source),
            destination=str(destination),
            raw=raw,
        )
        self._out.append(StreamEvent(self.identity, event))

    def _is_due(self, piece: HeldBytes, other: Stream) -> bool:
        """True if the bytes of `other` that the segment acknowledges are delivered or given up."""
        if piece.acknowledged <= other.position:
            return True
        # If `other` holds bytes that follow missing ones, its gap must be delivered before this
        # piece.
        has_gap_to_come = other.held and other.held[0].start <= piece.acknowledged
        return not has_gap_to_come and self._is_overdue(other, piece.acknowledged)

    def _is_overdue(self, stream: Stream, needed: int = 0) -> bool:
        return stream.is_overdue(self._arrivals, PATIENCE, self._now_ns, PATIENCE_NS, needed)

    def _deliver_held(self, *, force: bool = False) -> None:
        """Deliver bytes that need no longer wait; treat bytes missing for too long as lost.

        With `force` all missing bytes are treated as lost.
        """
        # Each round but the last one delivers bytes or gives up a hole.
        moved = True
        while moved:
            moved = False
            for stream, other in self._directions:
                while stream.held and stream.held[0].start == stream.position:
                    if not self._is_due(stream.held[0], other):
                        break
                    self._deliver(stream, stream.release())
                    moved = True
            if not moved:
                # Try first a stream whose beginning is not yet known: no gap is reported for it.
                streams = sorted(self._directions[0], key=lambda stream: not stream.joining)
                moved = any(self._give_up_missing_bytes(stream, force) for stream in streams)

    def _give_up_missing_bytes(self, stream: Stream, force: bool) -> bool:
        """Treat the bytes missing before the first held ones as lost, if they had time to come.

        With `force` they need no time. Returns True if bytes or a gap were delivered.
        """
        if not stream.held:
            return False
        first = stream.held[0]
        hole = first.start - stream.position
        if not (force or self._has_waited_enough(stream, first, hole)):
            return False
        if stream.joining and hole and stream.holds_a_probe:
            age, age_ns = self._arrivals - first.arrival, self._now_ns - first.ts_ns
            if not force and age < PATIENCE and age_ns < PATIENCE_NS:
                return False
            stream.release()
            stream.pass_over(hole + 1)
            self.keep_alives += 1
        elif hole:
            if stream.joining and first.start > LEAD:
                # The first segment of the other end had acknowledged the bytes before LEAD, so the
                # missing bytes are behind it.
                stream.pass_over(LEAD)
                hole = first.start - LEAD
            if not stream.joining:
                received_ns = stream.acknowledged_ns(first.start)
                gap = StreamGap(
                    first.ts_ns,
                    self.identity,
                    stream.direction,
                    hole,
                    acknowledged_ns=received_ns,
                )
                self._out.append(gap)
            stream.pass_over(hole)
        else:
            self._deliver(stream, stream.release())
        return True

    def _has_waited_enough(self, stream: Stream, first: HeldBytes, hole: int) -> bool:
        """True if a limit of bytes, time or segments ends the wait for the bytes before `first`."""
        if stream.is_overfull():
            return True
        if self._now_ns - min(piece.ts_ns for piece in stream.held) >= HOLE_NS:
            return True
        return hole > 0 and first.start <= stream.acknowledged and self._is_overdue(stream)

    def _deliver(self, stream: Stream, piece: HeldBytes) -> None:
        """Deliver the next bytes of the stream, or a gap if the snaplen cut them off."""
        if piece.arrival >= stream.latest[0]:
            stream.latest = (piece.arrival, piece.ts_ns)
        if piece.data:
            self._out.append(stream.deliver(piece.data, piece.receipt, piece.origin))
            return
        missing = piece.end - piece.start
        stream.advance(b"", missing)
        _, ts_ns = stream.latest
        self._out.append(StreamGap(ts_ns, self.identity, stream.direction, missing, EventKind.CUT))

    def _is_finished(self) -> bool:
        """True if both ends have sent FIN, and all bytes before both are delivered or given up."""
        return all(
            stream.finish is not None
            and not stream.held
            and (stream.joining or stream.position >= stream.finish)
            for stream in self._directions[0]
        )
