"""Finds the registers that hold a number which somebody saw on a display."""

# An idea is one way to read one register or several: a type, an order of words, and a decimal
# scale. A sighting is a number that the user saw on a display. Each idea is compared with the
# sighting:
#
# - with the time of the sighting: with the register's values right before and right after this
#   time; a display may lag by one usual step of the value;
# - without: with the values of the whole recording, and a little beyond them, since the user may
#   have seen the number shortly before or after it.
#
# If a register never had the number in the recording, it is less than half likely, even if no other
# register comes near: a user seldom saw the number just before or after the recording.
#
# The more values a register takes, the less probable is each of them. So a constant that matches by
# chance and a noisy value compete fairly, and a second sighting decides between them. The
# probabilities of several sightings of one display are multiplied.
#
# The prior probability of an idea comes from `judging.py`. If the user names several numbers, each
# register can be at most one of them, so the probabilities are balanced (Sinkhorn): a register that
# explains one number well is less probable for the others. Numbers that are named one after the
# other, such as three phases, often lie at equal distances in the map. So a distance that many
# pairs of neighbours have makes other pairs with this distance more probable. NOWHERE is the
# probability that a number is in no register.

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import nlargest
from itertools import pairwise, product
from operator import itemgetter
from statistics import median, pstdev
from typing import NamedTuple

from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import Table
from mbtool.values.judging import Judged, WordHistory, judge
from mbtool.values.word_readings import Order, WordReading, numbers_in

MOST_SHOWN = 100
"""At most this many places are returned for each wanted number."""
LIKELY = 0.5
"""A place is shown as the answer if its probability (0 to 1) is at least this."""
NOWHERE = 1e-5
"""The greatest probability (0 to 1) of a sighting if the number is in no register."""
_NOWHERE_OF_ITS_SIZE = 0.01
"""The probability of a sighting if the number is in no register is at most this times the relative
tolerance of the number: a number of many digits seldom equals a register by chance."""
_UNJUDGED = 0.02
"""The probability (0 to 1), before any sighting, of a type and place that judging.py does not
favour."""
_FLOAT_SCALES = {0: 0.9, -3: 0.04, 3: 0.04, -2: 0.01, 2: 0.01}
"""The share (0 to 1) of floats in registers that have this scale, by its power of ten."""
_WHOLE_SCALES = {
    0: 0.32,
    -1: 0.3,
    -2: 0.18,
    -3: 0.12,
    -4: 0.02,
    -6: 0.005,
    1: 0.03,
    2: 0.01,
    3: 0.015,
}
"""The share (0 to 1) of whole numbers in registers that have this scale, by its power of ten."""
_FACTORS = {power: float(f"1e{-power}") for power in (0, -1, -2, -3, -4, -6, 1, 2, 3)}
_UNSEEN_DIGIT = 1.4
"""Each decimal digit that a register has more than the display shows divides the probability by e
to the power of this."""
_DRIFT, _DRIFT_OF_CONSTANT = 0.004, 0.001
"""The distance by which the number on the display may lie outside the recorded values, as a share
(0 to 1) of the register's value: for a register that changed in the recording, and for one that did
not. Three times the standard deviation of its values is added."""
_BETWEEN = 1e-3
"""The factor (0 to 1) on the probability of a register that has whole numbers, if the number seen
is between two of them."""
_REACH = 8
"""A register is tried for a number if the number is at most this many times its tolerance, and this
many times the drift, outside of the register's values."""
_NEGLIGIBLE = 1e-9
"""A place is dropped if its probability is less than this share (0 to 1) of NOWHERE, or of the best
place."""
_MOST_IDEAS = 200
"""For each wanted number, at most this many places are kept, the most probable ones."""
_ROUNDS = 12
"""The number of rounds in which the places of several numbers are weighed against each other."""
_STRIDE_ROUNDS = 3
"""The number of rounds in which equal distances between the places of several numbers make these
places more probable."""
_OUTSIDE = 0.45
"""The factor (0 to 1) on the probability of a register that never had the number in the
recording."""
_MOST_STRIDES = 12
"""Equal distances are looked for among at most this many places of each number, the most probable
ones."""


