"""Finds an IP packet inside another one: traffic that switches mirror, and other tunnels."""

# A switch that mirrors traffic to a distant monitoring port sends it inside IP packets:
#
#     GRE (protocol 47; RFC 2784, RFC 2890): flags and version, protocol, then 4 bytes each for a
#     checksum, a key and a sequence number where their flags are set. Then follows, by protocol:
#         88BEH   ERSPAN type II if GRE has a sequence number: a header of 8 bytes, then an Ethernet
#                 frame; else ERSPAN type I: an Ethernet frame at once
#         22EBH   ERSPAN type III: 12 bytes, 8 more where its last bit says so; then an Ethernet
#                 frame, or an IP packet (draft-foschiano-erspan-03)
#         6558H   an Ethernet frame
#         0800H, 86DDH   an IP packet
#     VXLAN (UDP port 4789; RFC 7348): 8 bytes, then an Ethernet frame
#     IPv4 or IPv6 at once (protocols 4 and 41; RFC 2003, RFC 4213)
#
# An outer packet in fragments is not reassembled; if it carries GRE, the caller reports it.
# A tunnel may contain a tunnel, so the caller limits how often it calls find_inner.

from __future__ import annotations

import struct
from collections.abc import Callable

from mbtool.packets.link_layer import NOT_IP, behind_ethernet
from mbtool.packets.segment import walk_ipv6

GRE_IN_FRAGMENTS = -2
"""The result of find_inner, instead of an offset, for a fragment that carries GRE."""
MAX_TUNNELS = 4
"""If tunnels are nested, at most this many of them are followed."""

VXLAN_PORT = 4789
_VXLAN_FLAG = 0x08

GRE = 47
ERSPAN = (0x88BE, 0x22EB)
"""The values of GRE's protocol field for ERSPAN: types I and II, then type III."""
_ETHERNET, _IP = 0x6558, (0x0800, 0x86DD)
_CHECKSUM, _KEY, _SEQUENCE = 0x8000, 0x2000, 0x1000
_UNREADABLE = 0x4007
"""A GRE header with any of these flags is not read: routing, or a version other than 0."""

_IPV4_HEADER = struct.Struct(">B5xHxB")


def find_inner(data: bytes, at: int, original_length: int) -> int:
    """Return the offset of the IP packet inside the outer IP packet, which begins at `at`.

    Returns NOT_IP if there is no inner packet, GRE_IN_FRAGMENTS if the outer packet is a fragment
    that carries GRE. `original_length` is the number of bytes that `data`, the captured packet, had
    on the wire; so `at` and the result may lie behind the end of `data`.
    """
    if len(data) < at + 20:
        return NOT_IP
    version = data[at] >> 4
    if version == 4:
        first, fragment, protocol = _IPV4_HEADER.unpack_from(data, at)
        if fragment & 0x3FFF:
            return GRE_IN_FRAGMENTS if protocol == GRE else NOT_IP
        header = (first & 0x0F) * 4
        if header < 20:
            return NOT_IP
        start = at + header
    elif version == 6 and len(data) >= at + 40:
        _, protocol, start = walk_ipv6(data, at, original_length)
    else:
        return NOT_IP
    finder = _FINDERS.get(protocol)
    return NOT_IP if finder is None else finder(data, start)


def _behind_gre(data: bytes, at: int) -> int:
    if len(data) < at + 4:
        return NOT_IP
    flags, protocol = struct.unpack_from(">HH", data, at)
    if flags & _UNREADABLE:
        return NOT_IP
    start = at + 4 + 4 * sum(bool(flags & one) for one in (_CHECKSUM, _KEY, _SEQUENCE))
    if protocol in _IP:
        return start
    if protocol == _ETHERNET:
        return behind_ethernet(data, start)
    if protocol == ERSPAN[0]:
        return behind_ethernet(data, start + (8 if flags & _SEQUENCE else 0))
    if protocol == ERSPAN[1] and len(data) >= start + 12:
        frame_type = data[start + 10] >> 2 & 0x1F
        inner = start + (20 if data[start + 11] & 1 else 12)
        return {0: behind_ethernet(data, inner), 2: inner}.get(frame_type, NOT_IP)
    return NOT_IP


def _behind_vxlan(data: bytes, at: int) -> int:
    if int.from_bytes(data[at + 2 : at + 4]) != VXLAN_PORT:
        return NOT_IP
    inner = behind_ethernet(data, at + 16)
    return inner if inner != NOT_IP and data[at + 8] & _VXLAN_FLAG else NOT_IP


_FINDERS: dict[int, Callable[[bytes, int], int]] = {
    4: lambda _, at: at,
    17: _behind_vxlan,
    41: lambda _, at: at,
    GRE: _behind_gre,
}
"""For each IP protocol that can be a tunnel (IPv4, UDP for VXLAN, IPv6, GRE), the function that
returns the offset of the inner IP packet."""
