"""Reassembles TCP connections from packets, and returns their bytes in order."""

# Only connections with a wanted TCP port at one end are followed. Only the headers of other packets
# are read. The slave is the end with the wanted port. If both ends have one, the slave is the end
# that received the SYN; without a SYN it is the end with the lower port; with equal ports it is the
# destination of the first segment.
#
# A connection opens with a SYN or with its first payload. After its end its state is kept, so that
# late copies of its segments do not open another connection. A SYN with another sequence number
# opens one, and so do bytes beyond the last byte of the connection that ended.
#
# Limits: MAX_CONNECTIONS connections are kept; above that, the least recently used one is closed.
# At most MAX_HOLDING of them hold bytes that wait for earlier ones, each within the limits of a
# stream (at most about 32 MiB in all); above that, the connection that has held bytes longest stops
# waiting: its missing bytes become gaps. A connection is dropped after IDLE_NS of capture time
# without a segment, the least time before TCP sends a keep-alive probe (RFC 1122, 4.2.3.6).
#
# By default, packets between the same ends on another interface belong to another connection. If
# flows are followed across interfaces (`across`), they belong to the same one: copies are dropped,
# and missing bytes may come from either interface.
#
# Packets inside tunnels, which switches use to mirror over a network, are followed (tunnels.py).
#
# Datagrams of UDP from or to a wanted port are followed as well (udp_flows.py).
#
# IP fragments are reassembled first (fragments.py). If that fails, an event of the connection is
# reported if the ports are known and wanted. If the ports are unknown, because the first fragment
# is missing, one event is reported for each interface.

from __future__ import annotations

import struct
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Container, Iterable, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from mbtool.core import Connection, EventKind, Origin, Packet, WireEvent
from mbtool.core.limits import MODBUS_PORT
from mbtool.packets.connection import PATIENCE_NS, TcpConnection
from mbtool.packets.fragments import (
    Datagram,
    DatagramEnd,
    Fragments,
    find_fragment,
    fragment_events,
)
from mbtool.packets.line_packets import USER_LINK_TYPES
from mbtool.packets.link_layer import IP_FINDERS, NOT_IP, link_addresses
from mbtool.packets.segment import (
    ACK,
    RST,
    SYN,
    TcpSegment,
    endpoint,
    find_tcp,
    read_datagram,
    read_segment,
)
from mbtool.packets.stream_events import CloseReason, StreamEvent, StreamItem
from mbtool.packets.tunnels import GRE_IN_FRAGMENTS, MAX_TUNNELS, VXLAN_PORT, find_inner
from mbtool.packets.udp_flows import UdpFlows

if TYPE_CHECKING:
    from mbtool.packets.ended_connection import EndedConnection

MODBUS_PORTS = frozenset((MODBUS_PORT,))
MAX_CONNECTIONS = 4096
MAX_HOLDING = 256
"""At most this many connections hold bytes back at once, waiting for earlier bytes."""
IDLE_NS = 2 * 3600 * 1_000_000_000

_MAX_REPORTED = 4096
"""Messages about what cannot be read are remembered, so that each is reported only once for an
interface. After this many messages, no further one is reported."""
_SERIAL_HINT = "; if it holds bytes of a serial line, say which: --link rtu@19200-8E1"
_TCP_HEADER_SEEN = 14
"""The number of bytes of the TCP header up to and including its flags."""

FlowEnds = tuple[bytes, int, bytes, int]
"""The two ends of a TCP connection, as address (4 or 16 bytes) and port: first the end with the
lower port (with equal ports, the lower address), then the other end."""
_Key = tuple[str, bytes, int, bytes, int]
"""The key of a connection: the name of the interface, then FlowEnds. The name is "" if packets from
different interfaces may belong to one connection (`across`)."""