class Sighting(NamedTuple):
    """A number that was seen on a display."""

    value: float
    tolerance: float
    """Half the width of the range in which the true value lies."""
    at_ns: int | None = None
    """When it was seen (UTC ns); None if that is not known."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """A display whose register is looked for."""

    name: str
    sightings: Sequence[Sighting]
    unit: str = ""


@dataclass(frozen=True, slots=True)
class WordsOfSlave:
    """The words of one slave's registers."""

    slave: str
    histories: Sequence[WordHistory]
    exact: Mapping[int, Sequence[WordHistory]] = field(default_factory=dict)
    """By time of a sighting: the rows right before and right after it, of every kind of request."""


@dataclass(frozen=True, slots=True)
class FoundPlace:
    """A place that may hold a number, and how probably it does."""

    slave: str
    table: Table
    address: int
    reading: WordReading
    power: int
    """The number is that of the registers times ten to this power."""
    likelihood: float
    low: float
    high: float
    """The least and the greatest value in the recording, with the scale."""
    outside: tuple[float, ...] = ()
    """The numbers seen that the registers never had in the recording."""

    @property
    def scale(self) -> float:
        return float(f"1e{self.power}")


class _Idea(NamedTuple):
    """A way to read some registers of a slave."""

    slave: WordsOfSlave
    history: WordHistory
    address: int
    reading: WordReading
    weight: float
    numbers: Sequence[float]
    low: float
    high: float
    spread: float
    """The standard deviation of the numbers."""
    step: float
    """The usual change from one row to the next."""
    drift: float
    """The distance that the value may have from those of the recording, shortly before or after
    it."""
    middle: float
    reach: float
    """No value that is farther from the middle than this is looked at."""


_Key = tuple[int, int]
"""The index of an idea, and the power of ten of its scale."""
_Shares = dict[_Key, float]


def find(wanted: Sequence[Wanted], slaves: Sequence[WordsOfSlave]) -> list[list[FoundPlace]]:
    """Return the places of each wanted number, the most probable first."""
    ideas = [idea for slave in slaves for idea in _ideas(slave)]
    scores = [_place_scores(one, ideas) for one in wanted]
    nowhere = [_probability_if_absent(one) for one in wanted]
    for _ in range(_STRIDE_ROUNDS if len(wanted) > 2 else 0):
        scores = _with_strides(scores, _balanced_shares(scores, nowhere, ideas), ideas)
    shares = _balanced_shares(scores, nowhere, ideas)
    return [
        sorted(
            (
                _place(one, ideas[place], power, share)
                for (place, power), share in nlargest(
                    MOST_SHOWN, own.items(), key=lambda each: each[1]
                )
            ),
            key=lambda each: -each.likelihood,
        )
        for one, own in zip(wanted, shares, strict=True)
    ]


def _place(one: Wanted, idea: _Idea, power: int, share: float) -> FoundPlace:
    low, high = scaled(idea.low, power), scaled(idea.high, power)
    lag = 2 * scaled(idea.step, power)
    outside = [
        seen.value
        for seen in one.sightings
        if max(low - seen.value, seen.value - high)
        > 1.001 * seen.tolerance + (0 if seen.at_ns is None else lag)
    ]
    return FoundPlace(
        slave=idea.slave.slave,
        table=idea.history.table,
        address=idea.address,
        reading=idea.reading,
        power=power,
        likelihood=share * (_OUTSIDE if outside else 1.0),
        low=low,
        high=high,
        outside=tuple(dict.fromkeys(outside)),
    )


def _probability_if_absent(one: Wanted) -> float:
    """The probability (0 to 1) of what was seen if it is in no register."""
    finest = min(
        (seen.tolerance / abs(seen.value) for seen in one.sightings if seen.value), default=1.0
    )
    return max(min(NOWHERE, _NOWHERE_OF_ITS_SIZE * finest), NOWHERE * _NEGLIGIBLE)


