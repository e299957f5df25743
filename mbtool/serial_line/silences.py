"""Finds the silences between bytes, by the times (ns) at which the bytes ended."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


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
