"""Reads MAC addresses and VLAN in the header of the link layer."""

# Ethernet begins with the receiver's and the sender's address. The cooked headers of Linux have the
# sender's only: type 113 at byte 6, type 276 at byte 12, each in a field of 8 bytes, with the
# address's length in front. VLAN tags follow as link_layer.py describes them; each begins behind
# its EtherType with 4 bits of priority and 12 bits of id. The id 0 only carries a priority.

from __future__ import annotations

from functools import lru_cache

from mbtool.core import LinkAddresses
from mbtool.packets.link_layer import HSR, TAGGED, VLAN

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