def _place_scores(one: Wanted, ideas: Sequence[_Idea]) -> _Shares:
    """How probable each idea makes what was seen, times how probable the idea is by itself."""
    finest = min(seen.tolerance for seen in one.sightings)
    found: _Shares = {}
    for power, factor in _FACTORS.items():
        # A register seldom has more digits than the display shows.
        unseen = max(math.log10(2 * finest * factor) - 1, 0) if finest > 0 else 0
        less = math.exp(-_UNSEEN_DIGIT * unseen)
        sightings = [
            Sighting(seen.value * factor, seen.tolerance * factor, seen.at_ns)
            for seen in one.sightings
        ]
        reach = _REACH * max(seen.tolerance for seen in sightings)
        for place, idea in enumerate(ideas):
            if any(abs(seen.value - idea.middle) > idea.reach + reach for seen in sightings):
                continue
            is_float = idea.reading.type.is_float
            share = (_FLOAT_SCALES if is_float else _WHOLE_SCALES).get(power)
            if share is None:
                continue
            probability = share * idea.weight * (1.0 if is_float else less)
            for seen in sightings:
                if not is_float and abs(seen.value - round(seen.value)) > seen.tolerance * 1.001:
                    probability *= _BETWEEN
                probability *= _probability(seen, idea)
                if probability < _NEGLIGIBLE * NOWHERE:
                    break
            else:
                found[place, power] = probability
    best = nlargest(_MOST_IDEAS, found.items(), key=lambda each: each[1])
    return {key: one for key, one in best if one > best[0][1] * _NEGLIGIBLE}


def scaled(number: float, power: int) -> float:
    """The number times ten to a power, without binary noise in the last digits."""
    return number * float(10**power) if power >= 0 else number / float(10**-power)


def _ideas(slave: WordsOfSlave) -> Iterator[_Idea]:
    """Give the ways to read the registers of a slave, each with its weight."""
    judged = {(one.table, one.address): one for one in judge(slave.histories)}
    inside = {
        (one.table, at): one
        for one in judged.values()
        for at in range(one.address, one.address + one.words)
    }
    done: set[tuple[Table, int, WordReading]] = set()
    in_order = sorted(slave.histories, key=lambda one: (one.is_written, -len(one.rows)))
    found_at: dict[tuple[Table, int], list[tuple[WordReading, Sequence[float]]]] = {}
    for history in in_order:
        for address in range(history.first, history.stop):
            found = found_at.setdefault((history.table, address), [])
            merged: dict[int, WordHistory] = {}
            own = inside.get((history.table, address))
            for reading in sorted(_READINGS, key=lambda one: not _is_judged(one, own, address)):
                if address + reading.words > history.stop:
                    continue
                if (history.table, address, reading) in done:
                    continue
                own_history = merged.get(reading.words)
                if own_history is None:
                    own_history = _history_of(in_order, history, address, reading.words)
                    merged[reading.words] = own_history
                columns = list(zip(*own_history.rows, strict=True))
                numbers = numbers_in(columns, reading)
                if numbers is None or not _is_plausible(numbers, reading):
                    continue
                if _is_shorter(numbers, reading) and not _is_judged(reading, own, address):
                    continue
                if any(other.words == reading.words and same == numbers for other, same in found):
                    continue
                done.add((history.table, address, reading))
                found.append((reading, numbers))
                weight = _weight(reading, own, address)
                low, high, spread = min(numbers), max(numbers), pstdev(numbers)
                drift = 3 * spread + (_DRIFT if spread else _DRIFT_OF_CONSTANT) * max(
                    abs(low), abs(high)
                )
                yield _Idea(
                    slave=slave,
                    history=own_history,
                    address=address,
                    reading=reading,
                    weight=weight,
                    numbers=numbers,
                    low=low,
                    high=high,
                    spread=spread,
                    step=_step(numbers),
                    drift=drift,
                    middle=(low + high) / 2,
                    reach=(high - low) / 2 + _REACH * drift,
                )


