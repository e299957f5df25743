"""Finds the silences between bytes, by the times (ns) at which the bytes ended."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


def silences(
    times: Sequence[int], last_ns: int | None, least_ns: int, *, at_end: bool
) -> list[bool]:
    """Return for each byte True if a silence precedes it, and `at_end` as one more value.

    `times` are the ends of the bytes in ns. A silence is at least `least_ns` from the end of one
    byte to the end of the next. `last_ns` is the time at which the byte before the first one ended;
    if it is None, a silence precedes the first byte. `at_end` is True if a silence follows the last
    byte.
    """
    first = last_ns is None or times[0] - last_ns >= least_ns
    between = [after - before >= least_ns for before, after in pairwise(times)]
    return [first, *between, at_end]


def longest_silence_ns(times: Sequence[int], size: int, character_ns: int) -> int:
    """Return the longest silence (ns) between the first `size` bytes, which must be two or more.

    `times` are the ends of the bytes in ns; a byte takes `character_ns`.
    """
    steps = map(int.__sub__, times[1:size], times[: size - 1])
    return max(max(steps) - character_ns, 0)


def last_silence(times: Sequence[int], size: int, least_ns: int) -> int:
    """Return the offset of the byte directly behind the last silence inside the first `size` bytes.

    `times` are the ends of the bytes in ns. A silence is `least_ns` or more from the end of a byte
    to the end of the next. There must be a silence.
    """
    offsets = range(size - 1, 0, -1)
    return next(offset for offset in offsets if times[offset] - times[offset - 1] >= least_ns)
