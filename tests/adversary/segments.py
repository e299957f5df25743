"""Reads the TCP segments out of packets, just well enough to tell what a packet has of an ADU."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.core import Packet

LINK_HEADERS = {0: 4, 1: 14, 101: 0, 108: 4, 113: 16, 276: 20}
"""Header sizes in bytes: loopback (0, 108), Ethernet, raw IP and Linux cooked (113, 276)."""
VLAN_TYPES = (b"\x81\x00", b"\x88\xa8")
ACK = 0x10

Flow = tuple[bytes, bytes, int, int]


@dataclass(frozen=True, slots=True)
class Part:
    """What a packet has of one direction of a connection."""

    flow: Flow
    """Sender, receiver, and their ports."""
    sequence: int
    acknowledgement: int | None
    payload: bytes

    @property
    def end(self) -> int:
        return (self.sequence + len(self.payload)) & 0xFFFFFFFF

    @property
    def is_sent_back(self) -> Flow:
        source, destination, source_port, destination_port = self.flow
        return destination, source, destination_port, source_port


def part_of(packet: Packet) -> Part | None:
    """The TCP segment of a packet; None if it has none, or a fragment, or another link type."""
    header = LINK_HEADERS.get(packet.link_type)
    if header is None:
        return None
    data = packet.data
    if packet.link_type == 1:
        while data[header - 2 : header] in VLAN_TYPES:
            header += 4
    return _of_ip(data[header:])


def is_at_or_after(one: int, other: int) -> bool:
    """True if a sequence number is equal to another or after it."""
    return (one - other) & 0xFFFFFFFF < 1 << 31


def _of_ip(ip: bytes) -> Part | None:
    if len(ip) >= 20 and ip[0] >> 4 == 4 and ip[9] == 6:
        size = (ip[0] & 0xF) * 4
        # Segmentation offload leaves the total length 0.
        total = int.from_bytes(ip[2:4]) or len(ip)
        return _of_tcp(ip[size:total], ip[12:16], ip[16:20])
    if len(ip) >= 40 and ip[0] >> 4 == 6 and ip[6] == 6:
        total = int.from_bytes(ip[4:6]) or len(ip)
        return _of_tcp(ip[40 : 40 + total], ip[8:24], ip[24:40])
    return None


def _of_tcp(tcp: bytes, source: bytes, destination: bytes) -> Part | None:
    if len(tcp) < 20:
        return None
    source_port, destination_port, sequence, acknowledgement = struct.unpack_from(">HHII", tcp)
    flow = source, destination, source_port, destination_port
    payload = tcp[(tcp[12] >> 4) * 4 :]
    return Part(flow, sequence, acknowledgement if tcp[13] & ACK else None, payload)
