"""Reassembles IP packets that came in fragments."""

# All fragments of a packet have the same addresses and identification, and with IPv4 the same
# protocol (RFC 791, section 3.2; RFC 8200, section 4.5). Only fragments that may hold TCP are kept.
# A packet is whole when every byte up to the end of its last fragment has come. The result is an IP
# packet without options or extension headers, with the time of the fragment that completed it.
#
# Where fragments overlap, the first copy wins. No correct sender makes them overlap (RFC 5722), so
# an overlap is reported. An exact copy, such as a mirror port makes, is not reported: a whole
# packet is remembered for a while to recognise copies. A fragment with the same identification and
# other bytes begins another packet.
#
# If the capture cut bytes off a fragment (snaplen), the result ends at the first missing byte.
#
# Limits: MAX_DATAGRAMS packets of at most 64 KiB are held, and MAX_FRAGMENT_BYTES in all, where
# each packet and each piece of one counts PIECE_COST bytes more. Above that, the oldest packet is
# given up. A packet that is not whole within FRAGMENT_NS is given up too, since senders reuse
# identifications.

from __future__ import annotations

import struct
from bisect import bisect_left, insort
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from itertools import chain
from typing import NamedTuple

from mbtool.core import EventKind, WireEvent
from mbtool.packets.segment import (
    IPV6_AUTHENTICATION,
    IPV6_EXTENSIONS,
    IPV6_FRAGMENT,
    TCP,
    endpoint,
    walk_ipv6,
)

MAX_DATAGRAMS = 256
MAX_FRAGMENT_BYTES = 4 * 1024 * 1024
PIECE_COST = 256
"""The estimated bytes of memory that a packet, or a piece of it, takes in addition to its data."""
FRAGMENT_NS = 10_000_000_000
"""The longest time from the first fragment of a packet to its last one, in ns."""

_MAX_PAYLOAD = 0xFFFF - 20
_BEFORE_TCP = IPV6_EXTENSIONS | {IPV6_AUTHENTICATION, TCP}
_IPV4 = struct.Struct(">BxHHHxB")
_IPV4_HEADER = struct.Struct(">BxHHHBBH")
_IPV6_HEADER = struct.Struct(">IHBB")

Key = tuple[bytes, bytes, int, int]
"""The fields that the fragments of one packet have in common: source and destination address (4 or
16 bytes each), protocol (0 in IPv6) and identification."""
_Header = tuple[Key, int, int, bool, int, int]
"""The fields of a fragment's headers: its key, the protocol at the start of the packet's payload,
the fragment's offset in that payload, True if it is the last fragment, and the offsets in the
captured packet at which its data begins and ends."""


class Fragment(NamedTuple):
    """A fragment: the bytes `start` to `end` (exclusive) of an IP packet's payload."""

    key: Key
    following: int
    """The number of the protocol whose header begins the payload of the whole packet, such as 6 for
    TCP."""
    start: int
    end: int
    last: bool
    data: bytes
    """The bytes of the fragment; fewer than end - start if the capture cut the packet."""


class Overlap(Enum):
    """The relation of a fragment to earlier fragments of the packet that it overlaps."""

    NONE = 0
    SAME = 1
    """A later fragment has the same bytes as earlier ones where they overlap, but begins or ends
    elsewhere."""
    DIFFERENT = 2
    """A later fragment has other bytes than earlier ones where they overlap, or contradicts the
    packet's length."""


class DatagramEnd(Enum):
    """The reason why the reassembly of a packet ended."""

    WHOLE = 0
    INCOMPLETE = 1
    """Some fragments did not come within FRAGMENT_NS."""
    DISCARDED = 2
    """The packet was dropped because the packets being reassembled exceeded MAX_DATAGRAMS or
    MAX_FRAGMENT_BYTES."""


