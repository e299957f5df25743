"""Decodes the bytes of one serial line or one TCP connection into transactions."""

# A splitter cuts the bytes into ADUs; `Pairing` (serial lines) or `NetworkPairing` (TCP) joins
# requests and responses into transactions. The results come in the order of the wire: every `Adu`,
# every `Transaction` as soon as it is complete, and a `WireEvent` for everything else, such as
# skipped bytes.

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from mbtool.core import Direction, EventKind, Origin, SerialFormat, WireEvent
from mbtool.core.moments import counted
from mbtool.decode.network_pairing import NetworkPairing
from mbtool.decode.pairing import Pairing
from mbtool.decode.stream_progress import OTHER, AduPlace, StreamProgress
from mbtool.decode.transactions import Ends
from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_lengths import frame_size
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter
from mbtool.modbus.adu import Adu, Skipped, crc
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.modbus.transaction import Transaction
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.bus_model import BusModel
from mbtool.serial_line.rtu import RtuSplitter

if TYPE_CHECKING:
    from mbtool.core import Connection, StreamPlace
    from mbtool.decode.plain_stretch import PlainLimits, PlainStretch
    from mbtool.packets.plain_bytes import RestPlace

# The code below tells if one direction of an RTU connection carries both requests and responses
# of a whole line.
#
# Some serial servers and port redirectors send all that they hear on a line to whoever connects.
#
# The splitter of one direction skips the frames of the other direction. This direction carries a
# whole line if the skipped bytes are whole frames of the other direction with correct CRCs, and if
# one of them and the frame next to it are a request and its response. Two CRCs, unit, function and
# length agree by chance less than once in 2^40 times.


def begin_of_bus(
    events: Sequence[Adu | Skipped], before: Adu | None, direction: Direction
) -> int | None:
    """Return the index of the first event from which on the bytes are a whole line; else None.

    `events` are those of a splitter of `direction`, `before` the frame that preceded them, None if
    there was none. The index is -1 if the line begins with `before`.
    """
    frames: list[Adu | Skipped | None] = [before, *events]
    for at, (one, after) in enumerate(pairwise(frames)):
        if direction is Direction.RESPONSE and isinstance(one, Skipped) and isinstance(after, Adu):
            requests = _frames(one.raw, Direction.REQUEST)
            if requests and _answers(requests[-1], after.raw):
                return at - 1
        if direction is Direction.REQUEST and isinstance(one, Adu) and isinstance(after, Skipped):
            responses = _frames(after.raw, Direction.RESPONSE)
            if responses and _answers(one.raw, responses[0]):
                return at - 1
    return None


def _frames(raw: bytes, direction: Direction) -> list[bytes]:
    """Return the frames of a direction that `raw` consists of; empty if it has other bytes, too."""
    frames = []
    while raw:
        size = frame_size(raw, direction)
        if not size or size > len(raw) or crc(raw[:size]) != 0:
            return []
        frames.append(raw[:size])
        raw = raw[size:]
    return frames


def _answers(request: bytes, response: bytes) -> bool:
    """True if a frame has the unit of a request and the form of its response."""
    expected = ExpectedResponse.of(request[1:-2])
    return expected is not None and request[0] == response[0] and expected.fits(response[1:-2])


# The code below finds where the frames of a serial line stand in the file that holds its bytes.
#
# The raw bytes of a splitter's events, in order, are the bytes that the splitter was fed. So counts
# of the bytes fed and of the bytes in events give the place of every frame. In a file of bytes this
# is the offset of its first byte; in a file of packets, the packet with its last byte.
#
# Memory: one mark for each read that still has bytes in the splitter.


