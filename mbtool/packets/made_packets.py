"""Makes packets of bytes of a network that were heard without packets, as by a tap."""

# Each piece of bytes becomes one packet of link type 101 (raw IP): a TCP segment, or a datagram of
# UDP, with the addresses and ports of its connection. The sequence and acknowledgement numbers of a
# connection go on from packet to packet. Nothing else is made: no handshake, no end, no packet
# without bytes.
#
# Memory: two numbers for each connection of the input, all of them until its end.

from __future__ import annotations

import struct
from ipaddress import ip_address

from mbtool.core import Connection, Direction, Packet
from mbtool.packets.segment import ACK, TCP, UDP

RAW_IP = 101
_PUSH = 0x08
_FIRST = 1
"""The sequence number of the first byte in each direction."""
_WINDOW = 0xFFFF
_HOPS = 64
_MOST_BYTES = 0xFFFF - 20 - 20
"""The most bytes of payload in a packet of IPv4 with TCP."""


class PacketMaker:
    """Makes a packet of each piece of bytes of connections, in the order of sending."""

    def __init__(self) -> None:
        self._next: dict[tuple[Connection, Direction], int] = {}
        """The sequence number of the next byte in one direction of a connection."""

    def packet(
        self, connection: Connection, direction: Direction, data: bytes, ts_ns: int
    ) -> Packet:
        """Return the packet that carries the next bytes of one direction of a connection.

        Raises ValueError if an end of the connection is a name and no address, or if there are
        more bytes than fit into a packet.
        """
        ends = connection.master, connection.slave
        back = Direction.RESPONSE
        if direction is Direction.RESPONSE:
            ends, back = ends[::-1], Direction.REQUEST
        source, destination = (ip_address(end.host) for end in ends)
        if source.version != destination.version:
            raise ValueError("one end is IPv4, the other one IPv6")
        ports = tuple(end.port for end in ends)
        if len(data) > _MOST_BYTES:
            raise ValueError(f"{len(data)} bytes do not fit into a packet")
        if connection.is_udp:
            protocol, header = UDP, struct.pack(">HHHH", *ports, 8 + len(data), 0)
        else:
            sent = self._next.get((connection, direction), _FIRST)
            heard = self._next.get((connection, back), _FIRST)
            self._next[connection, direction] = (sent + len(data)) & 0xFFFFFFFF
            form = 5 << 4, ACK | _PUSH, _WINDOW, 0, 0
            protocol, header = TCP, struct.pack(">HHIIBBHHH", *ports, sent, heard, *form)
        addresses = source.packed + destination.packed
        size = len(header) + len(data)
        pseudo = addresses + struct.pack(">IxxxB", size, protocol)
        sum_at = 6 if connection.is_udp else 16
        checksum = internet_checksum(pseudo + header + data)
        if connection.is_udp and not checksum:
            checksum = 0xFFFF  # 0 would mean none (RFC 768).
        header = header[:sum_at] + struct.pack(">H", checksum) + header[sum_at + 2 :]
        whole = _ip_header(addresses, size, protocol) + header + data
        return Packet(
            ts_ns=ts_ns, link="", link_type=RAW_IP, data=whole, original_length=len(whole)
        )


def _ip_header(addresses: bytes, size: int, protocol: int) -> bytes:
    """Return an IP header for the two addresses, and for `size` bytes behind it."""
    if len(addresses) > 8:
        return struct.pack(">IHBB", 6 << 28, size, protocol, _HOPS) + addresses
    header = struct.pack(">BBHHHBBH", 0x45, 0, 20 + size, 0, 0, _HOPS, protocol, 0) + addresses
    return header[:10] + struct.pack(">H", internet_checksum(header)) + header[12:]


def internet_checksum(data: bytes) -> int:
    """Compute the checksum of IPv4, TCP and UDP (RFC 1071) over bytes whose own field is 0."""
    padded = data + bytes(len(data) % 2)
    total: int = sum(struct.unpack(f">{len(padded) // 2}H", padded))
    while total > 0xFFFF:
        total = (total & 0xFFFF) + (total >> 16)
    return 0xFFFF - total
