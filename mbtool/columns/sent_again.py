"""Finds TCP segments that repeat an earlier segment at once, so that decoding can skip them."""

# Such a copy, as a mirror port makes, has the sequence number, acknowledgement number and bytes of
# an earlier segment, less than RETRANSMISSION_NS before it. Between the two, no other segment of
# the connection has bytes, except one response if the repeated segment is a request. So both
# segments are in the same plain stretch (stretches.py), and the second one adds nothing.
#
# A copy that comes later than that was sent again by its sender, which the Decoder reports.
#
# A segment of one byte may be a keep-alive probe. The Decoder counts those, so they are not treated
# as copies here.

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import pieces
from mbtool.packets.connection import RETRANSMISSION_NS

if TYPE_CHECKING:
    from mbtool.columns.arrays import Bools, Int64s, Octets
    from mbtool.columns.headers import Segments

_LONGEST = 512
"""TCP payloads of more bytes are not compared. Segments with such payloads go to the Decoder."""


def is_sent_again(segments: Segments, order: Int64s, flows: Int64s, data: Octets) -> Bools:
    """Return for each segment in `order` True if it repeats the connection's previous segment with
    bytes, or the request that this previous segment answers.

    `order` has indices in `Segments`, sorted by connection, then by time. `flows` has the flow
    number of each segment in `order`, and `data` the bytes of the block.
    """
    found = np.zeros(len(order), np.bool_)
    places = np.flatnonzero(segments.size[order] > 1)
    chosen, flows = order[places], flows[places]
    for distance in (1, 2):
        first, second = chosen[:-distance], chosen[distance:]
        is_copy = (
            (flows[:-distance] == flows[distance:])
            & (segments.from_master[first] == segments.from_master[second])
            & (segments.sequence[first] == segments.sequence[second])
            & (segments.size[first] == segments.size[second])
            & (segments.acknowledged[first] == segments.acknowledged[second])
            & (segments.flags[first] == segments.flags[second])
            & (segments.size[second] <= _LONGEST)
            & (segments.ts_ns[second] - segments.ts_ns[first] < RETRANSMISSION_NS)
        )
        if distance == 2:
            middle = chosen[1:-1]
            is_copy &= segments.from_master[second] & ~segments.from_master[middle]
        both = np.flatnonzero(is_copy)
        is_equal = _are_equal(segments, first[both], second[both], data)
        found[places[both[is_equal] + distance]] = True
    return found


def _are_equal(segments: Segments, first: Int64s, second: Int64s, data: Octets) -> Bools:
    """Return for each i True if the payloads of the segments `first[i]` and `second[i]`, which have
    equal sizes, have the same bytes.
    """
    if not len(first):
        return np.zeros(0, np.bool_)
    sizes = segments.size[first]
    differs = pieces(data, segments.begin[first], sizes) != pieces(
        data, segments.begin[second], sizes
    )
    counts: Int64s = np.add.reduceat(differs.astype(np.int64), np.cumsum(sizes) - sizes)
    is_equal: Bools = counts == 0
    return is_equal