class SerialOrigins:
    """Counts the bytes into and out of a splitter, to find where each ADU stands in its file."""

    def __init__(self) -> None:
        self._marks: deque[tuple[int, int, StreamPlace | None]] = deque()
        """For each read that still has bytes in the splitter: the number of bytes fed before the
        read, the number fed up to its end, and its place in the file."""
        self._fed = 0
        self._given = 0

    @property
    def held(self) -> int:
        """The number of reads of which the splitter still holds bytes."""
        return len(self._marks)

    def note(self, size: int, place: StreamPlace | None) -> None:
        """Note that the splitter is fed `size` bytes, which stand at `place` in a capture file.

        `place` is None if that is unknown.
        """
        if size:
            self._marks.append((self._fed, self._fed + size, place))
            self._fed += size

    def added_to(self, events: list[Adu | Skipped]) -> list[Adu | Skipped]:
        """Return the splitter's next events, with the origin of each ADU added."""
        found: list[Adu | Skipped] = []
        for event in events:
            start, self._given = self._given, self._given + len(event.raw)
            if isinstance(event, Adu):
                found.append(replace(event, origin=self._origin(start, self._given - 1)))
            else:
                found.append(event)
            while self._marks and self._marks[0][1] <= self._given:
                self._marks.popleft()
        return found

    def _origin(self, first: int, last: int) -> Origin | None:
        """Return where an ADU stands in its file; None if that is unknown.

        `first` and `last` are the numbers of its bytes, counted from 0, among all bytes fed.
        """
        for begin, end, place in self._marks:
            if place is None or place.origin is None:
                continue
            origin = place.origin
            if not origin.packet and begin <= first < end:
                return Origin(origin.file, 0, origin.addresses, place.position + first - begin)
            if origin.packet and begin <= last < end:
                return origin
        return None


Decoded = Adu | Transaction | WireEvent
DISORDER = (
    "times of reads are earlier than those of the reads before: silences are uncertain here, "
    "and the bytes decide"
)
HEARD_AGAIN = (
    "the other direction of this connection has these bytes, too: it carries the whole line"
)
STREAM_LINE = SerialFormat(115200, 8, "N", 1)
"""The settings of a line that one direction of a connection carries. Nothing tells its rate, and
bytes come in segments; the fastest usual rate makes the fewest silences vanish."""


_FIN = 1
"""A FIN counts as one byte of the stream (RFC 793, 3.3)."""


class _LostBytes(NamedTuple):
    """Bytes of one direction of a connection that the capture lacks."""

    direction: Direction
    size: int
    end: int | None
    """The stream position (see AduPlace) of the first byte behind the lost bytes; None if
    unknown."""
    since_ns: int | None = None
    """The time (ns) of the segment that acknowledged all of the lost bytes; None if unknown."""


