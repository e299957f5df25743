"""Packets in, the bytes of TCP connections out."""

# Only connections with a wanted port on either end are followed; a packet of others costs a look at
# its headers. The slave is the end whose port is wanted; where both are, the end that got the SYN,
# without one the end with the lower port, with equal ports the destination of the first segment.
#
# A connection opens with a SYN or with its first payload. After its end its state stays, so that
# late copies open no other; a SYN with another sequence number, or bytes behind the end, do.
#
# Bounds: MAX_CONNECTIONS are kept, of which MAX_WAITING hold bytes (each within a stream's bounds:
# at most about 32 MiB in all); beyond, the least recently used is closed and the one that began to
# wait first gives up its holes. State is dropped after IDLE_NS of capture time, which RFC 1122,
# 4.2.3.6, names as the least before a living connection sends a keep-alive probe.
#
# Fragments of IP packets are not put together: the first of a train is one event.

from __future__ import annotations

import ipaddress
from collections import OrderedDict

from mbtool.core import Connection, Endpoint, EventKind, Packet, WireEvent
from mbtool.packets.connection import PATIENCE_NS, TcpConnection
from mbtool.packets.link_layer import IP_FINDERS, NOT_IP
from mbtool.packets.segment import ACK, RST, SYN, Segment, TcpPlace, find_tcp, read_segment
from mbtool.packets.stream_events import CloseReason, StreamItem

MODBUS_PORTS = frozenset((502,))
MAX_CONNECTIONS = 4096
MAX_WAITING = 256
IDLE_NS = 2 * 3600 * 1_000_000_000

_MAX_TOLD = 4096
_TCP_HEADER_SEEN = 14
"""Bytes of the TCP header up to its flags."""

_Key = tuple[bytes, int, bytes, int]