def _history_of(
    histories: Sequence[WordHistory], like: WordHistory, address: int, words: int
) -> WordHistory:
    """Return the words of some registers, from all requests that read (or write) them."""
    rows = [
        (at_ns, row[address - one.first : address - one.first + words])
        for one in histories
        if _covers(one, like, address, words)
        for at_ns, row in zip(one.times_ns, one.rows, strict=True)
    ]
    rows.sort(key=itemgetter(0))
    times, some = zip(*rows, strict=True)
    return like._replace(first=address, times_ns=times, rows=some)


def _covers(one: WordHistory, like: WordHistory, address: int, words: int) -> bool:
    """True if a history has some registers, and is of the table and kind of another one."""
    return (
        one.table is like.table
        and one.is_written == like.is_written
        and one.first <= address
        and address + words <= one.stop
    )


_READINGS = (
    WordReading(PointType.UINT16), WordReading(PointType.INT16), WordReading(PointType.BCD16),
    *(WordReading(type_, order)
      for type_ in (PointType.INT32, PointType.UINT32, PointType.FLOAT32, PointType.BCD32,
                    PointType.INT64, PointType.FLOAT64)
      for order in Order),
)  # fmt: skip


def _is_plausible(numbers: Sequence[float], reading: WordReading) -> bool:
    if reading.type.is_float:
        return all(math.isfinite(one) and (one == 0 or 1e-6 < abs(one) < 1e12) for one in numbers)
    if reading.type.is_bcd:
        return max(numbers) > 9
    return all(abs(one) < 1 << 53 for one in numbers)


def _is_shorter(numbers: Sequence[float], reading: WordReading) -> bool:
    """True if fewer registers hold the same whole numbers."""
    if reading.type not in (PointType.INT32, PointType.UINT32, PointType.INT64):
        return False
    least, most = (-0x8000, 0xFFFF) if reading.words == 2 else (-0x80000000, 0xFFFFFFFF)
    low, high = min(numbers), max(numbers)
    return least <= low and high <= most and (low >= 0 or high <= -least - 1)


def _is_judged(reading: WordReading, judged: Judged | None, address: int) -> bool:
    if judged is None or judged.address != address:
        return False
    same = _SAME.get(judged.reading.type, judged.reading.type)
    return _SAME.get(reading.type, reading.type) is same and reading.order is judged.reading.order


_SAME = {
    PointType.HEX16: PointType.UINT16,
    PointType.UINT32: PointType.INT32,
    PointType.UINT64: PointType.INT64,
}


def _weight(reading: WordReading, judged: Judged | None, address: int) -> float:
    if judged is None:
        return _UNJUDGED
    if _is_judged(reading, judged, address):
        return judged.likelihood
    return _UNJUDGED * max(1 - judged.likelihood, 0.05)


def _step(numbers: Sequence[float]) -> float:
    steps = [abs(now - before) for before, now in pairwise(numbers)]
    return median(steps) if steps else 0.0


def _probability(seen: Sighting, idea: _Idea) -> float:
    """The probability that a display shows what was seen, if it shows these registers.

    The number that was seen is in the unit of the registers.
    """
    if seen.at_ns is None:
        return _probability_in_history(seen.value, seen.tolerance, idea)
    return _probability_at_time(seen.value, seen.tolerance, idea, seen.at_ns)


def _probability_in_history(value: float, tolerance: float, idea: _Idea) -> float:
    """The probability of a value seen at some time during the recording, or near it."""
    beyond = max(idea.low - value, value - idea.high, 0.0)
    drift = idea.drift + tolerance
    near = tolerance + 0.3 * idea.spread
    hits = sum(abs(number - value) <= near for number in idea.numbers) / len(idea.numbers)
    inside = 0.8 * hits * min(1.0, tolerance / near)
    outside = 0.2 * min(1.0, tolerance / drift) * math.exp(-beyond / drift)
    return inside + outside


