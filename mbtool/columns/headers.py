"""Reads the link layer, IP and TCP headers of all packets of a block at once, as arrays."""

# A followed port is a TCP port that carries Modbus. Each packet is of one of these kinds:
#
#     plain      a whole TCP segment between a followed port and one that is not followed
#     odd        a segment from or to a followed port that is not plain: cut, malformed, or between
#                two followed ports
#     hidden     a packet that may carry a segment where this module does not look: fragments,
#                tunnels, headers before IP that are not VLAN tags, unknown link types, extension
#                headers of IPv6
#     other      everything else, which the Decoder would ignore
#
# The rules are those by which the Decoder reads single packets (link_layer.py, segment.py and
# tunnels.py in packets/). A packet whose kind is in doubt counts as hidden. Only plain packets may
# be read as arrays. The Decoder is fed all packets except those of the kind "other".

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s, Uint64s, gather
from mbtool.columns.flows import PORT_AT, Addresses
from mbtool.packets.link_layer import FAMILIES
from mbtool.packets.segment import TCP

if TYPE_CHECKING:
    from mbtool.columns.packet_block import PacketBlock

_IP_PLACES = {1: (12, 14), 113: (14, 16), 276: (0, 20)}
"""For each link type (1 Ethernet, 113 and 276 Linux cooked capture), the offsets of the EtherType
and of the IP header in a packet, in bytes."""
_RAW_TYPES = {12: 0, 14: 0, 101: 0, 228: 0, 229: 0, 0: 4, 108: 4}
"""For each link type without EtherType, the offset of the IP header. 4 bytes with the address
family come before it in the link types 0 and 108 (loopback)."""
_FAMILY_AT = 4
"""The size in bytes of the address family before the IP header in loopback packets."""
_VLAN = (0x8100, 0x88A8, 0x9100)
"""The EtherTypes of VLAN tags."""
_IPV4, _IPV6 = 0x0800, 0x86DD
_BEFORE_IP = (0x892F, 0x8864, 0x8847, 0x8848, *_VLAN)
"""EtherTypes behind which this module does not look for IP: HSR, PPPoE, MPLS, a third VLAN tag.
Their packets go to the Decoder, because an IP packet may follow the further header."""
_TUNNELS = (4, 41, 47)
"""The IP protocols that carry another IP packet: IPv4, IPv6, GRE. Their packets go to the
Decoder."""
_UDP, _ICMPV6 = 17, 58
_IPV6_SIZE = 40
_VXLAN_PORT = 4789
_MAX_TAGS = 2
"""The most VLAN tags that are skipped in a packet."""

_IPV4_HEADER = np.dtype(
    [
        ("first", "u1"), ("tos", "u1"), ("total", ">u2"), ("id", ">u2"), ("fragment", ">u2"),
        ("ttl", "u1"), ("protocol", "u1"), ("sum", ">u2"), ("source", ">u4"), ("target", ">u4"),
    ]
)  # fmt: skip
_TCP_HEADER = np.dtype(
    [
        ("source", ">u2"), ("target", ">u2"), ("sequence", ">u4"), ("acknowledged", ">u4"),
        ("offset", "u1"), ("flags", "u1"), ("rest", "V6"),
    ]
)  # fmt: skip
_IPV6_HEADER = np.dtype([("length", ">u2"), ("following", "u1")])
_ADDRESS = np.dtype([("high", ">u8"), ("low", ">u8")])
_PAIR = np.dtype(">u2")
_PORT_AT = np.uint64(PORT_AT)


@dataclass(slots=True)
class Segments:
    """The TCP segments of one block (at most 65,536 packets) that have a Modbus port as source or
    destination.

    Each array has one element per segment.
    """

    index: Int64s
    """For each segment, the index of its packet in the block."""
    is_plain: Bools
    lower: Uint64s
    """The smaller end of the connection, as the number that flows.py describes; `upper` has the
    greater end."""
    upper: Uint64s
    from_lower: Bools
    from_master: Bools
    """True if the destination port is a Modbus port. If both ports are, the master is unknown and
    `is_plain` is False."""
    sequence: Int64s
    acknowledged: Int64s
    flags: Int64s
    ip_at: Int64s
    """The length, in bytes, of the link layer header in front of the IP header."""
    begin: Int64s
    """The offset of the TCP payload in the data of the block, in bytes."""
    size: Int64s
    """The number of payload bytes; 0 where `is_plain` is False."""
    ts_ns: Int64s