class TcpReassembler:
    """Follows the connections of some ports."""

    def __init__(self, ports: frozenset[int] = MODBUS_PORTS) -> None:
        self._ports = ports
        self._connections: OrderedDict[_Key, TcpConnection] = OrderedDict()
        self._waiting: dict[_Key, TcpConnection] = {}
        self._opened = 0
        self._checked_ns = 0
        self._told: set[tuple[str, str]] = set()
        self._out: list[StreamItem] = []

    def feed(self, packet: Packet) -> list[StreamItem]:
        """Take a packet. Never raises for what is in it."""
        finder = IP_FINDERS.get(packet.link_type)
        if finder is None:
            message = f"link type {packet.link_type} cannot be looked into"
            return self._tell(packet, EventKind.UNREADABLE, message)
        data = packet.data
        at = finder(data)
        if at == NOT_IP:
            return []
        place = find_tcp(data, at, packet.original_length)
        if place is None:
            return []
        start = place.start
        if len(data) < start + _TCP_HEADER_SEEN:
            if packet.original_length == len(data):
                return []
            message = "packets are cut before the end of their headers; capture longer ones"
            return self._tell(packet, EventKind.CUT, message)
        source_port = data[start] << 8 | data[start + 1]
        destination_port = data[start + 2] << 8 | data[start + 3]
        ports = self._ports
        if source_port in ports or destination_port in ports:
            self._follow(packet, at, place)
        return self._take_out()

    def advance(self, now_ns: int) -> list[StreamItem]:
        """Let capture time pass: what waited for too long is given up, the idle are closed."""
        self._advance(now_ns)
        return self._take_out()

    def close(self, ts_ns: int) -> list[StreamItem]:
        """End all connections, as the capture ends."""
        for connection in self._connections.values():
            connection.close(ts_ns, CloseReason.CAPTURE_END)
        self._connections.clear()
        self._waiting.clear()
        return self._take_out()

    def _take_out(self) -> list[StreamItem]:
        if not self._out:
            return []
        items = self._out.copy()
        self._out.clear()
        return items

    def _follow(self, packet: Packet, at: int, place: TcpPlace) -> None:
        segment = read_segment(packet.data, at, place, packet.original_length)
        if segment is None:
            return
        ts_ns = packet.ts_ns
        if not -PATIENCE_NS < ts_ns - self._checked_ns < PATIENCE_NS:
            self._advance(ts_ns)
        if place.fragment:
            self._out.append(_fragment(segment, packet))
            return
        key, from_lower = _key(segment)
        connection = self._connections.get(key)
        if connection is None or connection.is_replaced_by(segment, from_lower=from_lower):
            opens = segment.flags & SYN or segment.payload or segment.missing
            if segment.flags & RST or not opens:
                return
            if connection is not None:
                connection.close(ts_ns, CloseReason.REPLACED)
            connection = self._open(segment, ts_ns, from_lower)
            self._connections[key] = connection
        self._connections.move_to_end(key)
        connection.feed(segment, ts_ns, from_lower=from_lower)
        if connection.waiting:  # Who no longer waits is taken out by _advance.
            self._waiting[key] = connection
            if len(self._waiting) > MAX_WAITING:
                self._waiting.pop(next(iter(self._waiting))).flush()

    def _open(self, segment: Segment, ts_ns: int, from_lower: bool) -> TcpConnection:
        if len(self._connections) >= MAX_CONNECTIONS:
            self._drop_oldest(ts_ns, CloseReason.DISCARDED)
        from_master = _is_from_master(segment, self._ports)
        source = Endpoint(_host(segment.source), segment.source_port)
        destination = Endpoint(_host(segment.destination), segment.destination_port)
        identity = (
            Connection(source, destination, self._opened)
            if from_master
            else Connection(destination, source, self._opened)
        )
        self._opened += 1
        joined = not segment.flags & SYN
        return TcpConnection(
            identity, ts_ns, self._out, joined=joined, master_is_lower=from_master == from_lower
        )

    def _advance(self, now_ns: int) -> None:
        self._checked_ns = now_ns
        for key, connection in list(self._waiting.items()):
            connection.advance(now_ns)
            if not connection.waiting:
                del self._waiting[key]
        while self._connections:
            oldest = next(iter(self._connections.values()))
            if now_ns - oldest.last_ns < IDLE_NS:
                break
            self._drop_oldest(now_ns, CloseReason.IDLE)

    def _drop_oldest(self, ts_ns: int, reason: CloseReason) -> None:
        key, connection = self._connections.popitem(last=False)
        self._waiting.pop(key, None)
        connection.close(ts_ns, reason)

    def _tell(self, packet: Packet, kind: EventKind, message: str) -> list[StreamItem]:
        """Say once for each interface what its packets lack."""
        told = (packet.link, message)
        if told in self._told or len(self._told) >= _MAX_TOLD:
            return []
        self._told.add(told)
        return [WireEvent(ts_ns=packet.ts_ns, link=packet.link, kind=kind, message=message)]


def _key(segment: Segment) -> tuple[_Key, bool]:
    """Name a connection the same from both ends; True where the segment is the lower end's."""
    source, source_port, destination, destination_port = segment[:4]
    if (source_port, source) < (destination_port, destination):
        return (source, source_port, destination, destination_port), True
    return (destination, destination_port, source, source_port), False


def _is_from_master(segment: Segment, ports: frozenset[int]) -> bool:
    if segment.source_port not in ports:
        return True
    if segment.destination_port not in ports:
        return False
    if segment.flags & SYN:
        return not segment.flags & ACK
    return segment.destination_port <= segment.source_port


def _host(address: bytes) -> str:
    return str(ipaddress.ip_address(address))


def _fragment(segment: Segment, packet: Packet) -> WireEvent:
    return WireEvent(
        ts_ns=packet.ts_ns,
        link=packet.link,
        kind=EventKind.UNREADABLE,
        message="a packet in fragments, which are not put together",
        source=str(Endpoint(_host(segment.source), segment.source_port)),
        destination=str(Endpoint(_host(segment.destination), segment.destination_port)),
        raw=segment.payload,
    )
