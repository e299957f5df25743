"""Decodes packets and serial reads into named transactions and events, one item at a time."""

# The Decoder takes packets, serial reads and the bytes that a tap forwards. The result for a link
# is the same however its bytes were cut into items, and the same live and from a file.
#
# State: one Bus for each serial link (a TapPair if its chunks name a direction), and one
# ProtocolDetector for each open connection. At most MAX_CONNECTIONS detectors are kept; beyond that
# the one that was silent longest is closed.
#
# With `any_port` every TCP connection is followed. One that turns out not to be Modbus produces no
# opening, closing or segment events, and one FOREIGN event for each slave endpoint (for both
# endpoints if the roles are unknown), up to MAX_FOREIGN_REPORTED endpoints. Its further bytes are
# not reassembled, so that other protocols cost little. Modbus is expected at 502 and at the ports
# that the user named, with `any_port` too.
#
# A connection that two interfaces captured is decoded twice, unless `across` treats them as one.

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from mbtool.core import (
    CONNECTION_CLOSED,
    CONNECTION_JOINED,
    CONNECTION_OPENED,
    Chunk,
    Connection,
    Direction,
    EventKind,
    LineSettings,
    Packet,
    Quiet,
    SerialFormat,
    SerialLink,
    Stamp,
    StreamPlace,
    WireEvent,
)
from mbtool.core.limits import MODBUS_PORT
from mbtool.decode.connections import Bus, ConnectionDecoder, Decoded, skipped_event
from mbtool.decode.line_timing import LineTiming
from mbtool.decode.pairing import Pairing
from mbtool.decode.protocol_detection import ProtocolDetector, ProtocolState, ProvenSlaves
from mbtool.decode.tap_pair import TapPair
from mbtool.decode.transactions import Ends
from mbtool.decode.usb_adapters import UsbAdapters
from mbtool.devices import NamedTransaction, Namer
from mbtool.framing.rtu_lengths import MIN_FRAME, why_skipped
from mbtool.modbus import Transaction
from mbtool.modbus.adu import Adu, Checksum, DirectionBy, Skipped, Transport, crc, read_frame
from mbtool.packets import (
    SERIAL_LINK_TYPES,
    USER_LINK_TYPES,
    CloseReason,
    StreamClosed,
    StreamEvent,
    StreamGap,
    StreamItem,
    StreamOpened,
    TcpReassembler,
    serial_pieces,
)
from mbtool.packets.reassembler import MAX_CONNECTIONS, FlowEnds
from mbtool.packets.usb import USB_LINK_TYPES

if TYPE_CHECKING:
    from mbtool.decode.plain_stretch import PlainStretch
    from mbtool.packets.connection import TcpConnection
    from mbtool.packets.plain_bytes import RestPlace

# The code below decodes a serial line from a program's log that has whole frames and names their
# senders.
#
# Each chunk is one frame with a known direction, so no search is needed: it becomes an ADU and goes
# to the pairing. The time of a frame, for its first and last byte alike, is the time at which the
# program noted it. If the log has no times, only the order of the frames is known.
#
# A chunk that is no frame, or a frame with a wrong CRC or LRC, becomes a skipped event.
#
# Memory: that of the pairing.


