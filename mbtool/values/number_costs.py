"""Computes, as a cost in bits, how well a series of numbers fits a type of value."""

# The cost is the length of the series in a code. This code is short for series that are usual for
# devices: numbers that begin near 0, have few decimal digits, and change by about as much as
# before. The type with the shortest code is the most probable one: one bit less is twice as
# probable.
#
# Each change is coded as k, its number of binary digits, and then its k - 1 digits after the first.
# k costs little if earlier changes had the same k. So the changes of a counter or of a noisy value
# cost about as much as their digits, and a single change of another size (such as a carry that is
# read as a fall) costs much.
#
# The samples of a series depend on each other, and no device is exactly as the code supposes. So
# the sum of the costs of all changes is scaled as if there were at most INDEPENDENT of them. The
# costliest changes, such as a carry that is read as a fall, count in full.

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from itertools import pairwise

INDEPENDENT = 20
"""If a series has more changes than this, the sum of their costs is scaled as if it had this many,
because neighbouring changes are not independent."""
MAGNITUDES = (1e-4, 1e9)
"""The greatest absolute value of a series of floats must be in this range, unless all are 0; else
it is no measurement."""
IMPOSSIBLE = math.inf
"""The cost in bits of a type that no device would use for the series."""
MOST_DECIMALS = 5
"""Floats are tried as decimal numbers with at most this many digits after the point."""
_DECIMALS_LIMIT_32, _DECIMALS_LIMIT_64 = 2_000_000, 1e14
"""A float of 32 (64) bits says something by having few decimals only if the number without its
decimal point is below this limit: every larger float looks as if it had few decimals."""
_BEYOND_COUNTING = 30.0
"""Extra cost in bits of a whole number of 2^53 or more: nothing is measured or counted as high."""
_HUGE = 6.0
"""Extra cost in bits of a whole number of 32 bits that is 2^28 or more: it is more probably a
float."""
_FEWEST_FLIPS = 3
"""A register is taken for bits only if it changed at least this often."""
_RARE = 4
"""If a series has more than INDEPENDENT changes, this many, the most expensive ones, keep their
whole cost; the costs of the others are scaled down."""
_CHEAP = 8.0
"""A series whose steps cost fewer bits than this is not tried as an even rise or as a list of
states, which could hardly be cheaper."""
_MOST_LACKING = 0.2
"""The greatest share (0 to 1) of floats that are NaN or infinite; with more, the series has no
floats."""
_LACKING = 8.0
"""The cost in bits of each float that is NaN or infinite, for the first _RARE of them."""
_MOST_STATES = 8
"""A series is tried as a list of states if it has at most this many different numbers."""
_HIT = 12.0
"""The bits subtracted from the cost of a series each time it is exactly at an end of its type's
range."""
_WIDE_NOISE = 13
"""A number of 16 bits is called noise, at 7 bits for each binary digit, if its median change has at
least this many binary digits (2^12 or more)."""


def whole_cost(number: int, bits: int) -> float:
    """The cost of a whole number of this many bits: small ones are more frequent."""
    cost = math.log2(abs(number) + 1) + math.log2(bits * 0.6931) + (bits > 16 or number < 0)
    if abs(number) >> 53:
        return cost + _BEYOND_COUNTING
    return cost + (_HUGE if bits == 32 and abs(number) >> 28 else 0)


def changes_cost(numbers: Sequence[int], bits: int) -> float:
    """The cost of the changes of a whole number over time."""
    cost = _steps_cost(numbers, bits)
    if cost < _CHEAP or len(numbers) < 3:
        return cost
    # A number that rises or falls evenly is cheaper as the changes of its changes.
    further = [after - before for before, after in pairwise(numbers)]
    cost = min(cost, 2.0 + whole_cost(further[0], bits) + _steps_cost(further, bits))
    states = set(numbers)
    if len(states) <= _MOST_STATES and len(states) * 3 <= len(numbers):
        # A number with few different values is cheaper as a list of them.
        news = sum(whole_cost(one, bits) for one in states) - whole_cost(numbers[0], bits)
        cost = min(cost, news + math.log2(len(states)) * min(len(numbers), INDEPENDENT))
    return cost


def _steps_cost(numbers: Sequence[int], bits: int) -> float:
    counts: dict[int, int] = {}
    total = usual = ups = moves = 0
    costs = []
    for before, now in pairwise(numbers):
        change = now - before
        size = change.bit_length() if change > 0 else (-change).bit_length()
        if total:
            nearness = 0.43 / (1 + abs(size - usual)) ** 2
            cost = -math.log2((counts.get(size, 0) + nearness) / (total + 1))
        else:
            cost = math.log2(bits) if size else 1.0
        counts[size] = counts.get(size, 0) + 1
        total += 1
        if size:
            is_up = change > 0
            cost += size - 1 - math.log2(((ups if is_up else moves - ups) + 0.5) / (moves + 1))
            ups += is_up
            moves += 1
            usual = size if moves == 1 else round((usual * 3 + size) / 4)
        costs.append(cost)
    if total <= INDEPENDENT:
        return sum(costs)
    costs.sort()
    rest = sum(costs[:-_RARE])
    return sum(costs[-_RARE:]) + rest * (INDEPENDENT - _RARE) / (total - _RARE)