@dataclass(slots=True)
class Datagram:
    """One IP packet that is being reassembled from fragments."""

    key: Key
    link: str
    first_ns: int
    following: int
    pieces: list[tuple[int, int, bytes]] = field(default_factory=list)
    """Start, end (offsets in the payload) and bytes of each piece of the payload that has come, in
    order, without overlaps."""
    held: int = 0
    """The number of bytes of the packet's payload that have come, including bytes that the snaplen
    cut off."""
    total: int | None = None
    """The length of the packet's payload in bytes; None until its last fragment has come."""
    overlap: Overlap = Overlap.NONE
    ending: DatagramEnd | None = None

    @property
    def payload(self) -> bytes:
        """The bytes of the packet's payload up to the first byte that is missing."""
        return b"".join(self._leading())

    def packet(self) -> tuple[bytes, int]:
        """Return an IP packet with `payload`, and the length in bytes that the whole packet has.

        If the last fragment has not come, the length counts the payload bytes that have.
        """
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
        """Keep the new bytes of a fragment; return the number of entries that this adds to
        `pieces`.
        """
        start, end = fragment.start, fragment.end
        is_behind = not self.pieces or end >= self.pieces[-1][1]
        if self.total is None and fragment.last and is_behind:
            self.total = end
        elif (self.total is not None and end > self.total) or (fragment.last and end != self.total):
            self.overlap = Overlap.DIFFERENT  # Two different ends: the first counts.
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
        """True if a fragment repeats bytes of this packet, which is already whole."""
        touching = self._touching(fragment.start, fragment.end)
        return fragment.end <= self.held and not any(_differ(fragment, one) for one in touching)

    def _touching(self, start: int, end: int) -> list[tuple[int, int, bytes]]:
        at = bisect_left(self.pieces, (start,))
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
    """Reassembles IP packets from their fragments."""

    def __init__(self) -> None:
        self._datagrams: OrderedDict[tuple[str, Key], Datagram] = OrderedDict()
        """The packets by scope (an interface's name, or "" for all interfaces) and Key, in the
        order of their first fragments."""
        self._cost = 0

    @property
    def cost(self) -> int:
        """The bytes held plus PIECE_COST for each packet and piece, at most MAX_FRAGMENT_BYTES."""
        return self._cost

    def feed(self, fragment: Fragment, ts_ns: int, link: str, scope: str = "") -> list[Datagram]:
        """Take a fragment that was captured at `ts_ns` (UTC ns).

        Returns the packets whose reassembly has ended by then, whole or given up. `link` is the
        interface that captured the fragment. Only fragments with the same `scope` are put together:
        the interface, or "" to put fragments from all interfaces together.
        """
        done = self.advance(ts_ns)
        key = (scope, fragment.key)
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
            done += self._give_up_datagram(next(iter(self._datagrams)), DatagramEnd.DISCARDED)
        return done

    def advance(self, now_ns: int) -> list[Datagram]:
        """Give up the packets whose fragments did not come within FRAGMENT_NS.

        Returns these packets, the oldest first.
        """
        done: list[Datagram] = []
        while self._datagrams:
            key, oldest = next(iter(self._datagrams.items()))
            if abs(now_ns - oldest.first_ns) < FRAGMENT_NS:
                break
            done += self._give_up_datagram(key, DatagramEnd.INCOMPLETE)
        return done

    def close(self) -> list[Datagram]:
        """At the end of the capture, give up the packets that are not whole, and return them."""
        given_up = [
            self._give_up_datagram(key, DatagramEnd.INCOMPLETE) for key in list(self._datagrams)
        ]
        return list(chain.from_iterable(given_up))

    def _give_up_datagram(self, key: tuple[str, Key], ending: DatagramEnd) -> list[Datagram]:
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
    """Read the IP packet that begins at offset `at` of `data` as a fragment.

    `original_length` is the number of bytes that `data` had on the wire. Returns None if the IP
    packet is no fragment, or cannot hold TCP.
    """
    if len(data) < at + 20:
        return None
    reader = _READERS.get(data[at] >> 4)
    found = None if reader is None else reader(data, at, original_length)
    if found is None:
        return None
    key, following, start, is_last, begin, end = found
    # An IP header that claims more bytes than its frame has is wrong, so the frame's end counts.
    length = min(end, original_length) - begin
    if not is_last:
        length &= ~7  # Offsets are multiples of 8 bytes.
    if length <= 0 or start + length > _MAX_PAYLOAD:
        return None
    return Fragment(key, following, start, start + length, is_last, data[begin : begin + length])


