"""Finds the two ends of the TCP connection that a packet belongs to."""

# Packets inside tunnels belong to the connection inside. A fragment without a TCP header belongs to
# no connection here, because its ports are only known after reassembly.

from __future__ import annotations

from ipaddress import ip_address

from mbtool.core import Packet
from mbtool.packets.link_layer import IP_FINDERS, NOT_IP
from mbtool.packets.segment import find_tcp
from mbtool.packets.tunnels import MAX_TUNNELS, find_inner

TcpEnd = tuple[bytes, int]
"""An address (4 or 16 bytes) and a TCP port."""
TcpEnds = frozenset[TcpEnd]
"""The two ends of a connection, in no order; one if both are the same."""


def tcp_ends(packet: Packet) -> TcpEnds | None:
    """Return the ends of the connection; None if the packet holds no TCP."""
    finder = IP_FINDERS.get(packet.link_type)
    if finder is None:
        return None
    data, at = packet.data, finder(packet.data)
    for _ in range(MAX_TUNNELS + 1):
        if at < 0 or at == NOT_IP:
            return None
        place = find_tcp(data, at, packet.original_length)
        if place is not None:
            start = place.start
            if len(data) < start + 4:
                return None
            first, size = (at + 12, 4) if data[at] >> 4 == 4 else (at + 8, 16)
            addresses = data[first : first + size], data[first + size : first + 2 * size]
            ports = data[start] << 8 | data[start + 1], data[start + 2] << 8 | data[start + 3]
            return frozenset(zip(addresses, ports, strict=True))
        at = find_inner(data, at, packet.original_length)
    return None


def end_of(text: str | None) -> TcpEnd | None:
    """Return the end that a text such as `10.0.0.9:502` names; None if it names no IP address."""
    host, _, port = (text or "").rpartition(":")
    try:
        return ip_address(host.strip("[]")).packed, int(port)
    except ValueError:
        return None
