"""Finds the most probable types of the registers of a device, from their words over time."""

# The input is the words of the registers over time, and which registers a master reads together.
# `segmentation.py` divides each range that was read into values; `number_costs.py` computes how
# well numbers fit a type. The evidence:
#
# - the numbers that the words give, read as each type: do they change smoothly, have few decimals,
#   and begin near 0?
# - if a register carries into another one, or is the sign of another one, the two are cheaper as
#   one number
# - a request whose range begins or ends inside a supposed value is evidence against this value; a
#   request for exactly its registers is evidence for it
# - values of the same kind are often neighbours
# - a device has one order of words, and a few kinds of values: the result for all its registers
#   counts for each of them, ROUNDS times in turn
# - the time of the recording, for clocks
#
# Memory and time: at most MOST_ROWS rows of each range are examined.

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, TypeVar

from mbtool.devices.point_types import PointType
from mbtool.modbus.functions import READ_LIMIT
from mbtool.modbus.tables import Table
from mbtool.values.number_costs import (
    IMPOSSIBLE,
    changes_cost,
    clipped_gain,
    few_decimals,
    flags_cost,
    float_cost,
    noise_cost,
    whole_cost,
)
from mbtool.values.reasons import ValueRole, is_clock, reason_for, role_of
from mbtool.values.segmentation import (
    SHARES,
    Candidate,
    Division,
    Kind,
    Option,
    divide,
    joined_cost,
)
from mbtool.values.word_readings import Order, WordReading, numbers_in

# The code below finds values whose type stays in doubt, however well the words of the registers
# fit it.
#
# The likelihoods of a division compare types that give different numbers. Some types cannot be
# distinguished: a register that never changes may be anything, and one that changes next to a
# register that is always 0 may be the low word of a longer number.

IN_DOUBT = 0.9
"""The likelihood (0 to 1) of a type for which the numbers give too little evidence is lowered to
this."""
_EVIDENT = 2
"""A whole number of two registers that is not certain by itself counts as certain if at least this
many certain ones have the same word order and the same parity of address."""
_LARGE_SPREAD = 4096
"""A register whose values span at least this many may be the low half of a number of two
registers."""
_SMALL = 256
"""A constant register with less than this, beside one of _LARGE_SPREAD, may be the high half of its
number."""
_SIGN_EXTENSION = (0, 0xFFFF)
"""The two values that the high half of a number of two registers has if the number fits the low
half: 0, and FFFFH if the number is negative."""


def doubtful(
    parts: Sequence[tuple[Candidate, Order]],
    columns: Sequence[Sequence[int]],
    edges: Collection[int],
) -> list[bool]:
    """For each value of a range, in order: True if the words cannot settle what it is.

    `parts` has each value with its order of words, and `columns` the words of each register over
    time. `edges` are the places in the range at which some request begins or ends.
    """
    evident = [
        (candidate.at % 2, order)
        for candidate, order in parts
        if candidate.kind is Kind.INT2 and _is_evident(candidate, order, columns)
    ]
    found = []
    for place, (candidate, order) in enumerate(parts):
        beside = [
            other
            for other, edge in (
                (parts[place - 1] if place else None, candidate.at),
                (
                    parts[place + 1] if place + 1 < len(parts) else None,
                    candidate.at + candidate.words,
                ),
            )
            if other is not None and edge not in edges
        ]
        fillings = [
            columns[other.at][0]
            for other, _ in beside
            if all(map(_is_constant, columns[other.at : other.at + other.words]))
            and (other.kind is Kind.WORD or columns[other.at][0] in _SIGN_EXTENSION)
        ]
        if candidate.kind is Kind.WORD:
            found.append(_is_doubtful_word(columns[candidate.at], fillings))
        elif candidate.kind is Kind.INT2:
            vouched = evident.count((candidate.at % 2, order)) >= _EVIDENT
            is_evident = _is_evident(candidate, order, columns)
            moves = not all(map(_is_constant, columns[candidate.at : candidate.at + 2]))
            is_settled = moves and (is_evident or vouched)
            found.append(not is_settled or any(one in _SIGN_EXTENSION for one in fillings))
        else:
            found.append(False)
    return found


def _is_doubtful_word(column: Sequence[int], beside: Sequence[int]) -> bool:
    if _is_constant(column):
        return True
    is_wide = max(column) - min(column) >= _LARGE_SPREAD
    return any(one in _SIGN_EXTENSION or (is_wide and one < _SMALL) for one in beside)