def _probability_at_time(value: float, tolerance: float, idea: _Idea, at_ns: int) -> float:
    """The probability of a value seen at a time."""
    numbers = _numbers_around(idea, at_ns)
    if not numbers:
        return _probability_in_history(value, tolerance, idea) * 0.5
    low, high = min(numbers), max(numbers)
    beyond = max(low - value, value - high, 0.0)
    if beyond <= tolerance * 1.001:
        return min(1.0, 2 * tolerance / ((high - low) + 2 * tolerance))
    drift = 2 * idea.step + tolerance
    share = min(1.0, tolerance / (drift + (high - low)))
    return 0.3 * share * math.exp(-(beyond - tolerance) / drift)


def _numbers_around(idea: _Idea, at_ns: int) -> Sequence[float]:
    """The numbers right before and after a time."""
    exact = idea.slave.exact.get(at_ns, ())
    words = idea.reading.words
    if any(_covers(one, idea.history, idea.address, words) for one in exact):
        history = _history_of(exact, idea.history, idea.address, words)
        numbers = numbers_in(list(zip(*history.rows, strict=True)), idea.reading) or ()
    else:
        history, numbers = idea.history, idea.numbers
    after = bisect_right(history.times_ns, at_ns)
    return numbers[max(after - 1, 0) : after + 1]


def _with_strides(
    scores: Sequence[_Shares], shares: Sequence[_Shares], ideas: Sequence[_Idea]
) -> list[_Shares]:
    """Return the scores, better for places at a distance that many neighbours in the list have."""
    likely = [sorted(own.items(), key=lambda each: -each[1])[:_MOST_STRIDES] for own in shares]
    strides: dict[int, float] = {}
    for before, after in pairwise(likely):
        for (key, share), (other, other_share) in product(before, after):
            if _are_alike(ideas, key, other):
                stride = ideas[other[0]].address - ideas[key[0]].address
                strides[stride] = strides.get(stride, 0.0) + share * other_share
    strides.pop(0, None)
    total = len(scores) - 1
    places = len({(idea.history.table, idea.address) for idea in ideas})
    better = []
    for number, own in enumerate(scores):
        beside = [
            (likely[other], sign)
            for other, sign in ((number - 1, 1), (number + 1, -1))
            if 0 <= other < len(scores)
        ]
        changed = dict(own)
        for key, share in shares[number].items():
            for others, sign in beside:
                support = sum(
                    other_share
                    * strides.get(sign * (ideas[key[0]].address - ideas[other[0]].address), 0.0)
                    for other, other_share in others
                    if _are_alike(ideas, key, other)
                )
                # A pair does not support its own distance.
                support = max(support - share, 0.0) / total
                changed[key] *= 0.5 + 0.5 * places * support
        better.append(changed)
    return better


def _are_alike(ideas: Sequence[_Idea], key: _Key, other: _Key) -> bool:
    one, two = ideas[key[0]], ideas[other[0]]
    return (
        key[1] == other[1]
        and one.reading == two.reading
        and one.slave is two.slave
        and one.history.table is two.history.table
    )


def _balanced_shares(
    scores: Sequence[_Shares], nowhere: Sequence[float], ideas: Sequence[_Idea]
) -> list[_Shares]:
    """Make probabilities of scores, so that no register is much more than one number."""
    shares: list[_Shares] = [dict(own) for own in scores]
    nowhere = list(nowhere)
    registers = {place: _registers(ideas[place]) for own in scores for place, _ in own}
    for left in reversed(range(_ROUNDS if len(scores) > 1 else 1)):
        for number, own in enumerate(shares):
            total = sum(own.values()) + nowhere[number]
            shares[number] = {key: share / total for key, share in own.items()}
            nowhere[number] /= total
        if not left:
            break
        taken: dict[tuple[int, Table, int], float] = {}
        for own in shares:
            for (place, _), share in own.items():
                for one in registers[place]:
                    taken[one] = taken.get(one, 0.0) + share
        rivals = {place: max(1.0, *map(taken.__getitem__, own)) for place, own in registers.items()}
        for number, own in enumerate(shares):
            shares[number] = {key: share / rivals[key[0]] for key, share in own.items()}
    return shares