@dataclass(slots=True)
class Headers:
    """The headers of a block's packets: the TCP segments, and the indices of packets that could not
    be read as arrays.
    """

    segments: Segments
    hidden: Int64s
    """The indices of packets that may carry a Modbus segment where this module cannot read it: IP
    fragments, tunnels, unknown headers before IP."""

    def part(self, begin: int, end: int) -> Headers:
        """Return the headers of the packets with the indices `begin` to `end` (exclusive).

        In the result, packets are counted from `begin`.
        """
        index = self.segments.index
        first, last = np.searchsorted(index, (begin, end)).tolist()
        segments = Segments(
            *(getattr(self.segments, name)[first:last] for name in Segments.__slots__)
        )
        segments.index = segments.index - begin
        hidden = self.hidden[(self.hidden >= begin) & (self.hidden < end)] - begin
        return Headers(segments, hidden)


def read_headers(block: PacketBlock, ports: Iterable[int], addresses: Addresses) -> Headers:
    """Read the headers of all packets of a block. `ports` are the TCP ports that carry Modbus;
    `addresses` numbers the IPv6 addresses.
    """
    is_followed = np.zeros(1 << 16, np.bool_)
    is_followed[list(ports)] = True
    kinds, at, hidden = _network(block)
    data, captured = block.data, block.captured
    version = data[at] >> 4
    is_ip = (kinds == _IPV4) | (kinds == _IPV6)
    is_six = is_ip & (version == 6)
    hidden |= is_ip & ~is_six & (version != 4)
    hidden |= is_ip & (captured < at - block.starts + np.where(is_six, _IPV6_SIZE + 4, 20))
    some = np.flatnonzero(is_ip & ~hidden)
    segments = _segments(block, some, at[some], is_six[some], hidden, is_followed, addresses)
    return Headers(segments, np.flatnonzero(hidden))


def _network(block: PacketBlock) -> tuple[Int64s, Int64s, Bools]:
    """Read the link layer headers of all packets of a block.

    Returns three arrays with an element per packet: the EtherType behind up to two VLAN tags (that
    of IPv4 if the packet begins with the IP header); the offset of the IP header in the block's
    data; True for a hidden packet, whose headers cannot be read here.
    """
    hidden = np.zeros(len(block), np.bool_)
    kind_at, at = np.zeros(len(block), np.int64), np.zeros(len(block), np.int64)
    is_raw = np.zeros(len(block), np.bool_)
    for number, (_, link_type) in enumerate(block.links):
        chosen = slice(None) if block.interfaces is None else block.interfaces == number
        if link_type in _IP_PLACES:
            kind_at[chosen], at[chosen] = _IP_PLACES[link_type]
        elif link_type in _RAW_TYPES:
            is_raw[chosen] = True
            at[chosen] = _RAW_TYPES[link_type]
        else:
            hidden[chosen] = True
    hidden |= block.captured < np.where(is_raw, at, np.maximum(kind_at + 2, at))
    # A packet too short for its link layer header is hidden, so that no byte behind its end counts.
    kinds = _pairs(block, kind_at, hidden)
    for _ in range(_MAX_TAGS):
        tagged = np.flatnonzero(_is_one_of(kinds, _VLAN) & ~is_raw & ~hidden)
        if not len(tagged):
            break
        at[tagged] += 4
        hidden[tagged] |= block.captured[tagged] < at[tagged]
        kinds[tagged] = _pairs(block, at - 2, hidden)[tagged]
    kinds[is_raw] = _IPV4
    has_family = np.flatnonzero(is_raw & (at == _FAMILY_AT) & ~hidden)
    if len(has_family):
        families = block.data[block.starts[has_family, None] + np.arange(_FAMILY_AT)]
        found, like = np.unique(families.view("V4")[:, 0], return_inverse=True)
        is_ip = np.array([one.tobytes() in FAMILIES for one in found], np.bool_)
        kinds[has_family[~is_ip[like]]] = 0
    kinds[hidden] = 0
    hidden |= _is_one_of(kinds, _BEFORE_IP)
    return kinds, block.starts + np.where(hidden, 0, at), hidden


def _pairs(block: PacketBlock, at: Int64s, hidden: Bools) -> Int64s:
    """Return for each packet the big-endian 16-bit number at its offset in `at`, counted from the
    start of the packet. The number of a hidden packet is meaningless.
    """
    places = block.starts + np.where(hidden, 0, at)
    return gather(block.data, places, _PAIR).astype(np.int64)


