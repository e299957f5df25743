"""Puts IP packets together that came in fragments."""

# Fragments of one packet have its addresses and identification, and with IPv4 its protocol (RFC
# 791, section 3.2; RFC 8200, section 4.5). Only those that may hold TCP are kept. A packet is whole
# when every byte up to the end that its last fragment names has come; it is given as a plain IP
# packet without options, at the time of the fragment that completed it.
#
# Where fragments overlap, the first copy wins. No honest sender makes them overlap (RFC 5722), so
# an overlap is told; an exact copy, as mirror ports make them, is not. For its copies' sake a
# packet stays known after it was whole; other bytes under its identification begin another one.
#
# Bytes that the capture cut off a fragment (snaplen) are missing from the packet, and what follows
# them in it with them: it is given as far as it is known.
#
# Bounds: MAX_DATAGRAMS packets of at most 64 KiB, MAX_FRAGMENT_BYTES in all, each fragment counted
# with PIECE_COST for its upkeep; beyond, the oldest is given up. One that is not whole within
# FRAGMENT_NS is given up too, or its identification would meet its next use.

from __future__ import annotations

import struct
from bisect import bisect_right, insort
from collections import OrderedDict
from dataclasses import dataclass, field
from enum import Enum
from ipaddress import ip_address
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Endpoint, EventKind, WireEvent
from mbtool.packets.segment import (
    IPV6_AUTHENTICATION,
    IPV6_EXTENSIONS,
    IPV6_FRAGMENT,
    TCP,
    walk_ipv6,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

MAX_DATAGRAMS = 256
MAX_FRAGMENT_BYTES = 4 * 1024 * 1024
PIECE_COST = 256
FRAGMENT_NS = 10_000_000_000

_MAX_PAYLOAD = 0xFFFF - 20
_BEFORE_TCP = IPV6_EXTENSIONS | {IPV6_AUTHENTICATION, TCP}
_IPV4 = struct.Struct(">BxHHHxB")
_IPV4_HEADER = struct.Struct(">BxHHHBBH")
_IPV6_HEADER = struct.Struct(">IHBB")

Key = tuple[bytes, bytes, int, int]
"""Source, destination, protocol (0 in IPv6) and identification."""


class Fragment(NamedTuple):
    """A part of an IP packet's payload."""

    key: Key
    following: int
    """The protocol at the beginning of the whole packet's payload."""
    start: int
    end: int
    last: bool
    data: bytes
    """Shorter than from start to end where the capture cut it."""


class Overlap(Enum):
    """What later fragments of a packet say of earlier ones."""

    NONE = 0
    SAME = 1
    """The same bytes in other cuts."""
    DIFFERENT = 2


class DatagramEnd(Enum):
    """How a packet was done with."""

    WHOLE = 0
    INCOMPLETE = 1
    """Fragments have not come in time."""
    DISCARDED = 2
    """More packets in fragments than are kept."""


@dataclass(slots=True)
class Datagram:
    """The fragments of one packet."""

    key: Key
    link: str
    first_ns: int
    following: int
    pieces: list[tuple[int, int, bytes]] = field(default_factory=list)
    """Start, end and bytes of each, in order, without overlaps."""
    held: int = 0
    """How many bytes the pieces stand for."""
    total: int | None = None
    """Where the last fragment ends, once seen."""
    overlap: Overlap = Overlap.NONE
    ending: DatagramEnd | None = None

    @property
    def payload(self) -> bytes:
        """The bytes from the first to the first that is missing."""
        return b"".join(self._leading())

    def packet(self) -> tuple[bytes, int]:
        """A plain IP packet of what is known, and how long the whole is."""
        payload = self.payload
        source, destination, protocol, _ = self.key
        length = self.held if self.total is None else self.total
        if len(source) == 4:
            header = _IPV4_HEADER.pack(0x45, 20 + length, 0, 0, 0, protocol, 0)
        else:
            header = _IPV6_HEADER.pack(6 << 28, length, self.following, 0)
        data = header + source + destination + payload
        return data, len(data) - len(payload) + length

    def add(self, fragment: Fragment) -> int:
        """Keep what is not known yet. Gives how many pieces that made."""
        start, end = fragment.start, fragment.end
        known = self.pieces[-1][1] if self.pieces else 0
        if self.total is None and fragment.last and end >= known:
            self.total = end
        elif (self.total is not None and end > self.total) or (fragment.last and end != self.total):
            self.overlap = Overlap.DIFFERENT  # Two ends: what came first holds.
            return 0
        if not start:
            self.following = fragment.following
        added, cursor = [], start
        for other in self._touching(start, end):
            if other[0] > cursor:
                added.append(_part(fragment, cursor, other[0]))
            self._compare(fragment, other)
            cursor = other[1]
        if cursor < end:
            added.append(_part(fragment, cursor, end))
        for piece in added:
            insort(self.pieces, piece)
            self.held += piece[1] - piece[0]
        return len(added)

    def is_copy(self, fragment: Fragment) -> bool:
        """All bytes of a fragment are known, and no other."""
        cursor = fragment.start
        for start, end, data in self._touching(fragment.start, fragment.end):
            if start > cursor or _differ(fragment, (start, end, data)):
                return False
            cursor = end
        return cursor >= fragment.end

    def _touching(self, start: int, end: int) -> list[tuple[int, int, bytes]]:
        at = bisect_right(self.pieces, (start, _MAX_PAYLOAD + 1))
        if at and self.pieces[at - 1][1] > start:
            at -= 1
        behind = at
        while behind < len(self.pieces) and self.pieces[behind][0] < end:
            behind += 1
        return self.pieces[at:behind]

    def _compare(self, fragment: Fragment, other: tuple[int, int, bytes]) -> None:
        if _differ(fragment, other):
            self.overlap = Overlap.DIFFERENT
        elif self.overlap is Overlap.NONE and other[:2] != (fragment.start, fragment.end):
            self.overlap = Overlap.SAME

    def _leading(self) -> Iterator[bytes]:
        position = 0
        for start, end, data in self.pieces:
            if start != position:
                return
            yield data
            position = start + len(data)
            if position != end:
                return


class Fragments:
    """The packets whose fragments are coming."""

    def __init__(self) -> None:
        self._datagrams: OrderedDict[tuple[str, Key], Datagram] = OrderedDict()
        """In the order of their first fragments."""
        self._cost = 0

    @property
    def cost(self) -> int:
        """What is held, as MAX_FRAGMENT_BYTES counts it."""
        return self._cost

    def feed(self, fragment: Fragment, ts_ns: int, link: str, among: str = "") -> list[Datagram]:
        """Take a fragment. Gives the packets that are done with, whole or not, in order.

        Only those that come with the same `among` are put together.
        """
        done = self.advance(ts_ns)
        key = (among, fragment.key)
        datagram = self._datagrams.get(key)
        if datagram is not None and datagram.ending is DatagramEnd.WHOLE:
            if datagram.is_copy(fragment):
                return done
            self._forget(key)
            datagram = None
        if datagram is None:
            datagram = Datagram(fragment.key, link, ts_ns, fragment.following)
            self._datagrams[key] = datagram
            self._cost += PIECE_COST
        before = datagram.held
        self._cost += datagram.add(fragment) * PIECE_COST + datagram.held - before
        if datagram.held == datagram.total:
            datagram.ending = DatagramEnd.WHOLE
            done.append(datagram)
        while len(self._datagrams) > MAX_DATAGRAMS or self._cost > MAX_FRAGMENT_BYTES:
            done += self._give_up(next(iter(self._datagrams)), DatagramEnd.DISCARDED)
        return done

    def advance(self, now_ns: int) -> list[Datagram]:
        """Let time pass. Gives the packets that are given up."""
        done: list[Datagram] = []
        while self._datagrams:
            key, oldest = next(iter(self._datagrams.items()))
            if abs(now_ns - oldest.first_ns) < FRAGMENT_NS:
                break
            done += self._give_up(key, DatagramEnd.INCOMPLETE)
        return done

    def close(self) -> list[Datagram]:
        """The capture ends. Gives the packets that are not whole."""
        return [
            one
            for key in list(self._datagrams)
            for one in self._give_up(key, DatagramEnd.INCOMPLETE)
        ]

    def _give_up(self, key: tuple[str, Key], ending: DatagramEnd) -> list[Datagram]:
        datagram = self._forget(key)
        if datagram.ending is DatagramEnd.WHOLE:
            return []
        datagram.ending = ending
        return [datagram]

    def _forget(self, key: tuple[str, Key]) -> Datagram:
        datagram = self._datagrams.pop(key)
        self._cost -= (1 + len(datagram.pieces)) * PIECE_COST + datagram.held
        return datagram


def find_fragment(data: bytes, at: int, original_length: int) -> Fragment | None:
    """Read the IP packet at an offset; None where it is no fragment, or not one of TCP."""
    if len(data) < at + 20:
        return None
    version = data[at] >> 4
    if version == 4:
        first, total, identification, offset, protocol = _IPV4.unpack_from(data, at)
        header = (first & 0x0F) * 4
        if protocol != TCP or header < 20 or not offset & 0x3FFF:
            return None
        key = (data[at + 12 : at + 16], data[at + 16 : at + 20], protocol, identification)
        begin, last = at + header, not offset & 0x2000
        end = at + total if total else original_length
        return _fragment(data, key, TCP, (offset & 0x1FFF) * 8, last, begin, end, original_length)
    if version != 6 or len(data) < at + 40:
        return None
    end, following, begin = walk_ipv6(data, at, original_length)
    if following != IPV6_FRAGMENT or begin + 8 > min(end, len(data)):
        return None
    following = data[begin]
    if following not in _BEFORE_TCP:
        return None
    offset = data[begin + 2] << 8 | data[begin + 3]
    identification = int.from_bytes(data[begin + 4 : begin + 8], "big")
    key = (data[at + 8 : at + 24], data[at + 24 : at + 40], 0, identification)
    last = not offset & 1
    begin += 8
    return _fragment(data, key, following, offset & 0xFFF8, last, begin, end, original_length)


def _fragment(
    data: bytes,
    key: Key,
    following: int,
    start: int,
    last: bool,
    begin: int,
    end: int,
    original_length: int,
) -> Fragment | None:
    # As of a whole packet: a claim to be longer than the frame was is wrong.
    length = min(end, original_length) - begin
    if not last:
        length &= ~7  # Offsets count in eights.
    if length <= 0 or start + length > _MAX_PAYLOAD:
        return None
    return Fragment(key, following, start, start + length, last, data[begin : begin + length])


def fragment_events(
    datagram: Datagram, ts_ns: int, source_port: int, destination_port: int
) -> list[WireEvent]:
    """What is worth telling of a packet that is done with."""
    told = []
    if datagram.overlap is Overlap.SAME:
        told.append((EventKind.OVERLAP, "fragments of a packet overlap"))
    elif datagram.overlap is Overlap.DIFFERENT:
        text = "fragments of a packet contradict each other; the first copy is kept"
        told.append((EventKind.OVERLAP, text))
    if datagram.ending is DatagramEnd.INCOMPLETE:
        told.append((EventKind.UNREADABLE, "a packet of which fragments are missing"))
    elif datagram.ending is DatagramEnd.DISCARDED:
        text = "a packet of which fragments are missing, given up since too many are held"
        told.append((EventKind.DISCARDED, text))
    source, destination, *_ = datagram.key
    return [
        WireEvent(
            ts_ns=ts_ns,
            link=datagram.link,
            kind=kind,
            message=message,
            source=str(Endpoint(str(ip_address(source)), source_port)),
            destination=str(Endpoint(str(ip_address(destination)), destination_port)),
            raw=datagram.payload,
            missing=0 if datagram.total is None else datagram.total - datagram.held,
        )
        for kind, message in told
    ]


def _part(fragment: Fragment, start: int, end: int) -> tuple[int, int, bytes]:
    return start, end, fragment.data[start - fragment.start : end - fragment.start]


def _differ(fragment: Fragment, other: tuple[int, int, bytes]) -> bool:
    """Tell whether bytes that both have are not the same."""
    start, _, data = other
    begin = max(start, fragment.start)
    end = min(start + len(data), fragment.start + len(fragment.data))
    ours = fragment.data[begin - fragment.start : end - fragment.start]
    return begin < end and ours != data[begin - start : end - start]
