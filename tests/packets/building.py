"""Builds packets and capture files for the tests, from the inside out."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from ipaddress import ip_address

from mbtool.core import Packet
from mbtool.packets.segment import ACK, FIN, SYN

MASTER = "10.0.0.1"
SLAVE = "10.0.0.2"
MASTER_PORT = 49152
SLAVE_PORT = 502


def tcp(
    source_port: int,
    destination_port: int,
    sequence: int,
    acknowledgement: int = 0,
    flags: int = ACK,
    payload: bytes = b"",
    options: bytes = b"",
) -> bytes:
    """Make a TCP segment; its checksum is wrong, as offload leaves it."""
    words = 5 + len(options) // 4
    header = struct.pack(
        ">HHIIBBHHH",
        source_port,
        destination_port,
        sequence & 0xFFFFFFFF,
        acknowledgement & 0xFFFFFFFF,
        words << 4,
        flags,
        8192,  # window
        0xBAD0,  # checksum
        0,  # urgent pointer
    )
    return header + options + payload


def udp(source_port: int, destination_port: int, payload: bytes) -> bytes:
    """Make a UDP datagram without a checksum."""
    return struct.pack(">HHHH", source_port, destination_port, 8 + len(payload), 0) + payload


def ipv4(
    payload: bytes,
    source: str = MASTER,
    destination: str = SLAVE,
    *,
    protocol: int = 6,
    options: bytes = b"",
    fragment: int = 0,
    identification: int = 1,
    total: int | None = None,
) -> bytes:
    """Make an IPv4 packet. `fragment` is the field of flags and offset."""
    header = struct.pack(
        ">BBHHHBBH4s4s",
        0x40 | 5 + len(options) // 4,
        0,
        20 + len(options) + len(payload) if total is None else total,
        identification,
        fragment,
        64,  # time to live
        protocol,
        0,  # checksum
        ip_address(source).packed,
        ip_address(destination).packed,
    )
    return header + options + payload


def ipv6(
    payload: bytes,
    source: str = "fd00::1",
    destination: str = "fd00::2",
    *,
    following: int = 6,
) -> bytes:
    """Make an IPv6 packet. `following` is the next header's type."""
    header = struct.pack(">IHBB", 6 << 28, len(payload), following, 64)
    return header + ip_address(source).packed + ip_address(destination).packed + payload


def in_fragments(whole: Packet, *sizes: int, identification: int = 7) -> list[Packet]:
    """Cut an Ethernet packet of IPv4 into fragments of these sizes in bytes and one of the rest."""
    end = 14 + int.from_bytes(whole.data[16:18], "big")
    source, destination = (str(ip_address(whole.data[at : at + 4])) for at in (26, 30))
    payload, at = whole.data[34:end], 0
    parts = []
    for size in (*sizes, len(payload)):
        part = payload[at : at + size]
        more = at + len(part) < len(payload)
        field_ = at // 8 | (0x2000 if more else 0)
        data = ipv4(
            part,
            source,
            destination,
            protocol=whole.data[23],
            fragment=field_,
            identification=identification,
        )
        parts.append(replace(whole, data=ethernet(data), original_length=len(ethernet(data))))
        at += size
        if not more:
            break
    return parts


def ethernet(payload: bytes, kind: int = 0x0800, tags: bytes = b"") -> bytes:
    """Make an Ethernet frame, padded to its least length."""
    return (bytes(12) + tags + kind.to_bytes(2, "big") + payload).ljust(60, b"\0")


def gre(inner: bytes, protocol: int, header: bytes = b"", *, flags: int = 0) -> bytes:
    """Make a GRE packet in IPv4; `header` has the optional fields before `inner`."""
    return ipv4(struct.pack(">HH", flags, protocol) + header + inner, protocol=47)


ERSPAN_II = bytes.fromhex("0000002a  1001 0001 00000000")
"""A sequence number of GRE, then version 1, VLAN 1, session 1 and port 0 of ERSPAN."""


def erspan(frame: bytes) -> bytes:
    """Make a packet with a mirrored Ethernet frame: ERSPAN type II."""
    return ethernet(gre(frame, 0x88BE, ERSPAN_II, flags=0x1000))


def vxlan(frame: bytes) -> bytes:
    """Make a VXLAN packet."""
    header = struct.pack(">HHHH", 50000, 4789, 16 + len(frame), 0) + bytes.fromhex(
        "0800000000002a00"
    )
    return ethernet(ipv4(header + frame, protocol=17))


