"""Writes pcap and pcapng. Opens no file."""

# Both formats are written in little-endian order, with times in ns; pcap.py and pcapng.py show the
# layouts. In pcapng an interface is described before its first packet; each pair of a link and a
# link type is one interface. If the file holds links of mbtool (serial lines, taps), the block that
# describes them comes right after the section header, so that a reader learns this from the first
# bytes of the file.
#
# Memory: the names of the interfaces only; packets are written at once.

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import BinaryIO, NamedTuple

from mbtool.core import Packet
from mbtool.core.moments import SECOND_NS
from mbtool.packets.pcap import MAX_CAPTURED
from mbtool.packets.pcapng import (
    BLOCK_ENHANCED,
    BLOCK_INTERFACE,
    MAX_INTERFACES,
    OPTION_NAME,
    OPTION_RESOLUTION,
)

OPTION_COMMENT = 1
OPTION_DESCRIPTION = 3
OPTION_SPEED = 8
OPTION_FLAGS = 2
SENT, RECEIVED = 2, 1
"""The values of the direction in the flags of a pcapng packet: outbound and inbound."""
CRC_ERROR = 1 << 24
"""The bit of a packet's flags for a wrong CRC."""

_SECTION = struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
_NAMES_BLOCK = 4
_IPV4_NAME = 1
_NANOSECONDS = b"\x09"
_MAX_COMMENT = 4000


class InterfaceSettings(NamedTuple):
    """Properties of an interface in a pcapng file, in addition to its name and link type."""

    description: str = ""
    speed: int = 0
    """The speed in bits per second; 0 if unknown."""


class PcapWriter:
    """Writes packets of one link type as classic pcap."""

    def __init__(self, stream: BinaryIO, link_type: int) -> None:
        self._stream = stream
        magic = 0xA1B23C4D  # Times in ns.
        stream.write(struct.pack("<IHHiIII", magic, 2, 4, 0, 0, MAX_CAPTURED, link_type))

    def write(self, packet: Packet) -> None:
        seconds, ns = divmod(packet.ts_ns, SECOND_NS)
        sizes = len(packet.data), packet.original_length
        self._stream.write(struct.pack("<IIII", seconds & 0xFFFFFFFF, ns, *sizes) + packet.data)


class PcapngWriter:
    """Writes packets of any interfaces as pcapng."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._interfaces: dict[tuple[str, int], int] = {}
        stream.write(_SECTION)

    def write_block(self, kind: int, body: bytes) -> None:
        """Write a block with the block type `kind`; its body is padded to a multiple of 4 bytes."""
        body += bytes(-len(body) % 4)
        size = struct.pack("<I", len(body) + 12)
        self._stream.write(struct.pack("<I", kind) + size + body + size)

    def write_names(self, names: Mapping[bytes, str]) -> None:
        """Write the host names that Wireshark shows in place of IPv4 addresses.

        The keys of `names` are the addresses, 4 bytes each.
        """
        records = b"".join(
            _option(_IPV4_NAME, address + name.encode() + b"\0") for address, name in names.items()
        )
        if records:
            self.write_block(_NAMES_BLOCK, records + bytes(4))

    @property
    def has_room(self) -> bool:
        """True if another interface may be added.

        The file has at most MAX_INTERFACES, as mbtool's reader accepts no more.
        """
        return len(self._interfaces) < MAX_INTERFACES

    def knows(self, link: str, link_type: int) -> bool:
        """True if the interface for this link and link type is already described in the file."""
        return (link, link_type) in self._interfaces

    def add_interface(
        self, link: str, link_type: int, settings: InterfaceSettings | None = None
    ) -> None:
        """Write the description of the interface for a link and a link type.

        `write` does this before the interface's first packet, if it was not done before.
        `settings` of None means no description text and an unknown speed.
        """
        settings = settings or InterfaceSettings()
        options = _option(OPTION_NAME, link.encode(errors="replace"))
        if settings.description:
            options += _option(OPTION_DESCRIPTION, settings.description.encode(errors="replace"))
        if settings.speed:
            options += _option(OPTION_SPEED, struct.pack("<Q", settings.speed))
        options += _option(OPTION_RESOLUTION, _NANOSECONDS) + bytes(4)
        self.write_block(BLOCK_INTERFACE, struct.pack("<HHI", link_type, 0, 0) + options)
        self._interfaces[link, link_type] = len(self._interfaces)

    def write(
        self,
        packet: Packet,
        *,
        comments: Sequence[str] = (),
        flags: int = 0,
        local: Mapping[int, bytes] | None = None,
    ) -> None:
        """Write a packet, and before it the description of its interface if that is still missing.

        Wireshark shows the `comments`. `flags` has the bits SENT, RECEIVED and CRC_ERROR; 0 means
        none. `local` has options for local use, which other programs skip: the content by the
        option's code.
        """
        if not self.knows(packet.link, packet.link_type):
            self.add_interface(packet.link, packet.link_type)
        index = self._interfaces[packet.link, packet.link_type]
        high, low = divmod(max(packet.ts_ns, 0), 1 << 32)
        data = packet.data
        sizes = len(data), packet.original_length
        options = b"".join(
            _option(OPTION_COMMENT, text.encode(errors="replace")[:_MAX_COMMENT])
            for text in comments
        )
        if flags:
            options += _option(OPTION_FLAGS, struct.pack("<I", flags))
        for code, value in (local or {}).items():
            options += _option(code, value)
        body = struct.pack("<IIIII", index, high, low, *sizes) + data + bytes(-len(data) % 4)
        self.write_block(BLOCK_ENHANCED, body + options + (bytes(4) if options else b""))


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)