class FramedLine:
    """Takes whole frames; returns ADUs, transactions and events."""

    def __init__(self, link: str, *, timed: bool) -> None:
        """`timed` is False if the frames have no known times."""
        self._link = link
        self._pairing = Pairing(Ends(link, timed=timed))

    def feed(
        self, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None
    ) -> list[Decoded]:
        """Take one frame, which was noted at `ts_ns`; return what it completes."""
        found = _parts(data)
        if found is None or not found[-1].ok:
            kind, reason, check = why_skipped(data, (direction,))
            skipped = Skipped(ts_ns, kind, reason, data, check)
            done = self._pairing.note_skipped(skipped)
            return [*done, skipped_event(skipped, self._link, ("", ""))]
        transport, unit, pdu, checksum = found
        adu = Adu(
            start_ns=ts_ns,
            end_ns=ts_ns,
            transport=transport,
            direction=direction,
            direction_by=DirectionBy.PORT,
            confidence=1.0,
            unit=unit,
            pdu=pdu,
            raw=data,
            checksum=checksum,
            origin=None if place is None else place.origin,
        )
        return [adu, *self._pairing.feed(adu)]

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note silence until `now_ns`; return the transactions that time out."""
        return [*self._pairing.advance(now_ns)]

    def close(self, end_ns: int | None = None) -> list[Decoded]:
        """End the line, whose capture ended at `end_ns`; return its unanswered requests."""
        return [*self._pairing.close(end_ns)]


def _parts(data: bytes) -> tuple[Transport, int, bytes, Checksum] | None:
    """Return the form, the unit, the PDU and the checksum of a frame; None if it is no frame."""
    frame = read_frame(data) if data.startswith(b":") else None
    if frame is not None and len(frame.body) > 1:
        return Transport.ASCII, frame.body[0], frame.body[1:], frame.checksum
    if len(data) < MIN_FRAME:
        return None
    checksum = Checksum(int.from_bytes(data[-2:], "little"), crc(data[:-2]))
    return Transport.RTU, data[0], data[1:-2], checksum


MAX_FOREIGN_REPORTED = 4096
"""At most this many endpoints that do not use Modbus are reported, each once; bytes of further ones
are not reported."""

_EVERY_PORT = range(1 << 16)
_DROPPED = (
    f"connection no longer followed: it was silent longest of more than {MAX_CONNECTIONS} at once"
)
_UNSEEN_ENDS = frozenset((CloseReason.CAPTURE_END, CloseReason.DISCARDED))
"""Reasons for which the decoder stops following a connection that may still be open."""
_LOSS = frozenset((EventKind.DISCARDED, EventKind.GAP, EventKind.CUT))
"""Kinds of events for missing bytes of a link. After such an event, the decoding of a serial line
begins anew."""

Evidence = (
    Chunk | Packet | Quiet | StreamOpened | StreamGap | StreamClosed | StreamEvent | WireEvent
)
Record = NamedTransaction | WireEvent


class RestingConnection(NamedTuple):
    """A connection with no pending request, no buffered bytes and no undecided pairing."""

    connection: TcpConnection
    decoder: ConnectionDecoder
    place: RestPlace

    def pass_plain(self, stretch: PlainStretch) -> None:
        """Note transactions that the array decoder (columns/) decoded, as if they had been fed."""
        self.connection.pass_plain(stretch.requests, stretch.responses)
        self.decoder.pass_plain(stretch, self.place)


class Decoder:
    """Takes packets and serial reads; returns each transaction as soon as it is complete."""

    def __init__(
        self,
        namer: Namer,
        *,
        lines: Mapping[str, SerialLink] | None = None,
        line: LineSettings | None = None,
        timing: LineTiming | None = None,
        ports: Iterable[int] = (),
        rtu_ports: Iterable[int] = (),
        any_port: bool = False,
        across: bool = False,
    ) -> None:
        """Set up the links to decode.

        `lines` are the serial links by name; `line` holds the settings of all other serial links;
        `timing` gives t1.5 and t3.5 of both. `ports` (Modbus/TCP) and `rtu_ports` (RTU over TCP)
        are the TCP ports to decode in packets; with `any_port` connections on all other ports are
        examined too. `across` treats packets from several interfaces as one network's.
        """
        self._namer = namer
        self._lines = dict(lines or {})
        self._line = line or LineSettings(SerialFormat())
        self._is_line_given = line is not None
        self._timing = timing or LineTiming()
        self._serial_types = SERIAL_LINK_TYPES | (USER_LINK_TYPES if line is not None else set())
        self._rtu_ports = frozenset(rtu_ports)
        self._any_port = any_port
        self._proven_slaves = ProvenSlaves()
        self._ports = frozenset((*ports, *self._rtu_ports, *((MODBUS_PORT,) if any_port else ())))
        self._reassembler = TcpReassembler(_EVERY_PORT if any_port else self._ports, across=across)
        self._buses: dict[str, Bus | TapPair | FramedLine] = {}
        self._untimed: set[str] = set()
        """Names of the serial links whose bytes have no known times, as in a file of raw bytes."""
        self._detectors: OrderedDict[Connection, ProtocolDetector] = OrderedDict()
        """The detector of each connection, the connection that was silent longest first."""
        self._interfaces: set[str] = set()
        """Names of the network interfaces from which packets came."""
        self._foreign_endpoints: set[str] = set()
        """Endpoints already reported as not Modbus, with `any_port`: the slave's, or both if the
        capture does not show who opened the connection."""
        self._usb = UsbAdapters()
        self._last_ns = 0

    def feed(self, item: Evidence) -> list[Record]:
        """Take the next packet, serial read or event; return the records that it completes."""
        if isinstance(item, WireEvent):
            return self._wire_event(item)
        self._last_ns = max(self._last_ns, item.ts_ns)
        if not isinstance(item, Packet):
            return _HANDLERS[type(item)](self, item)
        if item.link_type in self._serial_types:
            return self._dispatch(serial_pieces(item))
        if item.link_type in USB_LINK_TYPES:
            return self._usb_packet(item)
        self._interfaces.add(item.link)
        return self._dispatch(self._reassembler.feed(item))

    def _usb_packet(self, packet: Packet) -> list[Record]:
        records: list[Record] = []
        for piece in self._usb.feed(packet):
            if isinstance(piece, Chunk) and self._usb.has_changed(piece.link):
                records += self.end_line(piece.link)
            self._last_ns = max(self._last_ns, piece.ts_ns)
            if isinstance(piece, Chunk):
                records += self._chunk(piece)
            else:
                records += self._wire_event(piece)
        return records

    def format_of(self, link: str) -> SerialFormat | None:
        """Return a serial link's settings with t1.5 and t3.5; None if its bytes have no times.

        Raises UsageError if the line's settings contradict each other.
        """
        if link in self._untimed:
            return None
        return self._timing.format_of(self.line_of(link))

    def line_of(self, link: str) -> SerialLink:
        """Return a serial link with its ports and its settings as the user gave them."""
        known = self._lines.get(link)
        if known is None and not self._is_line_given:
            known = self._usb.line(link)
        return known or self._line.link_at(link)

    def begin_line(self, line: SerialLink) -> None:
        """Set the settings of the serial link named `line.name`, before its bytes are fed."""
        self._lines[line.name] = line

    def end_line(self, link: str) -> list[Record]:
        """End a serial link; return the results of its buffered bytes and its pending request."""
        bus = self._buses.pop(link, None)
        return [] if bus is None else self._to_records(bus.close(self._last_ns))

    def break_lines(self) -> list[Record]:
        """End all serial links, as bytes of each may be missing; return their last results."""
        return [record for link in [*self._buses] for record in self.end_line(link)]

    @property
    def reassembler(self) -> TcpReassembler:
        """The reassembler that follows the TCP connections in packets."""
        return self._reassembler

    def at_rest(self, ends: FlowEnds, now_ns: int) -> RestingConnection | None:
        """Return a connection whose next transactions the array decoder (columns/) may decode.

        None if the connection is unknown or not yet known to be Modbus/TCP, or has a pending
        request, buffered bytes or an undecided pairing. `now_ns` is the time of its next packet.
        """
        connection = self._reassembler.find(ends)
        place = None if connection is None else connection.rest_place
        detector = None if connection is None else self._detectors.get(connection.identity)
        decoder = None if detector is None else detector.plain_decoder()
        if connection is None or place is None or decoder is None:
            return None
        positions = place.request_position, place.response_position
        if not decoder.is_at_rest(*positions, now_ns):
            return None
        return RestingConnection(connection, decoder, place)

    def opens_modbus_tcp(self, ends: FlowEnds) -> bool:
        """True if a SYN between `ends` begins a new connection, on no port for RTU over TCP."""
        known = self._reassembler.find(ends)
        _, lower, _, upper = ends
        return (known is None or known.closed) and self._rtu_ports.isdisjoint((lower, upper))

    def pass_times(
        self, times: Sequence[int], start: int, end: int
    ) -> list[tuple[int, list[Record]]]:
        """Advance the time of other connections by packets that the array decoder (columns/) took.

        `times[start:end]` are the packets' times in ns, ascending. Where other connections have
        records due by such a time, returns the time's index in `times` with these records.
        """
        delivered = self._reassembler.pass_times(times, start, end)
        return [(at, self._dispatch(items)) for at, items in delivered]

    def note_time(self, ts_ns: int) -> None:
        """Note the time (ns) of the latest packet that the array decoder (columns/) took."""
        self._last_ns = max(self._last_ns, ts_ns)

    def close(self) -> list[Record]:
        """End the input: return the transactions and events that are still incomplete."""
        return self._dispatch(self._reassembler.close(self._last_ns)) + self._close_all()

    def _close_all(self) -> list[Record]:
        detectors, self._detectors = self._detectors, OrderedDict()
        records: list[Record] = []
        for detector in detectors.values():
            records += self._end(detector, self._last_ns)
        return records + self.break_lines()

    def _dispatch(self, items: Iterable[StreamItem]) -> list[Record]:
        records: list[Record] = []
        for item in items:
            records += _HANDLERS[type(item)](self, item)
        return records

    def _chunk(self, chunk: Chunk) -> list[Record]:
        if chunk.connection is None:
            bus = self._bus(chunk)
            if isinstance(bus, TapPair):
                return self._to_records(bus.feed(chunk.direction, chunk.data, chunk.ts_ns))
            if isinstance(bus, FramedLine):
                heard = bus.feed(chunk.direction, chunk.data, chunk.ts_ns, chunk.place)
                return self._to_records(heard)
            return self._to_records(bus.feed(chunk.data, chunk.ts_ns, chunk.place))
        # Without a StreamOpened before it, the connection may have begun in a log's earlier file.
        detector = self._detectors.get(chunk.connection)
        if detector is None:
            timed = chunk.stamp is not Stamp.UNKNOWN
            detector = self._detector(chunk.connection, joined=True, timed=timed)
        self._detectors.move_to_end(chunk.connection)
        decoded = detector.feed(chunk.direction, chunk.data, chunk.ts_ns, chunk.place)
        if detector.state is ProtocolState.FOREIGN:
            decoded = self._without_repeated_reports(detector, decoded)
            if not self._is_expected(chunk.connection):
                self._reassembler.ignore(chunk.connection)
        records = self._to_records(decoded)
        if len(self._detectors) > MAX_CONNECTIONS:
            _, oldest = self._detectors.popitem(last=False)
            records += self._end(oldest, self._last_ns)
        return records

    def _feed_quiet(self, quiet: Quiet) -> list[Record]:
        bus = self._buses.get(quiet.link)
        if bus is not None:
            return self._to_records(bus.advance(quiet.ts_ns))
        records: list[Record] = []
        is_interface = quiet.link in self._interfaces
        if is_interface:
            records += self._dispatch(self._reassembler.advance(quiet.ts_ns))
        for connection, detector in self._detectors.items():
            # A Quiet says that nothing was heard until its time. From a tap it concerns connections
            # of the tap's link. From an interface it concerns those of all other links.
            if (connection.link == quiet.link) is not is_interface:
                records += self._to_records(detector.advance(quiet.ts_ns))
        return records

    def _stream_opened(self, item: StreamOpened) -> list[Record]:
        text = CONNECTION_JOINED if item.joined else CONNECTION_OPENED
        text = f"{text}: {item.note}" if item.note else text
        opened = _connection_event(item, EventKind.OPENED, text)
        detector = self._detector(item.connection, joined=item.joined)
        if self._is_expected(item.connection):
            return [detector.with_detected_roles(opened)]
        detector.hold(opened)
        return []

    def _stream_gap(self, item: StreamGap) -> list[Record]:
        # A gap may be reported after the connection's end and must not open the connection again.
        # So a detector that is made for the gap alone is not kept.
        known = self._detectors.get(item.connection)
        detector = known or self._new_detector(item.connection, joined=True)
        gap = detector.gap(
            item.direction, item.missing, item.ts_ns, item.kind, item.acknowledged_ns
        )
        return self._to_records(self._without_repeated_reports(detector, gap))

    def _stream_closed(self, item: StreamClosed) -> list[Record]:
        detector = self._detectors.pop(item.connection, None)
        is_cut_off = item.reason in _UNSEEN_ENDS
        end_ns = max(item.ts_ns, self._last_ns) if is_cut_off else None
        if item.unseen_since_ns is not None:
            end_ns = item.unseen_since_ns
        records = [] if detector is None else self._end(detector, end_ns)
        state = None if detector is None else detector.state
        if state is not ProtocolState.MODBUS and not self._is_expected(item.connection):
            return records
        discarded = item.reason is CloseReason.DISCARDED
        # A connection that is not Modbus is not decoded any more, so dropping it loses nothing.
        is_loss = discarded and state is not ProtocolState.FOREIGN
        kind = EventKind.DISCARDED if is_loss else EventKind.CLOSED
        probes = f", {item.keep_alives} keep-alive probes" if item.keep_alives else ""
        if item.unanswered_probes:
            probes += f", the last {item.unanswered_probes} unanswered"
        text = _DROPPED if discarded else _closing_text(item)
        closed = _connection_event(item, kind, text + probes)
        return [*records, closed if detector is None else detector.with_detected_roles(closed)]

    def _stream_event(self, item: StreamEvent) -> list[Record]:
        detector = self._detectors.get(item.connection)
        state = None if detector is None else detector.state
        if detector is not None and state is ProtocolState.MODBUS:
            return [detector.with_detected_roles(item.event)]
        if self._is_expected(item.connection):
            return [item.event]
        if detector is not None and state is ProtocolState.UNDECIDED:
            detector.hold(item.event)
            return []
        # For a connection without a detector, report only data that was dropped at a limit.
        is_reported = state is None and item.event.kind is EventKind.DISCARDED
        return [item.event] if is_reported else []

    def _wire_event(self, event: WireEvent) -> list[Record]:
        """Return the event. If it means lost bytes, first end the links on which they were lost."""
        if event.kind is EventKind.GAP and not event.link:
            # An event without a link marks a damaged place in a log: bytes of any link may be
            # missing.
            records = self._close_all()
        else:
            records = self.end_line(event.link) if event.kind in _LOSS else []
        self._last_ns = max(self._last_ns, event.ts_ns)  # The lost bytes are earlier.
        return [*records, event]

    def _bus(self, chunk: Chunk) -> Bus | TapPair | FramedLine:
        link = chunk.link
        bus = self._buses.get(link)
        if bus is None:
            line = self.line_of(link)
            format_, is_ascii = self._timing.format_of(line), line.ascii
            timed = chunk.stamp is not Stamp.UNKNOWN
            if not timed:
                self._untimed.add(link)
            if chunk.direction is not Direction.UNKNOWN and chunk.stamp is not Stamp.LAST_BYTE:
                bus = FramedLine(link, timed=timed)
            elif chunk.direction is Direction.UNKNOWN:
                timeout_ns = self._timing.response_timeout_ns(format_)
                bus = Bus(
                    link, format_, ascii=is_ascii, timed=timed, response_timeout_ns=timeout_ns
                )
            else:
                bus = TapPair(link, format_, ascii=is_ascii)
            self._buses[link] = bus
        return bus

    def _detector(
        self, connection: Connection, *, joined: bool, timed: bool = True
    ) -> ProtocolDetector:
        detector = self._detectors.get(connection)
        if detector is None:
            detector = self._new_detector(connection, joined=joined, timed=timed)
            self._detectors[connection] = detector
        self._detectors.move_to_end(connection)
        return detector

    def _new_detector(
        self, connection: Connection, *, joined: bool, timed: bool = True
    ) -> ProtocolDetector:
        # With `any_port` the reassembler takes the end that opened the connection for the master.
        # A named port outweighs that: the end that uses it is the slave.
        ends = [connection.slave.port, connection.master.port]
        swapped = self._any_port and ends[1] in self._ports and ends[0] not in self._ports
        is_rtu = ends[swapped] in self._rtu_ports
        return ProtocolDetector(
            connection,
            joined=joined,
            expected=self._is_expected(connection),
            tcp=not is_rtu,
            rtu=is_rtu or self._any_port,
            swapped=swapped,
            timed=timed,
            slaves=self._proven_slaves,
        )

    def _is_expected(self, connection: Connection) -> bool:
        """True if Modbus is expected: `any_port` is off, or a port is 502 or named by the user."""
        ports = self._ports
        named = connection.slave.port in ports or connection.master.port in ports
        return named or not self._any_port

    def _end(self, detector: ProtocolDetector, end_ns: int | None) -> list[Record]:
        """End a connection; `end_ns` is the capture's end, None if the connection has ended."""
        return self._to_records(self._without_repeated_reports(detector, detector.close(end_ns)))

    def _without_repeated_reports(
        self, detector: ProtocolDetector, decoded: list[Decoded]
    ) -> list[Decoded]:
        """Drop `decoded` if it reports that an endpoint is not Modbus and an earlier report did so.

        Where Modbus is expected, every report is kept.
        """
        if not decoded or detector.state is not ProtocolState.FOREIGN:
            return decoded
        if self._is_expected(detector.connection):
            return decoded
        ends = detector.connection
        # If the capture lacks the connection's beginning, either end may be the slave.
        slaves = {str(ends.slave), str(ends.master)} if detector.joined else {str(ends.slave)}
        known = self._foreign_endpoints
        if slaves & known or len(known) >= MAX_FOREIGN_REPORTED:
            return []
        known |= slaves
        return decoded

    def _to_records(self, decoded: list[Decoded]) -> list[Record]:
        """Add the words of device profiles to transactions, keep the events, leave out the ADUs."""
        records: list[Record] = []
        for one in decoded:
            if isinstance(one, Transaction):
                records.append(self._namer.name(one))
            elif not isinstance(one, Adu):
                records.append(one)
        return records