def _is_evident(candidate: Candidate, order: Order, columns: Sequence[Sequence[int]]) -> bool:
    """True if the upper register of a number moves with the lower one, or is its sign."""
    lower, upper = columns[candidate.at : candidate.at + 2][:: 1 if order.is_low_first else -1]
    return not _is_constant(upper) or (upper[0] == 0xFFFF and not _is_constant(lower))


def _is_constant(column: Sequence[int]) -> bool:
    return all(word == column[0] for word in column)


SURE = 0.95
"""A type whose likelihood (0 to 1) is at least this may be shown even if the user does not ask for
types."""
MOST_ROWS = 150
"""The types of a range of registers are judged from at most this many answers, evenly chosen."""
ROUNDS = 3
"""The number of times that types are judged, each time with the shares of kinds and orders that the
time before found in the device."""
ACROSS_A_REQUEST = 12.0
"""The cost in bits of a value at each place inside it where a request begins or ends."""
ASKED_ALONE = 7.0
"""The bits subtracted from the cost of a value of several registers if a request asks for exactly
these."""
CLOCK = 24.0
"""The cost in bits of a number that is the seconds since 1970, within a day of the recording's own
time."""
_FEWEST_DIGITS = 8
"""BCD is in doubt (IN_DOUBT) if a value had fewer different numbers than this."""
ASKED_SINGLY = 8.0
"""The cost in bits of a value for each of its registers that a request asks for alone."""
COUNTS_FROM_BELOW = 6.0
"""The cost in bits of a signed number that is negative and only rises: it is more probably an
unsigned counter."""
_ORDERS = {Order.ABCD: 0.45, Order.CDAB: 0.35, Order.BADC: 0.1, Order.DCBA: 0.1}
_KNOWN_VALUES = 4.0
"""The usual shares of kinds and orders (SHARES, _ORDERS) weigh as much as this many values of the
device when both are averaged."""
_NEVER_USED = (0x7FFF, 0x8000, 0xFFFF)
"""Constants that devices often give for registers without a use; they cost 6 bits."""
Key = TypeVar("Key", bound=StrEnum)


class WordHistory(NamedTuple):
    """The words that a range of registers had over time, as one kind of request shows them."""

    table: Table
    first: int
    times_ns: Sequence[int]
    rows: Sequence[Sequence[int]]
    """The words of all registers of the range, one row for each time."""
    answers: int = 0
    """Number of answers (or writes) that had these registers; 0 if it is that of the rows."""
    is_written: bool = False
    """True if a master writes the registers; False if it reads them."""
    is_asked: bool = True
    """False if the range is put together, and no request asks for just it."""

    @property
    def stop(self) -> int:
        return self.first + (len(self.rows[0]) if self.rows else 0)


@dataclass(frozen=True, slots=True)
class Judged:
    """What the registers from an address on hold."""

    table: Table
    address: int
    reading: WordReading
    words: int
    likelihood: float
    """The probability (0 to 1) that these registers are one value of this size and order."""
    role: ValueRole
    reason: str

    @property
    def is_sure(self) -> bool:
        return self.likelihood >= SURE


