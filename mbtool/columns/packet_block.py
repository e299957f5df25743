"""Reads capture files in blocks of many packets, as arrays. Opens no file."""

# A block holds at most BLOCK_PACKETS packets and about BLOCK_BYTES bytes of the file, so memory
# does not grow with the file. In a pcap file, each record tells where the next one begins: one loop
# in Python collects these offsets, then numpy reads all record headers at once. The enhanced packet
# blocks of a pcapng file are read in the same way. packets/pcapng.py reads the first
# SINGLY_READ_BLOCKS blocks of a pcapng file one by one, and as many from every other part on (an
# interface, another kind of packet block, damage). Otherwise a file with many such parts would
# become many small PacketBlocks.
#
# Errors are raised as in packets/: after all packets before the damage.

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import numpy.typing as npt

from mbtool.columns.arrays import Int64s, Octets, gather
from mbtool.core import DamageError, InputError, Packet
from mbtool.core.moments import SECOND_NS
from mbtool.packets.capture import read_capture
from mbtool.packets.pcap import (
    MAX_CAPTURED,
    PCAP_HEADER,
    PCAP_MAGICS,
    SEARCHED,
    PcapForm,
    cut_error,
    next_record,
    read_pcap_form,
    too_long_error,
    zeros_error,
)
from mbtool.packets.pcapng import BLOCK_ENHANCED, MAX_BLOCK, PCAPNG_MAGIC, PcapngReader

if TYPE_CHECKING:
    from mbtool.packets.pcapng import PcapngInterface

BLOCK_PACKETS = 65_536
"""The most packets of a block."""
BLOCK_BYTES = 8 * 1024 * 1024
"""The number of bytes of the file in which the records of one block are searched. A record is never
longer, so a block has at least one."""
LEAST_READ = 1024 * 1024
"""Each read of the file asks for at least this many bytes; few large reads are faster."""

SPARE = 64
"""This many bytes follow the last packet in a block's data. So a header of fixed size can be read
at the start of each packet without a check of the packet's length; whoever reads it must ignore the
bytes behind the packet's end."""

SINGLY_READ_BLOCKS = 1024
"""The number of pcapng blocks that are read one by one, without arrays, at the beginning of a file
and from each block on that is damaged or is no enhanced packet block."""

_MAGIC = 4
_BLOCK_HEAD = 8
"""The number of bytes of a pcapng block's type and length."""
_ENHANCED = 32
"""The number of bytes of an enhanced packet block around its packet and options, with the length at
its end."""
_MASK_64 = (1 << 64) - 1


@dataclass(slots=True)
class PacketBlock:
    """Consecutive packets of a capture file. Each array has one element per packet."""

    data: Octets
    """The bytes of all packets. Other bytes of the file, such as record headers, may lie between
    them; SPARE bytes follow the last one."""
    starts: Int64s
    """The offset in `data` at which each packet begins."""
    captured: Int64s
    """The number of bytes of each packet in the file."""
    original: Int64s
    """The number of bytes that each packet had on the wire."""
    ts_ns: Int64s
    """The time of each packet's capture, in UTC ns."""
    file: str
    """The capture file, as the user named it."""
    first_number: int
    """The number of the first packet in its file, counted from 1."""
    links: list[tuple[str, int]]
    """The names and link types of the interfaces that captured the packets."""
    interfaces: Int64s | None = None
    """The index of each packet's interface in `links`; None if all have the first one."""

    def __len__(self) -> int:
        return len(self.starts)

    def first_of_each_interface(self) -> list[int]:
        """Return, for each interface that captured a packet of the block, the index of its first
        packet.
        """
        if self.interfaces is None:
            return [0]
        _, firsts = np.unique(self.interfaces, return_index=True)
        places: list[int] = firsts.tolist()
        return places

    def part(self, begin: int, end: int) -> PacketBlock:
        """Return the packets with the indices `begin` to `end` (exclusive) as a block with the same
        data.
        """
        some = slice(begin, end)
        return PacketBlock(
            data=self.data,
            starts=self.starts[some],
            captured=self.captured[some],
            original=self.original[some],
            ts_ns=self.ts_ns[some],
            file=self.file,
            first_number=self.first_number + begin,
            links=self.links,
            interfaces=None if self.interfaces is None else self.interfaces[some],
        )

    def packet(self, index: int) -> Packet:
        """Return the packet with this index in the block, equal to the packet that read_capture
        gives.
        """
        start, captured = int(self.starts[index]), int(self.captured[index])
        link, link_type = self.links[0 if self.interfaces is None else self.interfaces[index]]
        return Packet(
            ts_ns=int(self.ts_ns[index]),
            link=link,
            link_type=link_type,
            data=self.data[start : start + captured].tobytes(),
            original_length=int(self.original[index]),
            file=self.file,
            number=self.first_number + index,
        )


