"""Reads the pcapng container."""

# Layout (IETF draft-ietf-opsawg-pcapng): a file is a row of blocks,
#
#     type  total length  body              total length again
#     4     4             total length - 12  4
#
# A section header block starts a section and shows its byte order; the interfaces that later
# blocks name by number are counted within the section. Blocks that hold no packet and describe no
# interface (statistics, names, secrets, custom) are skipped, except the block and the option for
# local use that this program writes (line_packets.py): packets with this option stand for bytes of
# a serial line or a tap.
#
# Times are ticks since 1970 plus if_tsoffset in seconds. The interface's if_tsresol gives the
# length of a tick as a power of 10 or of 2; without if_tsresol a tick is a microsecond. A simple
# packet block has no time, so it gets the time of the packet before it. A time outside the range of
# 63 bits of nanoseconds becomes the nearest one inside.
#
# Limits: MAX_BLOCK bytes in a block, MAX_INTERFACES in a section, MAX_CAPTURED bytes in a packet.
# More is damage and raises InputError.

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from struct import Struct
from typing import BinaryIO

import msgspec

from mbtool.core import DamageError, InputError, Packet
from mbtool.core.moments import SECOND_NS
from mbtool.packets.line_packets import (
    LOCAL_BLOCK,
    LOCAL_OPTION,
    CaptureHead,
    LineReader,
)
from mbtool.packets.pcap import MAX_CAPTURED, cut_error

PCAPNG_MAGIC = bytes.fromhex("0a0d0d0a")
MAX_BLOCK = 16 * 1024 * 1024
MAX_INTERFACES = 4096

BLOCK_INTERFACE = 1
_OBSOLETE_PACKET = 2
_SIMPLE_PACKET = 3
BLOCK_ENHANCED = 6
_PACKET_BLOCKS = frozenset((_OBSOLETE_PACKET, _SIMPLE_PACKET, BLOCK_ENHANCED))

OPTION_NAME = 2
OPTION_RESOLUTION = 9
_OPTION_OFFSET = 14
_MICROSECONDS = b"\x06"

_MAX_NS = 2**63 - 1
_MAX_NAME = 64


class _Layout:
    """The struct formats of the fixed parts of blocks and options, in one byte order."""

    def __init__(self, order: str) -> None:
        self.order = order
        self.block = Struct(order + "II")  # type, total length
        self.pair = Struct(order + "HH")  # an option's code and length; a version
        self.interface = Struct(order + "HHI")  # link type, reserved, snaplen
        self.single = Struct(order + "I")  # original length
        # Fields: interface, drops (only in `obsolete`), time high, time low, captured length,
        # original length.
        self.enhanced = Struct(order + "IIIII")
        self.obsolete = Struct(order + "H2xIIII")
        self.offset = Struct(order + "q")


_LAYOUTS = {bytes.fromhex("4d3c2b1a"): _Layout("<"), bytes.fromhex("1a2b3c4d"): _Layout(">")}
"""The formats of a section's blocks, by the four bytes in its header that show its byte order."""


@dataclass(frozen=True, slots=True)
class PcapngInterface:
    """An interface, and how its times are read."""

    link: str
    link_type: int
    snaplen: int
    multiplier: int
    divisor: int
    offset_ns: int

    def time_ns(self, ticks: int) -> int:
        """Return a number of ticks since 1970 as UTC ns, in 63 bits."""
        ts_ns = ticks * self.multiplier // self.divisor + self.offset_ns
        return ts_ns if 0 <= ts_ns <= _MAX_NS else min(max(ts_ns, 0), _MAX_NS)


def read_pcapng(
    stream: BinaryIO, name: str, on_head: Callable[[CaptureHead], None] = lambda _: None
) -> Iterator[Packet]:
    """Yield the packets of a pcapng file whose first 4 bytes are read already.

    `on_head` is called with the description of serial lines and taps that `convert` writes, if the
    file has one. Raises InputError for an unknown version, DamageError if the file is damaged,
    CutError if it ends too early; the last two after all earlier packets.
    """
    return PcapngReader(stream, name, on_head).packets()