class Bus:
    """Decodes a serial line on which one tap hears both the master and the slaves."""

    def __init__(
        self,
        link: str,
        line: SerialFormat,
        *,
        ascii: bool = False,  # noqa: A002
        timed: bool = True,
        response_timeout_ns: int | None = None,
    ) -> None:
        """Set up the line.

        `timed` is False if the bytes have no known times, as in a raw file. `response_timeout_ns`
        is the time (ns) that the master waits before it repeats a request; None if that is not
        known.
        """
        self._ends = Ends(link, timed=timed)
        self._splitter: AsciiSplitter | RtuSplitter
        if ascii:
            self._splitter = AsciiSplitter(line, timed=timed)
            self._pairing = Pairing(self._ends)
        else:
            model = BusModel(timed=timed, response_timeout_ns=response_timeout_ns)
            self._splitter = RtuSplitter(line, model, timed=timed)
            self._pairing = Pairing(self._ends, model.history.master_still_waits)
        self._told_disorder = False
        self._origins: SerialOrigins | None = None
        """Finds where each frame stands in the capture file; None until bytes come whose place in a
        file is known."""

    def feed(self, data: bytes, ts_ns: int, place: StreamPlace | None = None) -> list[Decoded]:
        """Take the bytes of one read; return the ADUs, transactions and events that they complete.

        `ts_ns` is the time of the last byte; `place` is the position of the bytes in a capture
        file, None if they come from no file.
        """
        if self._origins is not None or place is not None:
            self._note_origin(len(data), place)
        events = self._splitter.feed(data, ts_ns)
        # Most reads complete no frame; returning early for them makes RTU decoding 8 % faster.
        return self._pair_adus(events) if events else []

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note silence from the last byte until `now_ns`.

        Returns the ADUs, transactions and events that the silence completes, such as a request that
        has waited too long for its response.
        """
        decoded = self._pair_adus(self._splitter.advance(now_ns))
        # Bytes that the splitter still holds may be the awaited response. So no request times out
        # while the splitter holds any.
        return [*decoded, *self._pairing.advance(now_ns)] if self._splitter.is_idle else decoded

    def close(self, end_ns: int | None = None) -> list[Decoded]:
        """End the line: return the results of its buffered bytes and of its pending request.

        `end_ns` is the time at which the capture ended: a pending request whose response may have
        come later gets the outcome `not-captured`. If `end_ns` is None, a pending request gets the
        outcome `no-answer`.
        """
        events = self._splitter.close()
        end_ns = _until_unread(events, end_ns)
        return [*self._pair_adus(events), *self._pairing.close(end_ns)]

    def _note_origin(self, size: int, place: StreamPlace | None) -> None:
        if self._origins is None:
            self._origins = SerialOrigins()
        self._origins.note(size, place)

    def _pair_adus(self, events: list[Adu | Skipped]) -> list[Decoded]:
        if self._origins is not None:
            events = self._origins.added_to(events)
        decoded = _pair_adus(events, self._pairing, self._ends.link, ("", ""))
        if self._splitter.has_disorder and not self._told_disorder and events:
            self._told_disorder = True
            decoded.append(
                WireEvent(
                    ts_ns=events[-1].ts_ns
                    if isinstance(events[-1], Skipped)
                    else events[-1].end_ns,
                    link=self._ends.link,
                    kind=EventKind.DISORDER,
                    message=DISORDER,
                )
            )
        return decoded


def stream_splitter(
    direction: Direction, *, rtu: bool, is_udp: bool = False
) -> MbapSplitter | RtuStreamSplitter:
    """Make the splitter of one direction of a connection, or of its datagrams."""
    if rtu:
        return RtuStreamSplitter(direction, is_udp=is_udp)
    return MbapSplitter(direction, by_segments=True, is_udp=is_udp)


class ConnectionDecoder:
    """Decodes a TCP connection between a master and a slave, or their datagrams."""

    def __init__(
        self, connection: Connection, *, rtu: bool = False, joined: bool = False, timed: bool = True
    ) -> None:
        """`joined` is True if the capture lacks the beginning of the connection, `timed` False if
        its bytes have no known times.
        """
        self._link = connection.link
        self._is_udp = connection.is_udp
        master, slave = str(connection.master), str(connection.slave)
        self._endpoints = {
            Direction.REQUEST: (master, slave),
            Direction.RESPONSE: (slave, master),
        }
        """By direction, the endpoints (host and port) of the sender and the receiver."""
        self._splitters = {
            each: stream_splitter(each, rtu=rtu, is_udp=connection.is_udp)
            for each in self._endpoints
        }
        self._pairing = NetworkPairing(Ends(self._link, master, slave, timed=timed), joined=joined)
        self._last_adus: dict[Direction, Adu] = {}
        """The last frame of each direction of RTU over TCP."""
        self._bus: Bus | None = None
        """The decoder of a whole line that one direction carries (Bus); None if each
        direction has its own frames."""
        self._bus_direction = Direction.UNKNOWN
        self._is_heard_again = False
        """True if the whole line has the requests of the other direction, too."""
        self._last_ns = 0
        """The time of the last segment with payload, in ns."""
        self._progress = {direction: StreamProgress() for direction in OTHER}

    def feed(
        self, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None = None
    ) -> list[Decoded]:
        """Take the payload of one TCP segment, which came at `ts_ns`.

        Returns the ADUs, transactions and events that it completes, in the order of the wire.
        `place` is the payload's position in the stream; None if the source gives no positions.
        """
        self._last_ns = ts_ns
        if self._is_udp:
            return self._feed_datagram(direction, data, ts_ns, place)
        if self._bus is not None:
            return self._feed_bus(self._bus, direction, data, ts_ns, place)
        origin = None if place is None else place.origin
        splitter = self._splitters[direction]
        events = splitter.feed(data, ts_ns, origin)
        if isinstance(splitter, RtuStreamSplitter) and events:
            before = self._last_adus.get(direction)
            begin = begin_of_bus(events, before, direction)
            if begin is not None:
                return self._begin_bus(splitter, direction, events, begin, ts_ns, place)
            if frames := [one for one in events if isinstance(one, Adu)]:
                self._last_adus[direction] = frames[-1]
        if place is None:
            gaps = [
                _LostBytes(one, progress.take_missing_bytes(), None)
                for one, progress in self._progress.items()
            ]
            return [*self._report_losses(gaps, ts_ns), *self._pair_adus(events, direction)]
        self._progress[direction].take(place, len(data))
        return self._pair_with_known_losses(events, direction, ts_ns)

    def _feed_datagram(
        self, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None
    ) -> list[Decoded]:
        """Take a datagram: its bytes continue no earlier datagram."""
        splitter = self._splitters[direction]
        decoded = self._pair_adus(splitter.restart(), direction)
        origin = None if place is None else place.origin
        return [*decoded, *self._pair_adus(splitter.feed(data, ts_ns, origin), direction)]

    def _begin_bus(
        self,
        splitter: RtuStreamSplitter,
        direction: Direction,
        events: list[Adu | Skipped],
        begin: int,
        ts_ns: int,
        place: StreamPlace | None,
    ) -> list[Decoded]:
        """Decode from now on as a whole line what one direction carries.

        The line begins with the event at index `begin`, or with the frame before the events if that
        is -1. Requests that wait for a response in the other direction are on the line as well.
        """
        decoded = self._pair_adus(events[: max(begin, 0)], direction)
        before, sent = self._last_adus.get(direction), self._last_adus.get(OTHER[direction])
        pieces = [(one.raw, _end_ns(one)) for one in events[max(begin, 0) :]]
        if begin < 0 and before is not None:
            pieces.insert(0, (before.raw, before.end_ns))
        pieces.append((splitter.take_rest(), ts_ns))
        self._is_heard_again = sent is not None and any(sent.raw in raw for raw, _ in pieces)
        self._bus, self._bus_direction = Bus(self._link, STREAM_LINE), direction
        for at_ns, of_segment in groupby(pieces, key=lambda piece: piece[1]):
            decoded += self._bus.feed(b"".join(raw for raw, _ in of_segment), at_ns, place)
        return decoded

    def _feed_bus(
        self, bus: Bus, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None
    ) -> list[Decoded]:
        """Decode bytes of a connection whose one direction carries a whole line."""
        if direction is self._bus_direction or not self._is_heard_again:
            return bus.feed(data, ts_ns, place)
        again = Skipped(ts_ns, EventKind.ECHO, HEARD_AGAIN, data)
        return [skipped_event(again, self._link, self._endpoints[direction])]

    def is_at_rest(self, request_position: int, response_position: int, now_ns: int) -> bool:
        """True if no request is pending, no byte is buffered, and no byte so far is missing.

        The array decoder (columns/) may then decode what follows. The positions are the stream
        positions of the next byte of each direction; `now_ns` is the time of the next segment.
        """
        return (
            all(splitter.is_idle for splitter in self._splitters.values())
            and self._progress[Direction.REQUEST].is_at_rest(request_position)
            and self._progress[Direction.RESPONSE].is_at_rest(response_position)
            and self._pairing.is_at_rest(now_ns)
        )

    def limits(self) -> PlainLimits:
        """Return which transactions the array decoder must leave to `feed`."""
        return self._pairing.limits()

    def pass_plain(self, stretch: PlainStretch, place: RestPlace) -> None:
        """Note transactions of this connection that the array decoder (columns/) has decoded.

        `place` gives the stream positions of their first request and first response.
        """
        requests, responses = stretch.requests.size, stretch.responses.size
        before = place.response_position + responses - stretch.last_response_size
        self._progress[Direction.REQUEST].pass_plain(requests, before)
        after = place.request_position + requests
        self._progress[Direction.RESPONSE].pass_plain(responses, after)
        self._last_ns = stretch.responses.last_ns
        self._pairing.pass_plain(stretch)

    def _report_losses(self, losses: list[_LostBytes], ts_ns: int) -> list[Decoded]:
        """Tell the pairing of lost requests, then of lost responses.

        `ts_ns` is the time at which the loss was noticed. Returns the transactions that the losses
        complete.
        """
        return [
            each
            for loss in sorted(losses, key=lambda loss: loss.direction is Direction.RESPONSE)
            if loss.size
            for each in self._pairing.note_loss(
                loss.direction, loss.size, min(ts_ns, loss.since_ns or ts_ns), loss.end
            )
        ]

    def gap(
        self,
        direction: Direction,
        missing: int,
        ts_ns: int,
        kind: EventKind = EventKind.GAP,
        acknowledged_ns: int | None = None,
    ) -> list[Decoded]:
        """Note that the capture lacks `missing` bytes of one direction; 0 if the number is unknown.

        `ts_ns` is the time at which the gap was noticed. `kind` is the kind of event to report: GAP
        if packets are missing, CUT if packets were cut. `acknowledged_ns` is the time of the
        segment that acknowledged all missing bytes; None if unknown.
        """
        source, destination = self._endpoints[direction]
        lost = WireEvent(
            ts_ns=ts_ns,
            link=self._link,
            kind=kind,
            message=f"{missing or 'an unknown number of'} bytes are missing from the capture",
            source=source,
            destination=destination,
            missing=missing,
        )
        if self._bus is not None:
            told, self._bus = self._bus.close(ts_ns), Bus(self._link, STREAM_LINE)
            return [*told, lost]
        events = self._splitters[direction].gap(missing)
        decoded = self._pair_with_known_losses(events, direction, ts_ns) if events else []
        cut = sum(event.missing for event in events if isinstance(event, Adu))
        known_ns = ts_ns if kind is EventKind.CUT else acknowledged_ns
        self._progress[direction].skip(missing, cut, known_ns)
        if not missing:
            decoded += self._pairing.note_loss(direction, 0, ts_ns)
        return [*decoded, lost]

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note that no segment came until `now_ns`; return the transactions that time out."""
        if self._bus is not None:
            return self._bus.advance(now_ns)
        return [*self._pairing.advance(now_ns)]

    def close(self, end_ns: int | None = None) -> list[Decoded]:
        """End the connection: return the results of its buffered bytes and pending requests.

        `end_ns` is the time at which its capture ended: a request whose response may have come
        later gets the outcome `not-captured`. It is None if the connection itself ended, so that no
        response can come.
        """
        if self._bus is not None:
            return self._bus.close(end_ns)
        decoded: list[Decoded] = []
        for direction, splitter in self._splitters.items():
            events = splitter.close()
            if direction is Direction.RESPONSE:
                end_ns = _until_unread(events, end_ns)
            decoded += self._pair_adus(events, direction)
        lost = {direction: progress.end() for direction, progress in self._progress.items()}
        losses = [_LostBytes(one, size, None) for one, size in lost.items() if size > _FIN]
        decoded += self._report_losses(losses, self._last_ns)
        if lost[Direction.RESPONSE] > _FIN:  # One byte may be a FIN, so the number is unsure.
            decoded += self._pairing.note_loss(Direction.RESPONSE, 0, self._last_ns)
        return [*decoded, *self._pairing.close(end_ns)]

    def _pair_with_known_losses(
        self, events: list[Adu | Skipped], direction: Direction, ts_ns: int
    ) -> list[Decoded]:
        """Give the ADUs of one direction to the pairing; return ADUs, transactions and events.

        Before each ADU, the pairing gets the number of bytes that the capture lacks there, by the
        stream positions and acknowledgements. `ts_ns` is the time of the segment, or of the
        gap, that completed `events`.
        """
        other, progress = OTHER[direction], self._progress[direction]
        if progress.captured is None:
            return self._pair_adus(events, direction)
        end, received = progress.captured - progress.unread, progress.received
        losses: list[_LostBytes] = []
        if events or direction is Direction.RESPONSE:
            # A segment with the beginning of a request may acknowledge lost responses. They are
            # reported only when the request is complete, because requests lost before it must be
            # reported first.
            of_responses = other is Direction.RESPONSE
            lost = self._progress[other].acknowledge(received, of_responses=of_responses)
            self._pairing.response_is_cut = of_responses and self._progress[other].has_part
            if lost:
                losses.append(_LostBytes(other, lost, received, self._progress[other].lost_ns))
        decoded: list[Decoded] = []
        for event in events:
            size = len(event.raw)
            progress.unread -= size
            start, end = end, end + size
            if isinstance(event, Adu):
                end += event.missing
                lost = progress.read(start, end)
                if lost:
                    losses.append(_LostBytes(direction, lost, start, progress.lost_ns))
                if losses:
                    decoded += self._report_losses(losses, ts_ns)
                    losses = []
                decoded.append(event)
                decoded += self._pairing.feed(event, AduPlace(end, received))
            else:
                decoded += self._pair_adus([event], direction)
        if losses:
            decoded += self._report_losses(losses, ts_ns)
        return decoded

    def _pair_adus(self, events: list[Adu | Skipped], direction: Direction) -> list[Decoded]:
        return _pair_adus(events, self._pairing, self._link, self._endpoints[direction])


