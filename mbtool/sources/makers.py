"""Finds the maker of a network card by its MAC address."""

# Source: Wireshark's list, which is part of scapy since version 2.6. A line is a prefix of MAC
# addresses, a short name and the maker's name, with tabs between them. A prefix has 24 bits unless
# the line says 28 or 36:
#
#     00:00:2F          <tab> Timeplex <tab> Timeplex Inc.
#     00:55:DA:00/28    <tab> ...
#     00:1B:C5:00:10/36 <tab> ...
#
# The list is searched as text, since a capture has few makers. It is loaded for the first search
# and takes 6 MB; the results of the last MAX_KNOWN searches are kept.

from __future__ import annotations

import re
from functools import cache, lru_cache

MAX_KNOWN = 4096
LOCAL = "locally administered"
"""The text for an address that was not assigned by a maker: bit 02H of the first byte is set."""
_MAC = re.compile(r"(?:[0-9A-F]{2}:){5}[0-9A-F]{2}")
_NOBODY = "00:00:00:00:00:00"
"""The MAC address of a loopback interface: it has no maker."""
_LOCAL_BIT, _GROUP_BIT = 0x02, 0x01


def maker(mac: str) -> str | None:
    """The maker of a network card by its MAC address, such as 00:80:f4:01:02:03.

    Returns None if unknown.
    """
    mac = mac.upper()
    if not _MAC.fullmatch(mac) or mac == _NOBODY or int(mac[:2], 16) & _GROUP_BIT:
        return None
    if int(mac[:2], 16) & _LOCAL_BIT:
        return LOCAL
    return _maker_of(mac[:13])


@lru_cache(maxsize=MAX_KNOWN)
def _maker_of(block: str) -> str | None:
    """Return the maker for `block`, the first 36 bits of a MAC address, written AA:BB:CC:DD:E.

    Returns None if unknown.
    """
    text = _list()
    for prefix in (f"{block}0/36", f"{block[:10]}0/28", f"{block[:8]} ", f"{block[:8]}\t"):
        at = text.find(f"\n{prefix}")
        if at >= 0:
            name = text[at + 1 : text.find("\n", at + 1)].split("\t")[-1].strip()
            return name or None
    return None


@cache
def _list() -> str:
    try:
        from scapy.libs.manuf import DATA
    except ImportError:  # scapy before 2.6 has no list.
        return ""
    return f"\n{DATA}\n"
