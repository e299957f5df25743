"""Sets of register or bit addresses, stored as ranges."""

# A range is a pair of its first and its last address, both included. The ranges of a set are
# sorted; ranges that overlap or touch are merged.
#
# A set holds at most MAX_RANGES ranges; a scan of every second register would need more. At the
# limit, a new range is added only if it overlaps or touches a range of the set. Otherwise it is
# only counted in `left_out`.

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence

MAX_RANGES = 1024
"""The most ranges of a set."""
SHOWN = 8
"""The most ranges or names that a text lists, unless the caller gives another number."""
_LAST_ADDRESS = 0xFFFF

AddressRange = tuple[int, int]
"""The first and the last address of a range, both included."""


class AddressRanges:
    """A set of register or bit addresses, to which ranges of addresses can be added."""

    __slots__ = ("_firsts", "_lasts", "left_out")

    def __init__(self, ranges: Iterable[AddressRange] = ()) -> None:
        self._firsts: list[int] = []
        self._lasts: list[int] = []
        self.left_out = 0
        """The number of calls of `add` whose range was not added, because the set already had
        MAX_RANGES."""
        for first, last in ranges:
            self.add(first, last)

    def add(self, first: int, last: int) -> None:
        """Add the addresses from `first` to `last`, both included. Addresses above FFFFH are
        ignored.
        """
        last = min(last, _LAST_ADDRESS)
        if not 0 <= first <= last:
            return
        # The ranges with the indices from `begin` up to, but not including, `end` overlap or touch
        # the new range.
        begin = bisect_left(self._lasts, first - 1)
        end = bisect_right(self._firsts, last + 1)
        if begin < end:
            first = min(first, self._firsts[begin])
            last = max(last, self._lasts[end - 1])
        elif len(self._firsts) >= MAX_RANGES:
            self.left_out += 1
            return
        self._firsts[begin:end] = [first]
        self._lasts[begin:end] = [last]

    @property
    def pairs(self) -> list[AddressRange]:
        return list(zip(self._firsts, self._lasts, strict=True))


def joined_ranges(several: Iterable[Sequence[AddressRange]]) -> list[AddressRange]:
    """The addresses that are in at least one of several sets, as one sorted list of ranges."""
    return AddressRanges(pair for ranges in several for pair in ranges).pairs


def without(ranges: Sequence[AddressRange], others: Sequence[AddressRange]) -> list[AddressRange]:
    """The addresses of `ranges` that are not in `others`, as ranges; both lists are sorted."""
    left = []
    for first, last in ranges:
        at = first
        for other_first, other_last in others:
            if other_last < at:
                continue
            if other_first > last:
                break
            if other_first > at:
                left.append((at, other_first - 1))
            at = other_last + 1
        if at <= last:
            left.append((at, last))
    return left


def ranges_text(ranges: Sequence[AddressRange], most: int = SHOWN) -> str:
    """Return `ranges` as a text that shows at most `most` of them: `0..99, 200 and 3 more`."""
    return listed(
        [str(first) if first == last else f"{first}..{last}" for first, last in ranges], most
    )


def listed(names: Sequence[str], most: int = SHOWN) -> str:
    """Return `names` as a text that shows at most `most` of them: `a, b and 3 more`."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most:,} more"
