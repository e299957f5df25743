"""Finds the IP header behind the header of the link layer."""

# Link types are the LINKTYPE_ values of tcpdump.org/linktypes.html. Only those in IP_FINDERS are
# read. A finder takes a packet and returns the offset of its IP header. It returns NOT_IP for other
# protocols and for packets that are too short. These headers may precede IP, also several: VLAN
# tags (802.1Q, 802.1ad and the older 9100H), the tag of HSR (IEC 62439-3: 6 bytes), PPPoE (RFC
# 2516: 6 bytes, then PPP's protocol) and MPLS labels (RFC 3032: 4 bytes each, the last one is
# marked).
#
# PPP begins with its protocol, or with FF 03 before it (RFC 1662), and may leave out the first byte
# of the protocol if that is 0. Cisco HDLC has an address, a control byte and an EtherType. An IEEE
# 802.11 frame with data has 24 bytes or more before LLC and SNAP, which end with an EtherType. A
# radiotap header (radiotap.org) with the settings of the radio may precede the 802.11 frame. Two
# kinds of 802.11 frames are not read: encrypted ones, and those that contain several packets
# (A-MSDU).

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from mbtool.core import LinkAddresses

NOT_IP = -1
_IEEE_802_11, _RADIOTAP = 105, 127

_IP = (b"\x08\x00", b"\x86\xdd")
VLAN = (b"\x81\x00", b"\x88\xa8", b"\x91\x00")
HSR = b"\x89\x2f"
TAGGED = (*VLAN, HSR)
_PPPOE = b"\x88\x64"
_IP_IN_PPP = (b"\x00\x21", b"\x00\x57")
_PPP_ADDRESS = b"\xff\x03"
_SHORT_IP_IN_PPP = (b"\x21", b"\x57")
_SNAP = b"\xaa\xaa\x03\x00\x00\x00"
_KIND_OF_FRAME, _DATA_FRAME = 0x4F, 0x08
"""The version, the type and the bit for "no data" in the first byte of an 802.11 frame (IEEE
802.11, 9.2.4.1), and their value in a frame with data."""
_HAS_QOS = 0x80
_FOUR_ADDRESSES, _ENCRYPTED, _HAS_HIGH_THROUGHPUT = 0x03, 0x40, 0x80
"""Bits of the second byte of an 802.11 frame."""
_HAS_CLOCK, _HAS_FLAGS, _PADDED = 0x01, 0x02, 0x20
"""Bits of radiotap: of the first byte of its bitmap of fields, and of the field of flags."""
_MPLS = (b"\x88\x47", b"\x88\x48")

# The address families of IP in the capturing machine's byte order: 2 is IPv4 everywhere; IPv6 is
# 10 on Linux, 23 on Windows, 24 on NetBSD and OpenBSD, 28 on FreeBSD, 30 on macOS.
FAMILIES = frozenset(
    family.to_bytes(4, order) for family in (2, 10, 23, 24, 28, 30) for order in ("big", "little")
)


def _ethernet(data: bytes) -> int:
    kind = data[12:14]
    return 14 if kind == b"\x08\x00" else _ip_header_offset(data, kind, 14)


def behind_ethernet(data: bytes, at: int) -> int:
    """Return the offset in `data` of the IP header in the Ethernet frame that begins at offset
    `at`.

    Returns NOT_IP if the frame holds no IP packet.
    """
    return _ip_header_offset(data, data[at + 12 : at + 14], at + 14)


def _ip_header_offset(data: bytes, kind: bytes, at: int) -> int:
    """Skip VLAN tags, HSR tags, PPPoE and MPLS; return the offset of the IP header, or NOT_IP.

    The first of these headers begins at `at` and has the EtherType `kind`.
    """
    while kind in TAGGED:  # A tag ends with the EtherType of what follows.
        at += 6 if kind == HSR else 4
        kind = data[at - 2 : at]
    if kind in _IP:
        return at
    if kind == _PPPOE and data[at + 6 : at + 8] in _IP_IN_PPP:
        return at + 8
    return _behind_labels(data, at) if kind in _MPLS else NOT_IP


def _behind_labels(data: bytes, at: int) -> int:
    """Return the offset of the IP header behind MPLS labels, which begin at `at`, or NOT_IP.

    MPLS does not name the protocol behind the labels. It counts as IP if its first half byte, IP's
    version, is 4 or 6.
    """
    while len(data) > at + 4:
        at += 4
        if data[at - 2] & 1:
            return at if data[at] >> 4 in (4, 6) else NOT_IP
    return NOT_IP


def _cooked(data: bytes) -> int:
    return _ip_header_offset(data, data[14:16], 16)


def _cooked_v2(data: bytes) -> int:
    return _ip_header_offset(data, data[:2], 20)  # The header begins with the protocol.


def _ppp(data: bytes) -> int:
    at = 2 if data[:2] == _PPP_ADDRESS else 0
    if data[at : at + 1] in _SHORT_IP_IN_PPP:
        return at + 1
    return at + 2 if data[at : at + 2] in _IP_IN_PPP else NOT_IP


def _cisco_hdlc(data: bytes) -> int:
    return _ip_header_offset(data, data[2:4], 4)