def _pair_adus(
    events: list[Adu | Skipped],
    pairing: Pairing | NetworkPairing,
    link: str,
    endpoints: tuple[str, str],
) -> list[Decoded]:
    """Give the ADUs among a splitter's events to `pairing`.

    Returns the ADUs, the transactions that they complete, and an event for each skipped piece.
    `endpoints` are the sender and receiver of skipped bytes.
    """
    decoded: list[Decoded] = []
    for event in events:
        if isinstance(event, Adu):
            decoded.append(event)
            decoded += pairing.feed(event)
        else:
            decoded += pairing.note_skipped(event)
            decoded.append(skipped_event(event, link, endpoints))
    return decoded


def _end_ns(event: Adu | Skipped) -> int:
    return event.end_ns if isinstance(event, Adu) else event.ts_ns


def _until_unread(events: list[Adu | Skipped], end_ns: int | None) -> int | None:
    """Return the time (ns) from which on the capture may lack responses; None if `end_ns` is None.

    `end_ns` is the time at which the capture ended. `events` are those that the splitter returned
    at its end. Skipped bytes among them may begin a response, so the time of these bytes is
    returned if it is earlier.
    """
    if end_ns is None:
        return None
    return min([end_ns, *(event.ts_ns for event in events if isinstance(event, Skipped))])


def skipped_event(
    skipped: Skipped, link: str, endpoints: tuple[str, str], speaker: str = ""
) -> WireEvent:
    """Make the event for bytes that were not decoded.

    `endpoints` are their sender and receiver on a network, two "" on a serial line. `speaker` is
    "the master" or "a slave" if the tap tells who sent them on a serial line, else "".
    """
    amount = counted(len(skipped.raw), "byte") + (f" of {speaker}" if speaker else "")
    return WireEvent(
        ts_ns=skipped.ts_ns,
        link=link,
        kind=skipped.kind,
        message=f"{amount}: {skipped.reason}",
        source=endpoints[0],
        destination=endpoints[1],
        raw=skipped.raw,
    )
