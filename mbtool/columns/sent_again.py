"""Finds segments that repeat the bytes of a segment before them, and so change nothing."""

# Such a segment has the numbers and bytes of its first copy. Between the two no other segment of
# its connection has bytes, or only one of the other end. So a plain stretch that has the second
# copy has the first one too: all its bytes were delivered, and are the same.
#
# A segment of one byte may be a keep-alive probe, which is counted, and is not found here.

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import pieces

if TYPE_CHECKING:
    from mbtool.columns.arrays import Bools, Int64s, Octets
    from mbtool.columns.headers import Segments

_LONGEST = 512
"""The longest payload, in bytes, that is compared."""


def is_sent_again(segments: Segments, order: Int64s, flows: Int64s, data: Octets) -> Bools:
    """True for each segment in `order` that repeats the one before it, or a request answered.

    `flows` are the numbers of the segments' flows; the segments of a flow stand together.
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
        )
        if distance == 2:
            middle = chosen[1:-1]
            is_copy &= segments.from_master[second] & ~segments.from_master[middle]
        both = np.flatnonzero(is_copy)
        is_equal = _are_equal(segments, first[both], second[both], data)
        found[places[both[is_equal] + distance]] = True
    return found


def _are_equal(segments: Segments, first: Int64s, second: Int64s, data: Octets) -> Bools:
    """True where two segments of equal size have the same bytes."""
    if not len(first):
        return np.zeros(0, np.bool_)
    sizes = segments.size[first]
    differs = pieces(data, segments.begin[first], sizes) != pieces(
        data, segments.begin[second], sizes
    )
    counts: Int64s = np.add.reduceat(differs.astype(np.int64), np.cumsum(sizes) - sizes)
    is_equal: Bools = counts == 0
    return is_equal
