"""Finds the IP header behind the header of the link layer."""

# Link types are the LINKTYPE_ values of tcpdump.org/linktypes.html. Only those in IP_FINDERS are
# read. A finder takes a packet and returns the offset of its IP header. It returns NOT_IP for other
# protocols and for packets that are too short. These headers may precede IP, also several: VLAN
# tags (802.1Q, 802.1ad and the older 9100H), the tag of HSR (IEC 62439-3: 6 bytes), PPPoE (RFC
# 2516: 6 bytes, then PPP's protocol) and MPLS labels (RFC 3032: 4 bytes each, the last one is
# marked).

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

NOT_IP = -1

_IP = (b"\x08\x00", b"\x86\xdd")
VLAN = (b"\x81\x00", b"\x88\xa8", b"\x91\x00")
HSR = b"\x89\x2f"
TAGGED = (*VLAN, HSR)
_PPPOE = b"\x88\x64"
_IP_IN_PPP = (b"\x00\x21", b"\x00\x57")
_MPLS = (b"\x88\x47", b"\x88\x48")

# The address families of IP in the capturing machine's byte order: 2 is IPv4 everywhere; IPv6 is
# 10 on Linux, 23 on Windows, 24 on NetBSD and OpenBSD, 28 on FreeBSD, 30 on macOS.
FAMILIES = frozenset(
    family.to_bytes(4, order) for family in (2, 10, 23, 24, 28, 30) for order in ("big", "little")
)


def _ethernet(data: bytes) -> int:
    kind = data[12:14]
    return 14 if kind == b"\x08\x00" else _behind(data, kind, 14)


def behind_ethernet(data: bytes, at: int) -> int:
    """Return the offset in `data` of the IP header in the Ethernet frame that begins at offset
    `at`.

    Returns NOT_IP if the frame holds no IP packet.
    """
    return _behind(data, data[at + 12 : at + 14], at + 14)


def _behind(data: bytes, kind: bytes, at: int) -> int:
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
    return _behind(data, data[14:16], 16)


def _cooked_v2(data: bytes) -> int:
    return _behind(data, data[:2], 20)  # The header begins with the protocol.


def _null(data: bytes) -> int:
    return 4 if data[:4] in FAMILIES else NOT_IP


def _raw(data: bytes) -> int:
    return 0


IP_FINDERS: dict[int, Callable[[bytes], int]] = {
    0: _null,
    1: _ethernet,
    12: _raw,
    14: _raw,
    101: _raw,
    108: _null,
    113: _cooked,
    228: _raw,
    229: _raw,
    276: _cooked_v2,
}
"""For each link type that is read, the function that finds the IP header: 0 is NULL, 1 Ethernet,
108 LOOP, 113 and 276 Linux cooked, the others raw IP."""