def _read_ipv4(data: bytes, at: int, original_length: int) -> _Header | None:
    first, total, identification, offset, protocol = _IPV4.unpack_from(data, at)
    header = (first & 0x0F) * 4
    if protocol != TCP or header < 20 or not offset & 0x3FFF:
        return None
    key = (data[at + 12 : at + 16], data[at + 16 : at + 20], protocol, identification)
    end = at + total if total else original_length
    return key, TCP, (offset & 0x1FFF) * 8, not offset & 0x2000, at + header, end


def _read_ipv6(data: bytes, at: int, original_length: int) -> _Header | None:
    end, following, begin = walk_ipv6(data, at, original_length)
    if following != IPV6_FRAGMENT or begin + 8 > min(end, len(data)):
        return None
    following = data[begin]
    if following not in _BEFORE_TCP:
        return None
    offset = data[begin + 2] << 8 | data[begin + 3]
    identification = int.from_bytes(data[begin + 4 : begin + 8], "big")
    key = (data[at + 8 : at + 24], data[at + 24 : at + 40], 0, identification)
    return key, following, offset & 0xFFF8, not offset & 1, begin + 8, end


_READERS = {4: _read_ipv4, 6: _read_ipv6}
"""By IP version, the function that reads the headers of a fragment."""


def fragment_events(
    datagram: Datagram, ts_ns: int, source_port: int, destination_port: int
) -> list[WireEvent]:
    """Return the events to report for a packet whose reassembly ended at `ts_ns` (UTC ns).

    They report fragments that overlap or are missing. The ports are those of the TCP header in the
    packet.
    """
    reports = []
    if datagram.overlap is Overlap.SAME:
        reports.append((EventKind.OVERLAP, "fragments of a packet overlap"))
    elif datagram.overlap is Overlap.DIFFERENT:
        text = "fragments of a packet contradict each other; the first copy is kept"
        reports.append((EventKind.OVERLAP, text))
    if datagram.ending is DatagramEnd.INCOMPLETE:
        reports.append((EventKind.UNREADABLE, "a packet of which fragments are missing"))
    elif datagram.ending is DatagramEnd.DISCARDED:
        text = "a packet of which fragments are missing, given up since too many are held"
        reports.append((EventKind.DISCARDED, text))
    source, destination, *_ = datagram.key
    return [
        WireEvent(
            ts_ns=ts_ns,
            link=datagram.link,
            kind=kind,
            message=message,
            source=str(endpoint(source, source_port)),
            destination=str(endpoint(destination, destination_port)),
            raw=datagram.payload,
            missing=0 if datagram.total is None else datagram.total - datagram.held,
        )
        for kind, message in reports
    ]


def _part(fragment: Fragment, start: int, end: int) -> tuple[int, int, bytes]:
    return start, end, fragment.data[start - fragment.start : end - fragment.start]


def _differ(fragment: Fragment, other: tuple[int, int, bytes]) -> bool:
    """True if a fragment differs from an earlier piece of its packet where the two overlap.

    `other` is the start and the end (offsets in the payload) and the bytes of the piece.
    """
    start, _, data = other
    begin = max(start, fragment.start)
    end = min(start + len(data), fragment.start + len(fragment.data))
    ours = fragment.data[begin - fragment.start : end - fragment.start]
    return begin < end and ours != data[begin - start : end - start]