_HANDLERS: dict[type[Evidence], Callable[[Decoder, Any], list[Record]]] = {
    Chunk: Decoder._chunk,
    Quiet: Decoder._feed_quiet,
    StreamClosed: Decoder._stream_closed,
    StreamEvent: Decoder._stream_event,
    StreamGap: Decoder._stream_gap,
    StreamOpened: Decoder._stream_opened,
    WireEvent: Decoder._wire_event,
}


def opening_event(ts_ns: int, connection: Connection) -> WireEvent:
    """Make the event of a connection that begins with a SYN."""
    opened = StreamOpened(ts_ns, connection, joined=False)
    return _connection_event(opened, EventKind.OPENED, CONNECTION_OPENED)


def closing_event(ts_ns: int, connection: Connection, by: Direction) -> WireEvent:
    """Make the event of a connection that both ends have ended with a FIN, first the end whose
    bytes have the direction `by`.
    """
    closed = StreamClosed(ts_ns, connection, CloseReason.FINISHED, by)
    return _connection_event(closed, EventKind.CLOSED, _closing_text(closed))


def _closing_text(closed: StreamClosed) -> str:
    """The message of a CLOSED event; ConnectionEnd (core/evidence.py) reads it."""
    whose = {Direction.REQUEST: " by the master", Direction.RESPONSE: " by the slave"}
    by = "" if closed.by is None else whose.get(closed.by, "")
    return f"{CONNECTION_CLOSED}{closed.reason}{by}"


def _connection_event(
    item: StreamOpened | StreamClosed, kind: EventKind, message: str
) -> WireEvent:
    return WireEvent(
        ts_ns=item.ts_ns,
        link=item.connection.link,
        kind=kind,
        message=message,
        source=str(item.connection.master),
        destination=str(item.connection.slave),
    )