class TcpReassembler:
    """Reassembles the TCP connections that have a wanted port at one end."""

    def __init__(self, ports: Container[int] = MODBUS_PORTS, *, across: bool = False) -> None:
        """`ports` are the wanted TCP ports.

        `across` is True if packets from different interfaces may belong to one connection.
        """
        self._ports = ports
        self._across = across
        self._connections: OrderedDict[_Key, TcpConnection | EndedConnection] = OrderedDict()
        self._holding: dict[_Key, TcpConnection] = {}
        """The connections that hold back bytes until earlier ones come, in the order in which their
        wait began."""
        self._opened = 0
        self._fragments = Fragments()
        self._udp = UdpFlows(ports, across=across)
        self._checked_ns = 0
        self._reported: set[tuple[str, str]] = set()
        self._out: list[StreamItem] = []
        self._packet: Packet | None = None
        """The packet that `feed` is reading or read last; None before the first."""
        self._followed: TcpConnection | EndedConnection | None = None
        """The connection of the last segment that was taken; None before the first."""
        self._ip_at = 0
        """The length in bytes of the link-layer header of `_packet`, which has the MAC addresses; 0
        if the IP packet is inside a tunnel: the MAC addresses are then not those of its ends."""

    def feed(self, packet: Packet) -> list[StreamItem]:
        """Take a packet; return the bytes, gaps and events that are complete with it.

        Never raises, whatever the packet contains.
        """
        finder = IP_FINDERS.get(packet.link_type)
        if finder is None:
            message = f"link type {packet.link_type} cannot be looked into"
            if packet.link_type in USER_LINK_TYPES:
                message += _SERIAL_HINT
            self._report(packet.ts_ns, packet.link, EventKind.UNREADABLE, message)
            return self._take_out()
        data = packet.data
        at = finder(data)
        if at == NOT_IP:
            return []
        self._packet, self._ip_at = packet, at
        if not self._feed_ip(data, at, packet.original_length, packet.ts_ns, packet.link):
            self._feed_other(packet, at)
        items = self._out.copy()
        self._out.clear()
        return items

    def advance(self, now_ns: int) -> list[StreamItem]:
        """Set the capture's time to `now_ns` (UTC ns); return the items that become due.

        Bytes that are missing for too long are treated as lost, and idle connections are closed.
        """
        self._finish(self._fragments.advance(now_ns), now_ns)
        self._advance(now_ns)
        return self._take_out()

    def ignore(self, identity: Connection) -> None:
        """Deliver no more bytes of a connection, if the last segment belonged to it."""
        followed = self._followed
        if isinstance(followed, TcpConnection) and followed.identity is identity:
            followed.ignore()

    def find(self, ends: FlowEnds) -> TcpConnection | None:
        """Return the connection between two ends; call this only with `across`.

        Returns None if the connection is unknown, or if the array decoder has read it to its end.
        """
        found = self._connections.get(("", *ends))
        return found if isinstance(found, TcpConnection) else None

    def may_drop(self, now_ns: int, flows: Mapping[FlowEnds, int], more: int = 0) -> bool:
        """True if dropping connections up to the time `now_ns` (UTC ns) may change results.

        A connection is dropped if it is idle for IDLE_NS, or if there are more than
        MAX_CONNECTIONS. That may change results if the connection has not ended, or if it is one of
        `flows`: these get further segments, and are not idle for IDLE_NS after the first one, whose
        time `flows` gives. `more` is the largest number of connections that will open besides them.
        """
        known = self._connections
        used = {("", *ends): first_ns for ends, first_ns in flows.items()}
        excess = len(known) + len(used.keys() - known.keys()) + more - MAX_CONNECTIONS
        if excess > len(known):
            return True
        if any(not one.closed or key in used for key, one in islice(known.items(), max(excess, 0))):
            return True
        return any(
            used.get(key, now_ns) - one.last_ns >= IDLE_NS and (not one.closed or key in used)
            for key, one in known.items()
        )

    def reserve_numbers(self, count: int) -> int:
        """Reserve numbers for `count` connections of the array decoder; return the first."""
        first = self._opened
        self._opened += count
        return first

    def take_ended(self, ended: Iterable[tuple[FlowEnds, EndedConnection]]) -> None:
        """Store connections that the array decoder has read to their end.

        The caller then calls `forget_excess`.
        """
        for ends, connection in ended:
            self._connections[("", *ends)] = connection

    def forget_excess(self) -> None:
        """If more than MAX_CONNECTIONS connections are stored, drop the least recently used ones.

        The caller has made sure (`may_drop`) that all dropped connections have ended.
        """
        while len(self._connections) > MAX_CONNECTIONS:
            self._connections.popitem(last=False)

    def pass_times(
        self, times: Sequence[int], start: int, end: int
    ) -> list[tuple[int, list[StreamItem]]]:
        """Let the capture's time pass over packets that the array decoder has read.

        `times[start:end]` are the packets' times in UTC ns, ascending. Returns the items of other
        connections that become due at these times: the index in `times`, and the items due then.
        """
        delivered = []
        at = start
        while at < end:
            if -PATIENCE_NS < times[at] - self._checked_ns < PATIENCE_NS:
                at = bisect_left(times, self._checked_ns + PATIENCE_NS, at, end)
                continue
            self._advance(times[at])
            if self._out:
                delivered.append((at, self._take_out()))
            at += 1
        return delivered

    def note_used(self, flows: Iterable[FlowEnds]) -> None:
        """Mark connections as used, in this order; the least recently used one is dropped first."""
        for ends in flows:
            if ("", *ends) in self._connections:
                self._connections.move_to_end(("", *ends))

    def close(self, ts_ns: int) -> list[StreamItem]:
        """End all connections at `ts_ns`, the end of the capture; return their last items."""
        self._finish(self._fragments.close(), ts_ns)
        for connection in self._connections.values():
            connection.close(ts_ns, CloseReason.CAPTURE_END)
        self._connections.clear()
        self._holding.clear()
        return self._take_out()

    def _take_out(self) -> list[StreamItem]:
        items = self._out.copy()
        self._out.clear()
        return items

    def _feed_other(self, packet: Packet, at: int) -> None:
        """Take the IP packet at offset `at`, which is a fragment or may carry another packet."""
        data, length, ts_ns, link = packet.data, packet.original_length, packet.ts_ns, packet.link
        for _ in range(MAX_TUNNELS):
            fragment = find_fragment(data, at, length)
            if fragment is not None:
                scope = "" if self._across else link
                self._finish(self._fragments.feed(fragment, ts_ns, link, scope), ts_ns)
                return
            if self._feed_udp(packet, at):
                return
            at = find_inner(data, at, length)
            self._ip_at = 0  # MAC addresses outside a tunnel are not the master's or slave's.
            if at == GRE_IN_FRAGMENTS:
                message = "fragments of packets that carry others (GRE), which are not put together"
                self._report(ts_ns, link, EventKind.UNREADABLE, message)
            if at < 0 or self._feed_ip(data, at, length, ts_ns, link):
                return

    def _feed_udp(self, packet: Packet, at: int) -> bool:
        """Take the IP packet at offset `at`; return False if it is no datagram of a wanted port."""
        datagram = read_datagram(packet.data, at, packet.original_length)
        ports = self._ports
        if datagram is None or not (
            datagram.source_port in ports or datagram.destination_port in ports
        ):
            return False
        if VXLAN_PORT in (datagram.source_port, datagram.destination_port):
            return False
        self._out += self._udp.feed(datagram, packet.ts_ns, packet.link, self._origin())
        return True

    def _origin(self) -> Origin | None:
        """The origin of the bytes of the packet that is being read; None if it is unknown."""
        packet = self._packet
        if packet is None:
            return None
        addresses = link_addresses(packet.link_type, packet.data[: self._ip_at])
        return Origin(packet.file, packet.number, addresses)

    def _feed_ip(self, data: bytes, at: int, length: int, ts_ns: int, link: str) -> bool:
        """Take the IP packet at offset `at` of `data`; return False if it is a fragment or no TCP.

        `length` is the number of bytes that the captured packet had on the wire, `ts_ns` its time
        in UTC ns, and `link` the interface that captured it.
        """
        place = find_tcp(data, at, length)
        if place is None:
            return False
        start = place.start
        if len(data) < start + _TCP_HEADER_SEEN:
            if length > len(data):
                message = "packets are cut before the end of their headers; capture longer ones"
                self._report(ts_ns, link, EventKind.CUT, message)
            return True
        source_port = data[start] << 8 | data[start + 1]
        destination_port = data[start + 2] << 8 | data[start + 3]
        ports = self._ports
        if source_port in ports or destination_port in ports:
            segment = read_segment(data, at, place, length)
            if segment is not None:
                self._follow(segment, ts_ns, link)
        return True

    def _finish(self, datagrams: list[Datagram], ts_ns: int) -> None:
        """Take the TCP segments of reassembled packets; report fragments that overlap or are
        missing.

        `datagrams` are the packets whose reassembly has ended at `ts_ns` (UTC ns), whole or not.
        """
        for datagram in datagrams:
            data, length = datagram.packet()
            place = find_tcp(data, 0, length)
            if datagram.ending is DatagramEnd.WHOLE:  # First: this opens its connection.
                self._feed_ip(data, 0, length, ts_ns, datagram.link)
            if place is not None and len(data) >= place.start + 4:
                source_port, destination_port = struct.unpack_from(">HH", data, place.start)
                if source_port in self._ports or destination_port in self._ports:
                    self._report_fragments(datagram, ts_ns, source_port, destination_port)
            elif datagram.ending is not DatagramEnd.WHOLE:
                message = "fragments of packets whose first one is not in the capture"
                self._report(ts_ns, datagram.link, EventKind.UNREADABLE, message)

    def _report_fragments(
        self, datagram: Datagram, ts_ns: int, source_port: int, destination_port: int
    ) -> None:
        events = fragment_events(datagram, ts_ns, source_port, destination_port)
        if not events:
            return
        source, destination, *_ = datagram.key
        key, _ = self._key(datagram.link, source, source_port, destination, destination_port)
        known = self._connections.get(key)
        ends = endpoint(source, source_port), endpoint(destination, destination_port)
        identity = Connection(*ends) if known is None else known.identity
        self._out += (StreamEvent(identity, event) for event in events)

    def _follow(self, segment: TcpSegment, ts_ns: int, link: str) -> None:
        if not -PATIENCE_NS < ts_ns - self._checked_ns < PATIENCE_NS:
            self._advance(ts_ns)
        key, from_lower = self._key(
            link,
            segment.source,
            segment.source_port,
            segment.destination,
            segment.destination_port,
        )
        connection = self._connections.get(key)
        if connection is None or (
            (connection.closed or segment.flags & SYN)
            and connection.is_replaced_by(segment, from_lower=from_lower)
        ):
            opens = segment.flags & SYN or segment.payload or segment.missing
            if segment.flags & RST or not opens:
                return
            if connection is not None:
                connection.close(ts_ns, CloseReason.REPLACED)
            elif len(self._connections) >= MAX_CONNECTIONS:
                self._drop_oldest(ts_ns, CloseReason.DISCARDED)
            connection = self._open(segment, ts_ns, from_lower)
            self._connections[key] = connection
        self._connections.move_to_end(key)
        self._followed = connection
        origin = self._origin() if segment.payload and connection.wants_bytes else None
        holds_bytes = connection.feed(segment, ts_ns, from_lower=from_lower, origin=origin)
        if holds_bytes and isinstance(connection, TcpConnection):
            # _advance removes a connection from `_holding` when it holds back no more bytes.
            self._holding[key] = connection
            if len(self._holding) > MAX_HOLDING:
                self._holding.pop(next(iter(self._holding))).flush()

    def _key(
        self,
        link: str,
        source: bytes,
        source_port: int,
        destination: bytes,
        destination_port: int,
    ) -> tuple[_Key, bool]:
        """Return the key of a connection, which is equal for both directions, and a bool.

        The bool is True if the source has the lower port (with equal ports, the lower address).
        """
        scope = "" if self._across else link
        if (source_port, source) < (destination_port, destination):
            return (scope, source, source_port, destination, destination_port), True
        return (scope, destination, destination_port, source, source_port), False

    def _open(self, segment: TcpSegment, ts_ns: int, from_lower: bool) -> TcpConnection:
        from_master = _is_from_master(segment, self._ports)
        source = endpoint(segment.source, segment.source_port)
        destination = endpoint(segment.destination, segment.destination_port)
        ends = (source, destination) if from_master else (destination, source)
        identity = Connection(*ends, self._opened)
        self._opened += 1
        joined = not segment.flags & SYN
        return TcpConnection(
            identity, ts_ns, self._out, joined=joined, master_is_lower=from_master == from_lower
        )

    def _advance(self, now_ns: int) -> None:
        self._checked_ns = now_ns
        for key, connection in list(self._holding.items()):
            connection.advance(now_ns)
            if not connection.holds_bytes:
                del self._holding[key]
        while self._connections:
            oldest = next(iter(self._connections.values()))
            if now_ns - oldest.last_ns < IDLE_NS:
                break
            self._drop_oldest(now_ns, CloseReason.IDLE)

    def _drop_oldest(self, ts_ns: int, reason: CloseReason) -> None:
        key, connection = self._connections.popitem(last=False)
        self._holding.pop(key, None)
        connection.close(ts_ns, reason)

    def _report(self, ts_ns: int, link: str, kind: EventKind, message: str) -> None:
        """Append an event to the output, but only once for each interface and message."""
        report = (link, message)
        if report not in self._reported and len(self._reported) < _MAX_REPORTED:
            self._reported.add(report)
            self._out.append(WireEvent(ts_ns=ts_ns, link=link, kind=kind, message=message))


def _is_from_master(segment: TcpSegment, ports: Container[int]) -> bool:
    if segment.source_port not in ports:
        return True
    if segment.destination_port not in ports:
        return False
    if segment.flags & SYN:
        return not segment.flags & ACK
    return segment.destination_port <= segment.source_port