def packet(
    data: bytes,
    ts_ns: int = 0,
    *,
    link_type: int = 1,
    link: str = "if0",
    original_length: int | None = None,
) -> Packet:
    length = len(data) if original_length is None else original_length
    return Packet(ts_ns=ts_ns, link=link, link_type=link_type, data=data, original_length=length)


@dataclass
class End:
    """One end of a conversation and the next sequence number that it sends."""

    host: str
    port: int
    sequence: int


@dataclass
class Talk:
    """A conversation between a master and a slave, one millisecond for each packet."""

    master: End = field(default_factory=lambda: End(MASTER, MASTER_PORT, 1000))
    slave: End = field(default_factory=lambda: End(SLAVE, SLAVE_PORT, 5000))
    ts_ns: int = 0

    def handshake(self) -> list[Packet]:
        return [
            self.send(self.master, flags=SYN),
            self.send(self.slave, flags=SYN | ACK),
            self.send(self.master),
        ]

    def request(self, payload: bytes) -> Packet:
        return self.send(self.master, payload)

    def response(self, payload: bytes) -> Packet:
        return self.send(self.slave, payload)

    def goodbye(self) -> list[Packet]:
        return [
            self.send(self.master, flags=FIN | ACK),
            self.send(self.slave, flags=FIN | ACK),
            self.send(self.master),
        ]

    def send(self, sender: End, payload: bytes = b"", flags: int = ACK) -> Packet:
        """Send in order; the sequence numbers move on."""
        sent = self.at(sender, sender.sequence, payload, flags)
        sender.sequence += len(payload) + bool(flags & (SYN | FIN))
        return sent

    def at(self, sender: End, sequence: int, payload: bytes = b"", flags: int = ACK) -> Packet:
        """Send at any sequence number; only the time moves on."""
        other = self.slave if sender is self.master else self.master
        acknowledgement = other.sequence if flags & ACK else 0
        self.ts_ns += 1_000_000
        data = tcp(sender.port, other.port, sequence, acknowledgement, flags, payload)
        return packet(ethernet(ipv4(data, sender.host, other.host)), self.ts_ns)


def cut(whole: Packet, length: int) -> Packet:
    """Keep only the first bytes of a packet, as a snapshot length does."""
    return replace(whole, data=whole.data[:length])


def pcap(packets: list[Packet], order: str = "<", *, magic: int = 0xA1B2C3D4) -> bytes:
    """Make a pcap file; the magic gives the unit of its fractions."""
    unit = 1 if magic == 0xA1B23C4D else 1000
    extra = bytes(8) if magic == 0xA1B2CD34 else b""
    link_type = packets[0].link_type if packets else 1
    parts = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link_type)]
    for each in packets:
        seconds, rest = divmod(each.ts_ns, 1_000_000_000)
        head = struct.pack(
            order + "IIII", seconds, rest // unit, len(each.data), each.original_length
        )
        parts += [head, extra, each.data]
    return b"".join(parts)


@dataclass(frozen=True)
class Pcapng:
    """Makes the blocks of a pcapng file in one byte order."""

    order: str = "<"

    def block(self, kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        length = struct.pack(self.order + "I", len(body) + 12)
        return struct.pack(self.order + "I", kind) + length + body + length

    def section(self) -> bytes:
        return self.block(0x0A0D0D0A, struct.pack(self.order + "IHHq", 0x1A2B3C4D, 1, 0, -1))

    def interface(
        self, link_type: int = 1, snaplen: int = 0, options: dict[int, bytes] | None = None
    ) -> bytes:
        body = struct.pack(self.order + "HHI", link_type, 0, snaplen)
        for code, value in (options or {}).items():
            body += struct.pack(self.order + "HH", code, len(value)) + value
            body += bytes(-len(value) % 4)
        return self.block(1, body + (bytes(4) if options else b""))

    def enhanced(self, data: bytes, ticks: int = 0, interface: int = 0) -> bytes:
        head = struct.pack(
            self.order + "IIIII", interface, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data)
        )
        return self.block(6, head + data)

    def simple(self, data: bytes, original_length: int | None = None) -> bytes:
        length = len(data) if original_length is None else original_length
        return self.block(3, struct.pack(self.order + "I", length) + data)

    def obsolete(self, data: bytes, ticks: int = 0, interface: int = 0) -> bytes:
        head = struct.pack(
            self.order + "HHIIII",
            interface,
            7,  # drops
            ticks >> 32,
            ticks & 0xFFFFFFFF,
            len(data),
            len(data),
        )
        return self.block(2, head + data)