def _registers(idea: _Idea) -> list[tuple[int, Table, int]]:
    return [
        (id(idea.slave), idea.history.table, address)
        for address in range(idea.address, idea.address + idea.reading.words)
    ]


@dataclass(frozen=True, slots=True)
class ChangedPlace:
    """A value that was another one after some time than before."""

    slave: str
    judged: Judged
    before: Sequence[float]
    """All numbers that it had before, in their order; for a text none."""
    after: Sequence[float]
    likelihood: float
    """The probability (0 to 1) that this place is the one setting that was changed."""
    is_written: bool
    """True if a master wrote this place."""


def find_changed(slaves: Sequence[WordsOfSlave], begin_ns: int, end_ns: int) -> list[ChangedPlace]:
    """Find the setting that was changed between two times, the most probable value first.

    A setting is the same all the time before, another one all the time after, and does not move by
    itself.
    """
    found = []
    for slave in slaves:
        written = {
            (one.table, at)
            for one in slave.histories
            if one.is_written
            for at in range(one.first, one.stop)
        }
        for judged in judge(slave.histories):
            before, after = _numbers_before_and_after(slave, judged, begin_ns, end_ns)
            if not before or not after or before[-1] == after[0] == after[-1]:
                continue
            is_written = any(
                (judged.table, at) in written
                for at in range(judged.address, judged.address + judged.words)
            )
            weight = _setting_weight(before, after) * (_WRITTEN if is_written else 1.0)
            found.append(ChangedPlace(slave.slave, judged, before, after, weight, is_written))
    total = sum(one.likelihood for one in found) + _SETTING_UNSEEN
    found = [replace(one, likelihood=one.likelihood / total) for one in found]
    return sorted(found, key=lambda one: -one.likelihood)


def _setting_weight(before: Sequence[float], after: Sequence[float]) -> float:
    moved, moves = len(set(before)) - 1, len(set(after)) - 1
    if not moved and not moves:
        return 1.0
    low, high = min(before), max(before)
    is_outside = all(one < low or one > high for one in after)
    return (0.02 if is_outside else 0.001) / (1 + moved + moves)


_WRITTEN = 20.0
"""The factor on the weight of a place that changed, if a master wrote it: writes are how settings
change."""
_SETTING_UNSEEN = 0.01
"""The weight of the case that no register of the recording has the setting; the weights of all
places and this one are scaled to 1."""


def _numbers_before_and_after(
    slave: WordsOfSlave, judged: Judged, begin_ns: int, end_ns: int
) -> tuple[list[float], list[float]]:
    """The numbers of a value before a time, and after another one."""
    before: list[tuple[int, float]] = []
    after: list[tuple[int, float]] = []
    for history in slave.histories:
        if history.table is not judged.table or history.is_written:
            continue
        if not history.first <= judged.address <= history.stop - judged.words:
            continue
        at = judged.address - history.first
        columns = [[row[at + word] for row in history.rows] for word in range(judged.words)]
        numbers = _as_numbers(columns, judged.reading)
        for time_ns, number in zip(history.times_ns, numbers, strict=True):
            if time_ns <= begin_ns:
                before.append((time_ns, number))
            elif time_ns >= end_ns:
                after.append((time_ns, number))
    return [one for _, one in sorted(before)], [one for _, one in sorted(after)]


def _as_numbers(columns: Sequence[Sequence[int]], reading: WordReading) -> Sequence[float]:
    if reading.type is not PointType.STRING and (found := numbers_in(columns, reading)) is not None:
        return found
    # A text is compared as one long number.
    return [
        sum(word << 16 * place for place, word in enumerate(row))
        for row in zip(*columns, strict=True)
    ]