def noise_cost(numbers: Sequence[int], bits: int) -> float:
    """The extra cost of a number that jumps over its whole range most of the time."""
    sizes = sorted(abs(now - before).bit_length() for before, now in pairwise(numbers))
    moves = [size for size in sizes if size]
    if len(moves) < 4 or len(moves) * 3 < len(sizes):
        return 0.0
    return 7.0 * max(moves[len(moves) // 2] - (bits - 16 + _WIDE_NOISE) + 1, 0)


def clipped_gain(numbers: Sequence[int], ends: tuple[int, ...]) -> float:
    """How much cheaper a number is that is often exactly at an end of its range, but varies much.

    A device that computes a number beyond the range of its type writes the end of the range.
    """
    hits = sum(number in ends for number in numbers)
    others = [number for number in numbers if number not in ends]
    if hits < 2 or len(others) < 4 or max(others) - min(others) < 1 << _WIDE_NOISE:
        return 0.0
    return _HIT * hits * min(1.0, INDEPENDENT / len(numbers))


def flags_cost(words: Sequence[int]) -> float:
    """The cost of a register whose bits change one by one."""
    flips = [(before ^ now).bit_count() for before, now in pairwise(words) if before != now]
    if len(flips) < _FEWEST_FLIPS or max(flips) > 2:
        return IMPOSSIBLE
    still = max(len(words) - 1 - len(flips), 1)
    share = len(flips) / (len(flips) + still)
    of_times = len(flips) * -math.log2(share) - still * math.log2(1 - share)
    cost = of_times + sum(1.0 + 3.0 * one if one == 1 else 12.0 for one in flips)
    return 18.0 + cost * min(1.0, INDEPENDENT / max(len(words) - 1, 1))


def float_cost(numbers: Sequence[float], bits: int) -> float:
    """The cost of a series of floats of 32 or 64 bits."""
    finite = [number for number in numbers if math.isfinite(number)]
    if lacking := len(numbers) - len(finite):
        if lacking > _MOST_LACKING * len(numbers):
            return IMPOSSIBLE
        return _LACKING * min(lacking, _RARE) + float_cost(finite, bits)
    greatest = max(map(abs, numbers))
    if greatest == 0:
        return 3.0
    low, high = MAGNITUDES
    if not low <= greatest < high:
        return IMPOSSIBLE
    least = min(abs(number) for number in numbers if number)
    if least < greatest * 1e-9:
        return IMPOSSIBLE
    raw = _raw_float_cost(numbers, bits)
    decimals = few_decimals(numbers, bits)
    if decimals is None:
        return raw
    scaled = [round(number * 10**decimals) for number in numbers]
    first = max(scaled, key=abs)
    return min(raw, 3.0 + whole_cost(first, 24 if bits == 32 else 48) + changes_cost(scaled, bits))


def _raw_float_cost(numbers: Sequence[float], bits: int) -> float:
    exponent = math.frexp(max(map(abs, numbers)))[1]
    first = 7.0 + 0.1 * abs(exponent - 7) + (23 if bits == 32 else 52)
    return first + changes_cost(ordered_bits(numbers, bits), bits)


def ordered_bits(numbers: Sequence[float], bits: int) -> list[int]:
    """Whole numbers that are in the same order as these floats, without gaps."""
    form, kind = ("f", "i") if bits == 32 else ("d", "q")
    raw = struct.unpack(f">{len(numbers)}{kind}", struct.pack(f">{len(numbers)}{form}", *numbers))
    lowest = -(1 << (bits - 1))
    return [one if one >= 0 else lowest - one for one in raw]


def few_decimals(numbers: Sequence[float], bits: int) -> int | None:
    """The number of decimals that all the floats have; None if they have more than a few.

    Every float of 32 bits has few decimals if it is large enough, which says nothing.
    """
    most = _DECIMALS_LIMIT_32 if bits == 32 else _DECIMALS_LIMIT_64
    greatest = max(map(abs, numbers))
    for decimals in range(MOST_DECIMALS + 1):
        if greatest * 10**decimals >= most:
            return None
        if all(_has_decimals(number, decimals, bits) for number in numbers):
            return decimals
    return None


def _has_decimals(number: float, decimals: int, bits: int) -> bool:
    rounded = round(number, decimals)
    if bits == 64:
        return rounded == number
    return struct.pack(">f", rounded) == struct.pack(">f", number)
