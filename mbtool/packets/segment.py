"""Finds the TCP segment or the UDP datagram in an IPv4 or IPv6 packet."""

# Checksums are not verified, since network cards fill them in after the capture. A packet whose
# header has contradictory lengths is ignored. Bytes behind the end of the IP packet (Ethernet
# padding, a frame check sequence) do not belong to it. A total length of 0 marks a packet that the
# card will cut into several (segmentation offload); such a packet extends to the end of the
# captured frame.
#
# Limit: MAX_PAYLOAD bytes, more than any card hands over at once. A longer segment is malformed.
#
# The caller calls find_tcp, compares the ports, and only then calls read_segment, so that no time
# is spent on segments of other ports. The results are msgspec.Structs, which are faster to make
# than dataclasses; one is made for each packet.

from __future__ import annotations

import struct
from ipaddress import ip_address

import msgspec

from mbtool.core import Endpoint

FIN = 0x01
SYN = 0x02
RST = 0x04
ACK = 0x10

MAX_PAYLOAD = 1024 * 1024
_UDP_SIZE = 8

TCP = 6
UDP = 17
_IPV4 = struct.Struct(">BxH2xHxB")
_IPV6 = struct.Struct(">HB")
_UDP_HEADER = struct.Struct(">HHH")
_TCP_HEADER = struct.Struct(">HHIIBB")

# Extension headers that stand before TCP (RFC 8200, section 4; RFC 6275; RFC 7401; RFC 5533).
IPV6_EXTENSIONS = frozenset((0, 43, 60, 135, 139, 140))
IPV6_FRAGMENT = 44
IPV6_AUTHENTICATION = 51
BEFORE_TCP = IPV6_EXTENSIONS | {IPV6_FRAGMENT, IPV6_AUTHENTICATION}
"""The protocol numbers of all headers that may stand between an IPv6 header and TCP."""


class TcpPlace(msgspec.Struct, frozen=True, gc=False):
    """The offsets in a captured packet at which the TCP header begins and the TCP payload ends."""

    start: int
    end: int
    """The offset of the IP packet's end; more than the captured bytes if the snaplen cut the
    packet."""


class TcpSegment(msgspec.Struct, frozen=True, gc=False):
    """A TCP segment with its addresses (4 or 16 bytes), ports, numbers, flags and payload."""

    source: bytes
    source_port: int
    destination: bytes
    destination_port: int
    sequence: int
    acknowledgement: int
    flags: int
    payload: bytes
    missing: int
    """The number of bytes at the end of the payload that the capture did not keep."""


class UdpDatagram(msgspec.Struct, frozen=True, gc=False):
    """A UDP datagram with its addresses (4 or 16 bytes), ports and payload."""

    source: bytes
    source_port: int
    destination: bytes
    destination_port: int
    number: int
    """The identification field of the IPv4 header; 0 in IPv6."""
    payload: bytes
    missing: int
    """The number of bytes at the end of the payload that the capture did not keep."""


def find_tcp(data: bytes, at: int, original_length: int, protocol: int = TCP) -> TcpPlace | None:
    """Find TCP in the IP packet that begins at `at`; None if it holds no TCP, or is a fragment.

    With another `protocol` (UDP), find that one. `original_length` is the number of bytes that
    `data`, the captured packet, had on the wire.
    fragments.py reassembles packets that came in fragments.
    """
    if len(data) < at + 20:
        return None
    version = data[at] >> 4
    if version == 4:
        first, total, fragment, found = _IPV4.unpack_from(data, at)
        header = (first & 0x0F) * 4
        if found != protocol or header < 20 or fragment & 0x3FFF:
            return None
        end = at + total if total else original_length
        start = at + header
        return TcpPlace(start, end) if start <= end else None
    if version == 6 and len(data) >= at + 40:
        end, following, start = walk_ipv6(data, at, original_length)
        return TcpPlace(start, end) if following == protocol and start <= end else None
    return None


def walk_ipv6(data: bytes, at: int, original_length: int) -> tuple[int, int, int]:
    """Follow the extension headers of an IPv6 packet up to TCP, a fragment or another protocol.

    The packet begins at offset `at` of `data`, which had `original_length` bytes on the wire.
    Returns the offset of the packet's end, the number of the protocol at which the headers stop,
    and the offset at which that protocol begins.
    """
    length, following = _IPV6.unpack_from(data, at + 4)
    start = at + 40
    end = start + length if length else original_length
    seen = min(end, len(data))
    while following != TCP and start + 8 <= seen:
        if following in IPV6_EXTENSIONS:
            size = (data[start + 1] + 1) * 8
        elif following == IPV6_AUTHENTICATION:
            size = (data[start + 1] + 2) * 4
        elif following == IPV6_FRAGMENT and not (data[start + 2] or data[start + 3] & 0xF9):
            size = 8  # An atomic fragment: the packet is whole (RFC 6946).
        else:
            break
        following = data[start]
        start += size
    return end, following, start


def read_datagram(data: bytes, at: int, original_length: int) -> UdpDatagram | None:
    """Read the UDP datagram of the IP packet that begins at `at`; None if it holds none, or if the
    datagram is malformed.
    """
    place = find_tcp(data, at, original_length, UDP)
    if place is None or len(data) < place.start + _UDP_HEADER.size:
        return None
    source_port, destination_port, length = _UDP_HEADER.unpack_from(data, place.start)
    begin = place.start + _UDP_SIZE
    end = min(place.start + length, place.end, original_length)
    if length < _UDP_SIZE or end < begin:
        return None
    is_four = data[at] >> 4 == 4
    addresses = at + 12 if is_four else at + 8
    size = 4 if is_four else 16
    payload = data[begin:end]
    return UdpDatagram(
        data[addresses : addresses + size],
        source_port,
        data[addresses + size : addresses + 2 * size],
        destination_port,
        int.from_bytes(data[at + 4 : at + 6]) if is_four else 0,
        payload,
        end - begin - len(payload),
    )


def read_segment(data: bytes, at: int, place: TcpPlace, original_length: int) -> TcpSegment | None:
    """Read the TCP segment of the IP packet that begins at `at`; None if it is malformed.

    `original_length` is the number of bytes that `data`, the captured packet, had on the wire. The
    caller has checked that at least 14 bytes of the TCP header are there.
    """
    source_port, destination_port, sequence, acknowledgement, offset, flags = (
        _TCP_HEADER.unpack_from(data, place.start)
    )
    header = (offset >> 4) * 4
    begin = place.start + header
    # An IP header that claims more bytes than its frame has is wrong, so the frame's end counts.
    end = min(place.end, original_length)
    if header < 20 or not begin <= end <= begin + MAX_PAYLOAD:
        return None
    source, destination = (
        (data[at + 12 : at + 16], data[at + 16 : at + 20])
        if data[at] >> 4 == 4
        else (data[at + 8 : at + 24], data[at + 24 : at + 40])
    )
    payload = data[begin:end]
    return TcpSegment(
        source,
        source_port,
        destination,
        destination_port,
        sequence,
        acknowledgement,
        flags,
        payload,
        end - begin - len(payload),
    )


def endpoint(address: bytes, port: int) -> Endpoint:
    """The endpoint of an IPv4 or IPv6 address, given as the 4 or 16 bytes in a header."""
    return Endpoint(str(ip_address(address)), port)