def read_blocks(stream: BinaryIO, name: str) -> Iterator[PacketBlock]:
    """Yield the packets of a pcap or pcapng file in order, in blocks. `name` is the name of the
    file.

    Raises InputError if the file is of another kind or damaged, CutError if it ends within a
    record; all packets before the damage are yielded first.
    """
    source = _Source(stream)
    magic = source.peek(_MAGIC)
    if magic in PCAP_MAGICS:
        form = read_pcap_form(magic, source.take(PCAP_HEADER)[_MAGIC:], name)
        return _PcapBlocks(source, form, name).blocks()
    if magic == PCAPNG_MAGIC:
        return _PcapngBlocks(source, name).blocks()
    return _pack_blocks(read_capture(source, name))  # type: ignore[arg-type]


class _Source:
    """Reads a file in large pieces and gives them to callers in small ones.

    If reading the file fails, the error is raised only after callers took all bytes before it.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._held = b""
        self._at = 0
        """The number of bytes of `_held` that callers have already taken. These bytes stay in
        `_held` until the next read of the file, because cutting them off would copy all bytes
        behind them."""
        self._error: Exception | None = None
        self._is_ended = False

    def peek(self, size: int) -> bytes:
        """Return the next `size` bytes without taking them.

        The result is shorter at the end of the file and before a read error.
        """
        self._fill(size)
        return self._held[self._at : self._at + size]

    def held(self, size: int) -> tuple[bytes, int, int]:
        """Return the buffer, and the offsets in it at which the next `size` bytes begin and end.

        There are fewer bytes at the end of the file and before a read error. The bytes are not
        copied, and count as not yet taken.
        """
        self._fill(size)
        return self._held, self._at, min(self._at + size, len(self._held))

    def _fill(self, size: int) -> None:
        missing = size - (len(self._held) - self._at)
        if missing > 0:
            pieces = [self._held[self._at :]]
            while missing > 0 and self._error is None and not self._is_ended:
                piece = self._read(max(missing, LEAST_READ))
                pieces.append(piece)
                missing -= len(piece)
            self._held, self._at = b"".join(pieces), 0

    def take(self, size: int) -> bytes:
        """Take and return the next `size` bytes; fewer at the end of the file.

        If there are fewer because of a read error, the error is raised here.
        """
        taken = self.peek(size)
        if len(taken) < size and self._error is not None:
            raise self._error
        self._at += len(taken)
        return taken

    read = take

    def drop(self, size: int) -> None:
        """Take the next `size` bytes without returning them. `peek` or `held` must have shown
        them.
        """
        self._at += size

    def raise_error(self) -> None:
        """Raise the error that reading the file ended with, if there was one."""
        if self._error is not None:
            raise self._error

    def _read(self, size: int) -> bytes:
        try:
            piece = self._stream.read1(size)  # type: ignore[attr-defined]
        except (InputError, OSError) as error:
            self._error = error
            return b""
        self._is_ended = not piece
        return bytes(piece)


class _PcapBlocks:
    """Reads the records of a pcap file as blocks of packets."""

    def __init__(self, source: _Source, form: PcapForm, name: str) -> None:
        self._source = source
        self._form = form
        self._name = name
        self._header = 16 + form.extra
        self._record = np.dtype([(each, form.order + "u4") for each in ("s", "f", "cap", "len")])
        self._number = 0
        """The number of packets in the blocks that were yielded so far."""
        self._last_s: int | None = None
        """The time (UTC s) of the last packet of the last block; None before the first block."""

    def blocks(self) -> Iterator[PacketBlock]:
        damage: DamageError | None = None
        while True:
            data, begin, end = self._source.held(BLOCK_BYTES)
            if begin == end:
                break
            heads, at, too_long = self._walk(data, begin, end)
            if heads:
                self._source.drop(at - begin)
                block = self._block(_octets(data, begin, at), heads)
                yield block
                self._number += len(heads)
                self._last_s = int(block.ts_ns[-1]) // SECOND_NS
            elif too_long:
                passed = next_record(self._source.peek(SEARCHED), self._form, self._last_s)
                error = too_long_error(self._name, self._number, too_long, passed)
                damage = damage or error
                if passed is None:
                    raise damage
                self._source.drop(passed)
            elif damage is not None:
                raise damage
            else:
                if self._has_zeros(data, begin):
                    raise zeros_error(self._name, self._number)
                self._source.raise_error()
                raise cut_error(self._name, self._number)
        if damage is not None:
            raise damage
        self._source.raise_error()

    def _walk(self, data: bytes, begin: int, end: int) -> tuple[list[int], int, int]:
        """Find the complete records in `data` between the offsets `begin` and `end`.

        Returns the offset of each record, counted from `begin`; the offset in `data` behind the
        last record; and, if the next record claims more than MAX_CAPTURED bytes, that impossible
        length, else 0.
        """
        length_of = struct.Struct(self._form.order + "I").unpack_from
        header = self._header
        places: list[int] = []
        append = places.append
        at = begin
        for _ in range(BLOCK_PACKETS):
            behind = at + header
            if behind > end:
                break
            (captured,) = length_of(data, at + 8)
            if captured > MAX_CAPTURED:
                return places, at, captured
            behind += captured
            if behind > end or (not captured and self._has_zeros(data, at)):
                break
            append(at - begin)
            at = behind
        return places, at, 0

    def _has_zeros(self, data: bytes, at: int) -> bool:
        """True if the first 16 bytes of the record header at offset `at` are zeros.

        Such zeros show that the file was not written to its end.
        """
        return data.startswith(bytes(16), at)

    def _block(self, octets: Octets, heads: list[int]) -> PacketBlock:
        places = np.array(heads, np.int64)
        records = gather(octets, places, self._record)
        captured = records["cap"].astype(np.int64)
        seconds, fraction = records["s"].astype(np.int64), records["f"].astype(np.int64)
        return PacketBlock(
            data=octets,
            starts=places + self._header,
            captured=captured,
            original=np.maximum(records["len"].astype(np.int64), captured),
            ts_ns=seconds * SECOND_NS + fraction * self._form.unit_ns,
            file=self._name,
            first_number=self._number + 1,
            links=[("if0", self._form.link_type)],
        )


class _PcapngBlocks:
    """Reads the blocks of a pcapng file as blocks of packets."""

    def __init__(self, source: _Source, name: str) -> None:
        self._source = source
        self._name = name
        self._reader = PcapngReader(source, name)  # type: ignore[arg-type]

    def blocks(self) -> Iterator[PacketBlock]:
        source, reader = self._source, self._reader
        while source.peek(_BLOCK_HEAD):
            yield from _pack_blocks(self._singly_read_packets())
            while not reader.has_lines:
                block, is_full = self._enhanced_packets()
                if block is None:
                    break
                yield block
                if not is_full:
                    break
        source.raise_error()
        rest = reader.incomplete_reads()
        if rest is not None:
            yield _block_of([rest])

    def _singly_read_packets(self) -> Iterator[Packet]:
        """Yield the packets among the next SINGLY_READ_BLOCKS blocks of the file."""
        for _ in range(SINGLY_READ_BLOCKS):
            if not self._source.peek(_BLOCK_HEAD):
                break
            packet = self._reader.read_block(self._source.take(_BLOCK_HEAD))
            if packet is not None:
                yield packet

    def _enhanced_packets(self) -> tuple[PacketBlock | None, bool]:
        """Read the enhanced packet blocks up to the next block of another kind, or one that is
        damaged.

        Returns the packets, None if there are none; and True if further ones may follow directly.
        """
        data, begin, end = self._source.held(BLOCK_BYTES)
        heads, at, is_full = self._walk(data, begin, end)
        if not heads:
            return None, False
        octets = _octets(data, begin, at)
        places = np.array(heads, np.int64)
        found = gather(octets, places, self._record)
        captured = found["captured"].astype(np.int64)
        length = found["length"].astype(np.int64)
        last = gather(octets, places + length - 4, np.dtype(self._reader.order + "u4"))
        is_sound = (
            (length % 4 == 0)
            & (last == found["length"])
            & (captured <= np.minimum(length - _ENHANCED, MAX_CAPTURED))
            & (found["interface"] < len(self._reader.interfaces))
        )
        if not is_sound.all():
            count = int(np.argmin(is_sound))
            found, captured, places = found[:count], captured[:count], places[:count]
            at, is_full = begin + heads[count], False
            if not count:
                return None, False
        self._source.drop(at - begin)
        return self._block(octets, places, found, captured), is_full

    @property
    def _record(self) -> np.dtype[np.void]:
        names = ("kind", "length", "interface", "high", "low", "captured", "original")
        return np.dtype([(each, self._reader.order + "u4") for each in names])

    def _walk(self, data: bytes, begin: int, end: int) -> tuple[list[int], int, bool]:
        """Find the enhanced packet blocks in `data` between the offsets `begin` and `end`.

        Returns the offset of each, counted from `begin`; the offset in `data` behind the last one;
        and True if the search ended only because the data did, or because they are enough.
        """
        head_of = struct.Struct(self._reader.order + "II").unpack_from
        places: list[int] = []
        append = places.append
        at = begin
        for _ in range(BLOCK_PACKETS):
            if at + _ENHANCED > end:
                return places, at, True
            kind, length = head_of(data, at)
            if kind != BLOCK_ENHANCED or length < _ENHANCED or length > MAX_BLOCK:
                return places, at, False
            if at + length > end:
                return places, at, True
            append(at - begin)
            at += length
        return places, at, True

    def _block(
        self, octets: Octets, places: Int64s, found: npt.NDArray[np.void], captured: Int64s
    ) -> PacketBlock:
        reader = self._reader
        numbers, interface = np.unique(found["interface"], return_inverse=True)
        used = [reader.interfaces[number] for number in numbers.tolist()]
        ticks = found["high"].astype(np.int64) << 32 | found["low"].astype(np.int64)
        ts_ns = np.empty(len(places), np.int64)
        for number, one in enumerate(used):
            chosen = interface == number
            ts_ns[chosen] = _times(one, ticks[chosen])
        block = PacketBlock(
            data=octets,
            starts=places + _ENHANCED - 4,
            captured=captured,
            original=np.maximum(found["original"].astype(np.int64), captured),
            ts_ns=ts_ns,
            file=self._name,
            first_number=reader.number + 1,
            links=[(one.link, one.link_type) for one in used],
            interfaces=interface.astype(np.int64) if len(used) > 1 else None,
        )
        reader.number += len(places)
        reader.ts_ns = int(ts_ns[-1])
        return block


def _times(interface: PcapngInterface, ticks: Int64s) -> Int64s:
    """Return the times of ticks of an interface in UTC ns."""
    least, most = int(ticks.min()), int(ticks.max())
    low, high = (each * interface.multiplier for each in (least, most))
    times = low // interface.divisor, high // interface.divisor
    is_simple = (
        low >= 0
        and high < 1 << 63
        and times[0] + interface.offset_ns >= 0
        and times[1] + interface.offset_ns < 1 << 63
        and interface.divisor < 1 << 63
        and abs(interface.offset_ns) < 1 << 63
    )
    if is_simple:
        found: Int64s = ticks * interface.multiplier // interface.divisor + interface.offset_ns
        return found
    # In the array, ticks of 2^63 and more have become negative numbers.
    return np.array([interface.time_ns(one & _MASK_64) for one in ticks.tolist()], np.int64)


def _octets(data: bytes, begin: int, end: int) -> Octets:
    """Return the bytes of `data` from `begin` to `end`, and SPARE more bytes behind them.

    The SPARE bytes are those that follow in `data`. If `data` is too short for them, the result is
    a copy with zeros at its end.
    """
    if end + SPARE > len(data):
        data, begin, end = data[begin:end] + bytes(SPARE), 0, end - begin
    return np.frombuffer(data, np.uint8, end + SPARE - begin, begin)


def _pack_blocks(packets: Iterator[Packet]) -> Iterator[PacketBlock]:
    """Collect packets into blocks of at most BLOCK_PACKETS.

    If reading a packet fails, the error is raised after all packets before it were yielded.
    """
    error: Exception | None = None

    def guarded() -> Iterator[Packet]:
        nonlocal error
        try:
            yield from packets
        except (InputError, OSError) as caught:
            error = caught

    items = guarded()
    while some := list(islice(items, BLOCK_PACKETS)):
        yield _block_of(some)
    if error is not None:
        raise error


def _block_of(packets: list[Packet]) -> PacketBlock:
    numbers: dict[tuple[str, int], int] = {}
    interfaces = [numbers.setdefault((one.link, one.link_type), len(numbers)) for one in packets]
    captured = np.array([len(one.data) for one in packets], np.int64)
    data = b"".join([one.data for one in packets] + [bytes(SPARE)])
    return PacketBlock(
        data=np.frombuffer(data, np.uint8),
        starts=np.cumsum(captured) - captured,
        captured=captured,
        original=np.array([one.original_length for one in packets], np.int64),
        ts_ns=np.array([one.ts_ns for one in packets], np.int64),
        file=packets[0].file,
        first_number=packets[0].number,
        links=[*numbers],
        interfaces=np.array(interfaces, np.int64) if len(numbers) > 1 else None,
    )