def _is_one_of(values: Int64s, known: tuple[int, ...]) -> Bools:
    return np.isin(values, known)


def _segments(
    block: PacketBlock,
    some: Int64s,
    at: Int64s,
    is_six: Bools,
    hidden: Bools,
    is_followed: Bools,
    addresses: Addresses,
) -> Segments:
    """Return the TCP segments from or to Modbus ports in the IP packets with the indices `some`.

    `at` has the offset of each packet's IP header in the block's data, `is_six` is True for IPv6;
    `is_followed` is True at the index of each Modbus port. Sets `hidden` to True for packets that
    may carry a segment that cannot be read here: fragments, tunnels, cut or further headers.
    """
    headers = gather(block.data, at, _IPV4_HEADER)
    header = (headers["first"] & 0x0F).astype(np.int64) * 4
    total = headers["total"].astype(np.int64)
    protocol = headers["protocol"].astype(np.int64)
    is_odd = (header < 20) | ((headers["fragment"] & 0x3FFF) != 0)
    six = np.flatnonzero(is_six)
    if len(six):
        found = gather(block.data, at[six] + 4, _IPV6_HEADER)
        header[six], total[six] = _IPV6_SIZE, _IPV6_SIZE + found["length"].astype(np.int64)
        protocol[six] = found["following"]
        is_known = np.isin(protocol[six], (TCP, _UDP, _ICMPV6))
        is_odd[six] = ~is_known | (found["length"] == 0)
    relative = at - block.starts[some]
    captured = block.captured[some]
    is_tcp = protocol == TCP
    start = at + header
    # Hide a packet whose TCP header is cut off by the snapshot length: its ports are unknown.
    is_odd |= is_tcp & ((captured < relative + header + 20) | (total < header))
    is_odd |= _is_one_of(protocol, _TUNNELS)
    is_udp = np.flatnonzero((protocol == _UDP) & ~is_odd & (captured >= relative + header + 4))
    source, target = (gather(block.data, start[is_udp] + place, _PAIR) for place in (0, 2))
    is_odd[is_udp[(target == _VXLAN_PORT) | is_followed[source] | is_followed[target]]] = True
    hidden[some[is_odd]] = True
    chosen = np.flatnonzero(is_tcp & ~is_odd)
    tcp = gather(block.data, start[chosen], _TCP_HEADER)
    from_slave, to_slave = is_followed[tcp["source"]], is_followed[tcp["target"]]
    wanted = np.flatnonzero(from_slave | to_slave)
    chosen, tcp = chosen[wanted], tcp[wanted]
    from_slave, to_slave = from_slave[wanted], to_slave[wanted]
    size = (tcp["offset"] >> 4).astype(np.int64) * 4
    begin, end = start[chosen] + size, at[chosen] + total[chosen]
    index = some[chosen]
    last = block.starts[index] + np.minimum(block.captured[index], block.original[index])
    is_plain = (size >= 20) & (begin <= end) & (end <= last) & (from_slave != to_slave)
    headers, is_six = headers[chosen], is_six[chosen]
    source, target = (headers[each].astype(np.uint64) for each in ("source", "target"))
    six = np.flatnonzero(is_six)
    if len(six):
        both = [gather(block.data, at[chosen[six]] + place, _ADDRESS) for place in (8, 24)]
        source[six], target[six] = np.split(addresses.numbers(np.concatenate(both)), 2)
    source |= tcp["source"].astype(np.uint64) << _PORT_AT
    target |= tcp["target"].astype(np.uint64) << _PORT_AT
    from_lower = source < target
    for place in np.flatnonzero(is_six & (tcp["source"] == tcp["target"])).tolist():
        from_lower[place] = addresses.end(int(source[place])) < addresses.end(int(target[place]))
    return Segments(
        index=index,
        is_plain=is_plain,
        lower=np.where(from_lower, source, target),
        upper=np.where(from_lower, target, source),
        from_lower=from_lower,
        from_master=~from_slave,
        sequence=tcp["sequence"].astype(np.int64),
        acknowledged=tcp["acknowledged"].astype(np.int64),
        flags=tcp["flags"].astype(np.int64),
        ip_at=relative[chosen],
        begin=begin,
        size=np.where(is_plain, end - begin, 0),
        ts_ns=block.ts_ns[index],
    )
