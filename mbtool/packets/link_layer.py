"""Finds the IP header behind a link layer's header."""

# Link types are the LINKTYPE_ values of tcpdump.org/linktypes.html; those not in IP_FINDERS cannot
# be looked into. A finder gives the offset of the IP header, or NOT_IP: for other protocols and
# for packets that are too short. VLAN tags (802.1Q, 802.1ad and the older 9100H) may be stacked.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

NOT_IP = -1

_IP = (b"\x08\x00", b"\x86\xdd")
_VLAN = (b"\x81\x00", b"\x88\xa8", b"\x91\x00")

# The address families of IP in the capturing machine's byte order: 2 is IPv4 everywhere; IPv6 is
# 10 on Linux, 23 on Windows, 24 on NetBSD and OpenBSD, 28 on FreeBSD, 30 on macOS.
_FAMILIES = frozenset(
    family.to_bytes(4, order) for family in (2, 10, 23, 24, 28, 30) for order in ("big", "little")
)


def _ethernet(data: bytes) -> int:
    if data[12:14] == b"\x08\x00":
        return 14
    return _behind_tags(data, 12)


def _behind_tags(data: bytes, at: int) -> int:
    """Look from an EtherType through VLAN tags to IP."""
    while (kind := data[at : at + 2]) in _VLAN:
        at += 4
    return at + 2 if kind in _IP else NOT_IP


def _cooked(data: bytes) -> int:
    return _behind_tags(data, 14)


def _cooked_v2(data: bytes) -> int:
    # The protocol opens the header; a VLAN tag, where it is kept, stands behind the header.
    kind = data[:2]
    if kind in _IP:
        return 20
    return _behind_tags(data, 22) if kind in _VLAN else NOT_IP


def _null(data: bytes) -> int:
    return 4 if data[:4] in _FAMILIES else NOT_IP


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
"""By link type: 0 is NULL, 1 Ethernet, 108 LOOP, 113 and 276 Linux cooked, the others raw IP."""