class _Range:
    """A range of registers that is judged, with its candidates."""

    def __init__(self, history: WordHistory, span: range, edges: Counter[int], alone: set[range]):
        self.history, self.span = history, span
        rows = list(history.rows)
        times = list(history.times_ns)
        every = -(-len(rows) // MOST_ROWS)
        self.times_ns = times[::every]
        rows = rows[::every]
        begin = span.start - history.first
        self.columns = list(zip(*(row[begin : begin + len(span)] for row in rows), strict=True))
        self.moves = [len(set(column)) > 1 for column in self.columns]
        self._edges, self._alone = edges, alone
        self.candidates = [one for at in range(len(span)) for one in self._candidates(at)]
        self.division = Division([], [])

    def _candidates(self, at: int) -> Iterator[Candidate]:
        options = list(self._single_register_options(at))
        yield Candidate(at, 1, Kind.WORD, options, joined_cost(one.cost for one in options))
        yield from self._texts(at)
        for kind, types in _TYPES.items():
            words = types[0].words
            if at + words > len(self.span):
                continue
            columns = self.columns[at : at + words]
            moves = any(self.moves[at : at + words])
            extra = self._requests_cost(at, words)
            options = [
                Option(WordReading(type_, order), cost + extra)
                for type_ in types
                for order in Order
                if (cost := self._cost(kind, WordReading(type_, order), columns, moves=moves))
                < IMPOSSIBLE
            ]
            if options:
                yield Candidate(at, words, kind, options, 0.0)

    def _requests_cost(self, at: int, words: int) -> float:
        first = self.span.start + at
        cost = sum(
            ACROSS_A_REQUEST * bool(self._edges[edge]) for edge in range(first + 1, first + words)
        )
        singles = sum(self.is_alone(at + word, 1) for word in range(words))
        return cost + ASKED_SINGLY * singles - ASKED_ALONE * self.is_alone(at, words)

    def is_divided(self) -> bool:
        """True if a request asks for four registers, which are not one number."""
        is_four = len(self.span) == 4 and self.is_alone(0, 4)
        return is_four and len(self.division.parts) > 1

    def is_alone(self, at: int, words: int) -> bool:
        """True if a request is for just these registers."""
        first = self.span.start + at
        return range(first, first + words) in self._alone

    def inner_edges(self) -> set[int]:
        """The places in the range at which some request begins or ends."""
        return {at for at, address in enumerate(self.span) if self._edges[address]}

    def _single_register_options(self, at: int) -> Iterator[Option]:
        column = self.columns[at]
        if not self.moves[at]:
            yield Option(WordReading(PointType.UINT16), self._constant_cost(at, column[0]))
            return
        signed = [word - 0x10000 if word & 0x8000 else word for word in column]
        cost = _whole_series_cost(column, 16) - clipped_gain(column, (0xFFFF,))
        yield Option(WordReading(PointType.UINT16), cost)
        if min(signed) < 0:
            cost = 0.5 + _whole_series_cost(signed, 16)
            cost -= clipped_gain(signed, (-0x8000, 0x7FFF))
            if signed == sorted(signed):
                cost += COUNTS_FROM_BELOW
            yield Option(WordReading(PointType.INT16), cost)
        # Examine all rows, because bits may change twice between two samples.
        place = self.span.start + at - self.history.first
        if (cost := flags_cost([row[place] for row in self.history.rows])) < IMPOSSIBLE:
            yield Option(WordReading(PointType.HEX16), cost)
        digits = numbers_in([column], WordReading(PointType.BCD16))
        if digits is not None and max(column) > 9:
            cost = 5.0 + _whole_series_cost([int(one) for one in digits], 14)
            yield Option(WordReading(PointType.BCD16), cost)

    def _constant_cost(self, at: int, word: int) -> float:
        if word == 0:
            before = self.columns[at - 1][0] if at else None
            is_in_a_run = before == 0 and not self.moves[at - 1]
            return 0.5 if is_in_a_run else 3.3
        if word in _NEVER_USED:
            return 6.0
        signed = word - 0x10000 if word & 0x8000 else word
        return min(whole_cost(word, 16), 1.5 + whole_cost(signed, 16))

    def _texts(self, at: int) -> Iterator[Candidate]:
        end = at
        while (
            end < len(self.span)
            and not self.moves[end]
            and _can_be_text(self.columns[end][0])
            and end - at < READ_LIMIT
            and not (end > at and self._edges[self.span.start + end])
            and not (end > at and not self.columns[end - 1][0] & 0xFF)
        ):
            end += 1
        if end - at < 2:
            return
        data = b"".join(self.columns[place][0].to_bytes(2) for place in range(at, end))
        cost = 6.0 + sum(5.2 if chr(one).isalnum() or one in b" \0-" else 9.0 for one in data)
        letters = sum(chr(one).isalnum() for one in data.rstrip(b"\0"))
        if letters * 10 < len(data.rstrip(b"\0")) * 6:
            return
        while end < len(self.span) and not self.moves[end] and self.columns[end][0] in (0, 0x2020):
            if self._edges[self.span.start + end] or end - at >= READ_LIMIT:
                break
            end += 1
            cost += 0.3
        option = Option(WordReading(PointType.STRING), cost)
        yield Candidate(at, end - at, Kind.TEXT, [option], cost)

    def _cost(
        self, kind: Kind, reading: WordReading, columns: Sequence[Sequence[int]], *, moves: bool
    ) -> float:
        """The cost in bits of a number of several registers."""
        some = columns if moves else [column[:1] for column in columns]
        numbers = numbers_in(some, reading)
        if numbers is None:
            return IMPOSSIBLE
        bits = 16 * len(columns)
        if kind in (Kind.FLOAT2, Kind.FLOAT4):
            return float_cost(numbers, bits)
        whole = [int(one) for one in numbers]
        if kind is Kind.BCD2:
            return _whole_series_cost(whole, 27) if moves and max(whole) > 9 else IMPOSSIBLE
        if reading.type in _SIGNED.values() and max(whole) < 1 << (bits - 1):
            return IMPOSSIBLE  # The unsigned type gives the same numbers.
        if bits == 32 and is_clock(whole, self.times_ns):
            return CLOCK
        cost = _whole_series_cost(whole, bits)
        if moves and min(whole) < 0 and whole == sorted(whole):
            cost += COUNTS_FROM_BELOW
        return cost


_TYPES = {
    Kind.INT2: (PointType.INT32, PointType.UINT32),
    Kind.FLOAT2: (PointType.FLOAT32,),
    Kind.BCD2: (PointType.BCD32,),
    Kind.INT4: (PointType.INT64, PointType.UINT64),
    Kind.FLOAT4: (PointType.FLOAT64,),
}


_SIGNED = {PointType.INT32: PointType.UINT32, PointType.INT64: PointType.UINT64}


def _whole_series_cost(numbers: Sequence[int], bits: int) -> float:
    return whole_cost(numbers[0], bits) + changes_cost(numbers, bits) + noise_cost(numbers, bits)


def _can_be_text(word: int) -> bool:
    high, low = divmod(word, 256)
    return 0x20 <= high < 0x7F and (0x20 <= low < 0x7F or low == 0)


def judge(histories: Sequence[WordHistory]) -> list[Judged]:
    """Judge what the registers of one device hold, in the order of tables and addresses.

    Each register that some history has is in exactly one value. Never raises.
    """
    ranges = _ranges([one for one in histories if one.rows and len(one.rows[0])])
    shares: Mapping[Kind, float] = SHARES
    orders: Mapping[Order, float] = _ORDERS
    for _ in range(ROUNDS):
        found: dict[Kind, float] = dict.fromkeys(Kind, 0.0)
        found_orders: dict[Order, float] = dict.fromkeys(Order, 0.0)
        for one in ranges:
            priced = [_with_order_costs(candidate, orders) for candidate in one.candidates]
            one.division = divide(len(one.span), priced, shares)
            for candidate, likelihood in one.division.likelihoods:
                found[candidate.kind] += likelihood
                if candidate.kind in _TYPES and likelihood > 0.01:
                    for order, share in _order_shares(candidate).items():
                        found_orders[order] += likelihood * share
        shares = _pool_shares(SHARES, found)
        orders = _pool_shares(_ORDERS, found_orders)
    is_signed = any(_goes_below_zero(one) for one in ranges)
    judged = [part for one in ranges for part in _judged_values(one, is_signed=is_signed)]
    return sorted(judged, key=lambda one: (list(Table).index(one.table), one.address))


def _pool_shares(usual: Mapping[Key, float], found: Mapping[Key, float]) -> dict[Key, float]:
    total = sum(found.values()) + _KNOWN_VALUES
    return {
        key: (share * _KNOWN_VALUES + found.get(key, 0.0)) / total for key, share in usual.items()
    }


def _with_order_costs(candidate: Candidate, orders: Mapping[Order, float]) -> Candidate:
    """Add the costs of the orders to a candidate of several registers."""
    if candidate.kind not in _TYPES:
        return candidate
    options = [
        Option(one.reading, one.cost - math.log2(orders[one.reading.order]))
        for one in candidate.options
    ]
    return candidate._replace(options=options, cost=joined_cost(one.cost for one in options))


def _order_shares(candidate: Candidate) -> dict[Order, float]:
    shares: dict[Order, float] = dict.fromkeys(Order, 0.0)
    for one in candidate.options:
        shares[one.reading.order] += 2.0 ** (candidate.cost - one.cost)
    return shares


def _ranges(histories: Sequence[WordHistory]) -> list[_Range]:
    """Choose the ranges to judge: each register is in one of them.

    Reads count before writes, what was seen often before what was not, and long ranges before
    short ones, because they show best which registers form one value.
    """
    edges: dict[Table, Counter[int]] = {}
    alone: dict[Table, set[range]] = {}
    for one in histories:
        edges.setdefault(one.table, Counter()).update((one.first, one.stop))
        if one.is_asked:
            alone.setdefault(one.table, set()).add(range(one.first, one.stop))
    in_order = sorted(
        histories,
        key=lambda one: (one.is_written, len(one.rows) < 4, one.first - one.stop, one.first),
    )
    taken: dict[Table, set[int]] = {}
    ranges = []
    for one in in_order:
        own = taken.setdefault(one.table, set())
        for span in _free(range(one.first, one.stop), own):
            ranges.append(_Range(one, span, edges[one.table], alone.get(one.table, set())))
        own.update(range(one.first, one.stop))
    return ranges


def _free(span: range, taken: Collection[int]) -> Iterator[range]:
    """Give the parts of a span that are not taken."""
    start = None
    for at in span:
        if at in taken:
            if start is not None:
                yield range(start, at)
            start = None
        elif start is None:
            start = at
    if start is not None:
        yield range(start, span.stop)


def _judged_values(one: _Range, *, is_signed: bool) -> Iterator[Judged]:
    """Give the values of a range. With `is_signed`, whole numbers of the device may be negative."""
    before: WordReading | None = None
    doubts = doubtful(
        [(candidate, _best(candidate).order) for candidate, _ in one.division.parts],
        one.columns,
        one.inner_edges(),
    )
    for (candidate, likelihood), is_in_doubt in zip(one.division.parts, doubts, strict=True):
        reading = _best(candidate)
        columns = one.columns[candidate.at : candidate.at + candidate.words]
        address = one.span.start + candidate.at
        if candidate.kind in _TYPES:
            likelihood *= _order_shares(candidate)[reading.order]
        elif one.moves[candidate.at]:
            likelihood *= _type_share(candidate, reading)
        numbers: Sequence[float] = ()
        role = ValueRole.TEXT
        if candidate.kind is not Kind.TEXT:
            numbers = numbers_in(columns, reading) or ()
            if not is_signed and min(numbers, default=0) >= 0:
                reading = WordReading(_SIGNED.get(reading.type, reading.type), reading.order)
            role = role_of(numbers, one.times_ns, reading)
        is_alone = one.is_alone(candidate.at, candidate.words)
        is_in_doubt = is_in_doubt or _is_in_doubt(
            reading,
            numbers,
            is_divided=one.is_divided(),
            is_vouched=is_alone or before == reading,
        )
        reason = reason_for(
            reading,
            columns,
            numbers,
            role,
            is_alone=is_alone,
            is_beside=before == reading,
            is_written=one.history.is_written,
            count=one.history.answers or len(one.history.rows),
        )
        yield Judged(
            table=one.history.table,
            address=address,
            reading=reading,
            words=candidate.words,
            likelihood=min(likelihood, IN_DOUBT) if is_in_doubt else likelihood,
            role=role,
            reason=reason,
        )
        before = reading


def _is_in_doubt(
    reading: WordReading, numbers: Sequence[float], *, is_divided: bool, is_vouched: bool
) -> bool:
    """True if numbers are too few, or of a kind too rare, to be sure of them.

    With `is_divided`, a request asked for just these registers and others, as if they were one.
    With `is_vouched`, a request asked for just these, or another of their kind stands before them.
    """
    if reading.type.is_bcd:
        return len(set(numbers)) < _FEWEST_DIGITS
    if reading.type.is_float and len(set(numbers)) == 1:
        is_plain = few_decimals(numbers, 16 * reading.words) is not None
        return is_divided or not (is_plain and is_vouched)
    return False


def _type_share(candidate: Candidate, reading: WordReading) -> float:
    """How likely a register that moves is of this type, if it is a value of its own.

    uint16 and hex16 are the same number.
    """
    same = {PointType.UINT16, PointType.HEX16}
    types = same if reading.type in same else {reading.type}
    return sum(
        (
            math.exp2(candidate.cost - one.cost)
            for one in candidate.options
            if one.reading.type in types
        ),
        0.0,
    )


def _best(candidate: Candidate) -> WordReading:
    return min(candidate.options, key=lambda one: one.cost).reading


def _goes_below_zero(one: _Range) -> bool:
    """True if the range has a whole number of several registers that is negative at times."""
    return any(
        candidate.kind in (Kind.INT2, Kind.INT4)
        and min(
            numbers_in(one.columns[candidate.at : candidate.at + candidate.words], _best(candidate))
            or (0,)
        )
        < 0
        for candidate, _ in one.division.parts
    )