def _radiotap(data: bytes) -> int:
    """Return the offset of the IP header behind radiotap and an 802.11 frame's header."""
    at = 8
    while len(data) > at and data[at - 1] & 0x80:  # A further bitmap of fields follows.
        at += 4
    if data[4:5] and data[4] & _HAS_CLOCK:
        at = (at + 7) // 8 * 8 + 8
    is_padded = bool(data[4:5] and data[4] & _HAS_FLAGS and data[at : at + 1])
    is_padded = is_padded and bool(data[at] & _PADDED)
    size = int.from_bytes(data[2:4], "little")
    return _wireless(data, size, is_padded=is_padded) if size >= 8 else NOT_IP


def _wireless(data: bytes, start: int = 0, *, is_padded: bool = False) -> int:
    """Return the offset of the IP header behind the header of an 802.11 frame.

    The frame begins at the offset `start`. `is_padded` is True if its header is filled up to a
    multiple of 4 bytes.
    """
    if len(data) < start + 2 or data[start] & _KIND_OF_FRAME != _DATA_FRAME:
        return NOT_IP
    control, flags = data[start], data[start + 1]
    if flags & _ENCRYPTED:
        return NOT_IP
    size = 24 + (6 if flags & _FOUR_ADDRESSES == _FOUR_ADDRESSES else 0)
    if control & _HAS_QOS:
        if data[start + size : start + size + 1] >= b"\x80":
            return NOT_IP  # Several packets in one frame.
        size += 2 + (4 if flags & _HAS_HIGH_THROUGHPUT else 0)
    if is_padded:
        size = (size + 3) // 4 * 4
    at = start + size
    if data[at : at + 6] != _SNAP:
        return NOT_IP
    return _ip_header_offset(data, data[at + 6 : at + 8], at + 8)


def wireless_macs(link_type: int, data: bytes) -> tuple[int, ...]:
    """Return the offsets of the MAC addresses of an 802.11 frame that holds an IP packet."""
    if link_type not in (_IEEE_802_11, _RADIOTAP):
        return ()
    start = int.from_bytes(data[2:4], "little") if link_type == _RADIOTAP else 0
    macs = (start + 4, start + 10, start + 16)
    is_relayed = data[start + 1] & _FOUR_ADDRESSES == _FOUR_ADDRESSES
    return (*macs, start + 24) if is_relayed else macs


def _behind_null(data: bytes) -> int:
    return 4 if data[:4] in FAMILIES else NOT_IP


def _raw(data: bytes) -> int:
    return 0


IP_FINDERS: dict[int, Callable[[bytes], int]] = {
    0: _behind_null,
    1: _ethernet,
    9: _ppp,
    12: _raw,
    14: _raw,
    50: _ppp,
    101: _raw,
    104: _cisco_hdlc,
    _IEEE_802_11: _wireless,
    108: _behind_null,
    113: _cooked,
    _RADIOTAP: _radiotap,
    228: _raw,
    229: _raw,
    276: _cooked_v2,
}
"""For each link type that is read, the function that finds the IP header: 0 is NULL, 1 Ethernet,
9 and 50 PPP, 104 Cisco HDLC, 105 IEEE 802.11 and 127 the same behind radiotap, 108 LOOP, 113 and
276 Linux cooked, the others raw IP."""


# The code below reads MAC addresses and VLAN ids in the header of the link layer.
#
# Ethernet begins with the receiver's and the sender's address. The cooked headers of Linux have the
# sender's only: type 113 at byte 6, type 276 at byte 12, each in a field of 8 bytes, with the
# address's length in front. VLAN tags follow as the module's head describes them; each begins
# behind its EtherType with 4 bits of priority and 12 bits of id. The id 0 only carries a priority.

MAX_CACHED_HEADERS = 4096
"""The results for this many headers are cached; then the least recently used one is dropped."""

_MAC = 6
_ETHERNET, _COOKED, _COOKED_V2 = 1, 113, 276


@lru_cache(maxsize=MAX_CACHED_HEADERS)
def link_addresses(link_type: int, header: bytes) -> LinkAddresses | None:
    """Return the MAC addresses and the VLAN in a link-layer header; None if it has no addresses.

    `header` are all bytes before the packet's IP header; `link_type` is a LINKTYPE_ value. The
    results are cached, as all packets of a connection have one of the same two headers.
    """
    if link_type == _ETHERNET and len(header) >= 14:
        return LinkAddresses(_text(header, 6), _text(header, 0), _vlan(header, 12))
    if link_type == _COOKED and len(header) >= 16 and header[4:6] == b"\0\6":
        return LinkAddresses(_text(header, 6), None, _vlan(header, 14))
    if link_type == _COOKED_V2 and len(header) >= 20 and header[11] == _MAC:
        return LinkAddresses(_text(header, 12), None, _vlan(header[:2] + header[20:], 0))
    return None


def _text(header: bytes, at: int) -> str | None:
    """The MAC address at an offset; None if it is all zeros, as on the loopback interface."""
    address = header[at : at + _MAC]
    return address.hex(":") if any(address) else None


def _vlan(header: bytes, at: int) -> int | None:
    """The id of the innermost VLAN tag; None without a tag, or if the id is 0.

    `at` is the offset of the first EtherType in `header`.
    """
    vlan = 0
    while (kind := header[at : at + 2]) in TAGGED:
        if kind in VLAN:
            vlan = int.from_bytes(header[at + 2 : at + 4], "big") & 0x0FFF
        at += 6 if kind == HSR else 4
    return vlan or None