class PcapngReader:
    """Reads the blocks of a pcapng file."""

    def __init__(
        self, stream: BinaryIO, name: str, on_head: Callable[[CaptureHead], None] = lambda _: None
    ) -> None:
        self._stream = stream
        self._name = name
        self._on_head = on_head
        self._lines: LineReader | None = None
        """Restores the reads of a serial line or tap from packets. None as long as no CaptureHead
        has come, which `convert` writes before such packets."""
        self._last: Packet | None = None
        self._layout: _Layout
        """The formats in the current section's byte order; set by the section header that begins
        each file."""
        self.interfaces: list[PcapngInterface] = []
        """The interfaces of the current section, by their number in it."""
        self.number = 0
        """The number of packets so far."""
        self.ts_ns = 0
        """The time of the last packet, in UTC ns."""

    def packets(self) -> Iterator[Packet]:
        """Yield all packets. The first 4 bytes of the file are read already."""
        header = PCAPNG_MAGIC + self._stream.read(4)
        while header:
            packet = self.read_block(header)
            if packet is not None:
                yield packet
            header = self._stream.read(8)
        packet = self.incomplete_reads()
        if packet is not None:
            yield packet

    @property
    def order(self) -> str:
        """The byte order of the current section, as struct and numpy write it."""
        return self._layout.order

    @property
    def has_lines(self) -> bool:
        """True once a block has described serial lines or taps; packets may be their reads."""
        return self._lines is not None

    def read_block(self, header: bytes) -> Packet | None:
        """Read the block that begins with the 8 bytes `header`, which are read already.

        Returns None if the block has no packet. Raises the errors of read_pcapng.
        """
        if len(header) < 8:
            raise cut_error(self._name, self.number)
        if header.startswith(PCAPNG_MAGIC):
            self._begin_section(header)
            return None
        kind, length = self._layout.block.unpack(header)
        body = self._read_body(header, length, 8)
        if kind in _PACKET_BLOCKS:
            return self._read_packet(kind, body)
        if kind == BLOCK_INTERFACE:
            self._describe_interface(body)
        elif kind == LOCAL_BLOCK:
            self._read_head(body)
        return None

    def incomplete_reads(self) -> Packet | None:
        """At the end of the file, return the incomplete reads of lines and taps as a packet; None
        if there are none.
        """
        if self._lines is None or self._last is None:
            return None
        return self._lines.close(self._last)

    def _begin_section(self, header: bytes) -> None:
        byte_order = self._stream.read(4)
        if len(byte_order) < 4:
            raise cut_error(self._name, self.number)
        layout = _LAYOUTS.get(byte_order)
        if layout is None:
            raise self._damaged(f"a section's byte order is {byte_order.hex()}")
        body = self._read_body(header, layout.block.unpack(header)[1], 12)
        major, minor = self._unpack(layout.pair, body)
        if major != 1:
            raise InputError(
                f"{self._name}: pcapng version {major}.{minor} is unknown; 1.0 is read"
            )
        self._layout = layout
        self.interfaces = []

    def _read_body(self, header: bytes, length: int, done: int) -> bytes:
        """Return the body of a block without the second length at its end.

        `header` is the block's type and first length (4 bytes each), `length` the value of that
        length; `done` bytes of the block are read already. Raises DamageError if the length is
        impossible or the two lengths differ, CutError if the file ends inside the block.
        """
        if length < done + 4 or length % 4 or length > MAX_BLOCK:
            raise self._damaged(f"a block claims {length} bytes")
        body = self._stream.read(length - done)
        if len(body) < length - done:
            raise cut_error(self._name, self.number)
        if body[-4:] != header[4:]:
            raise self._damaged("the two lengths of a block differ")
        return body[:-4]

    def _read_packet(self, kind: int, body: bytes) -> Packet:
        layout = self._layout
        ticks: int | None = None
        if kind == _SIMPLE_PACKET:
            (original,) = self._unpack(layout.single, body)
            index, start = 0, 4
            snaplen = self.interfaces[0].snaplen if self.interfaces else 0
            captured = min(original, len(body) - start, snaplen or MAX_CAPTURED)
        else:
            structure = layout.enhanced if kind == BLOCK_ENHANCED else layout.obsolete
            index, high, low, captured, original = self._unpack(structure, body)
            ticks, start = high << 32 | low, 20
        if index >= len(self.interfaces):
            raise self._damaged(f"interface {index} is not described")
        if captured > min(len(body) - start, MAX_CAPTURED):
            raise self._damaged(f"the next packet claims {captured} bytes")
        interface = self.interfaces[index]
        if ticks is not None:
            self.ts_ns = interface.time_ns(ticks)
        self.number += 1
        packet = Packet(
            ts_ns=self.ts_ns,
            link=interface.link,
            link_type=interface.link_type,
            data=body[start : start + captured],
            original_length=original if original > captured else captured,
            file=self._name,
            number=self.number,
        )
        return packet if self._lines is None else self._as_line(packet, body, start, captured)

    def _as_line(self, packet: Packet, body: bytes, start: int, captured: int) -> Packet:
        """Return the packet as LinePacket if `convert` made it from reads, else unchanged.

        `body` is the packet's block; the packet's `captured` bytes begin at its offset `start`.
        """
        assert self._lines is not None
        self._last = packet
        options = _options(self._layout.pair, body[start + captured + -captured % 4 :])
        mark = options.get(LOCAL_OPTION)
        if mark is None:
            return packet
        return self._lines.read(packet, mark)

    def _read_head(self, body: bytes) -> None:
        """Read the block in which `convert` describes serial lines and taps.

        A block that another program wrote for local use, with other content, is ignored.
        """
        try:
            head = msgspec.json.decode(body.rstrip(b"\0"), type=CaptureHead)
        except (msgspec.DecodeError, ValueError, RecursionError):
            return  # ValueError: text that is no UTF-8.
        self._lines = self._lines or LineReader()
        self._on_head(head)

    def _describe_interface(self, body: bytes) -> None:
        if len(self.interfaces) == MAX_INTERFACES:
            raise self._damaged(f"more than {MAX_INTERFACES} interfaces in a section")
        link_type, _, snaplen = self._unpack(self._layout.interface, body)
        options = _options(self._layout.pair, body[8:])
        name = _link_name(options.get(OPTION_NAME, b""))
        resolution = (options.get(OPTION_RESOLUTION) or _MICROSECONDS)[0]
        unit = (2 if resolution & 0x80 else 10) ** (resolution & 0x7F)
        common = math.gcd(unit, SECOND_NS)
        offset = options.get(_OPTION_OFFSET, b"")
        offset_s = self._layout.offset.unpack(offset)[0] if len(offset) == 8 else 0
        self.interfaces.append(
            PcapngInterface(
                link=name or f"if{len(self.interfaces)}",
                link_type=link_type,
                snaplen=snaplen,
                multiplier=SECOND_NS // common,
                divisor=unit // common,
                offset_ns=offset_s * SECOND_NS,
            )
        )

    def _unpack(self, structure: Struct, body: bytes) -> tuple[int, ...]:
        if len(body) < structure.size:
            raise self._damaged("a block is too short for its type")
        return structure.unpack_from(body)

    def _damaged(self, problem: str) -> DamageError:
        return DamageError(f"{self._name}: damaged after packet {self.number}: {problem}")


def _options(header: Struct, data: bytes) -> dict[int, bytes]:
    """Return the contents of a block's options by option code.

    `data` has the options, `header` is the format of an option's code and length. If the list of
    options is cut off, only those before the cut are returned.
    """
    options: dict[int, bytes] = {}
    at = 0
    while at + 4 <= len(data):
        code, length = header.unpack_from(data, at)
        if code == 0:
            break
        options.setdefault(code, data[at + 4 : at + 4 + length])
        at += 4 + length + -length % 4
    return options


def _link_name(name: bytes) -> str:
    """Turn an interface's name into a link's name: at most 64 characters, printable, no slash."""
    text = name.decode("utf-8", "replace").rstrip("\0")[:_MAX_NAME]
    return "".join(c if c.isprintable() and c != "/" else "_" for c in text)
