"""Collects the values over time of all points and registers that transactions read and write."""

# If the slave has a profile, the values of its points are collected; otherwise the numbers in
# registers and bits. A poll is a series of equal requests. A transaction with the same values as
# the last one of its poll is left out at once, because it changes nothing. It is not left out if
# another poll reads or writes some of the same registers or points, because that poll may have
# changed them.
#
# Memory: MAX_SERIES points and registers (value_series.py); at most MAX_OF_POLL registers of one
# poll; the last values of MAX_POLLS polls. `left_out` counts the points and registers beyond these
# limits, up to MAX_LEFT_OUT.

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple, cast

from mbtool.devices.references import write_reference
from mbtool.ledger.answered_reads import AnsweredValues, ValueChanges
from mbtool.modbus import FUNCTIONS
from mbtool.modbus.functions import MASK_WRITE_REGISTER
from mbtool.values.value_series import ValueSeries

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.modbus.tables import Table

MAX_SERIES = 256
"""The most series of values; further points and registers are only counted as left out."""
MAX_OF_POLL = 64
"""The most registers of one poll that get a series."""
MAX_POLLS = 2048
"""The values of at most this many polls are followed."""
MAX_LEFT_OUT = 65_536
"""The names of at most this many points and registers without a series are kept (13 MB), to count
each once. The count stops at this number."""


class SeriesKey(NamedTuple):
    """Identifies the series of one value: the slave (link and unit), and its point or register."""

    link: str
    unit: int
    name: str
    """The name of the point; for a register, its reference, such as `holding 12`."""


class RequestedSpan(NamedTuple):
    """The addresses that a request reads or writes."""

    link: str
    unit: int
    table: Table
    span: range


class _FollowedPoll:
    """The last values of a poll (a series of equal requests), and the series of values that its
    registers or points are added to.
    """

    __slots__ = ("is_shared", "names", "series", "values")

    def __init__(self) -> None:
        self.is_shared = False
        """True if another poll reads or writes some of the same registers or points."""
        self.values: list[int] | None = None
        self.series: list[ValueSeries | None] = []
        self.names: list[str] = []


class Values:
    """Collects the values over time of all points and registers, at most `most` of them."""

    def __init__(self, most: int = MAX_SERIES) -> None:
        self._most = most
        self.series: dict[SeriesKey, ValueSeries] = {}
        self._left_out: set[SeriesKey] = set()
        """The points that have no series."""
        self._registers: dict[tuple[str, int, Table], dict[int, ValueSeries | None]] = {}
        """By link, unit and table: the series of each register or bit; None for one that has none,
        as there are too many others."""
        self._registers_left_out = 0
        self._polls: dict[tuple[object, ...], _FollowedPoll] = {}
        self._first_polls: dict[ValueSeries, _FollowedPoll] = {}
        """The poll that was the first to follow a series."""

    @property
    def left_out(self) -> int:
        """Number of points and registers whose values are not collected, because of `most` or of
        MAX_OF_POLL; MAX_LEFT_OUT stands for this number and more.
        """
        registers = (one for some in self._registers.values() for one in some.values())
        number = len(self._left_out - self.series.keys()) + sum(one is None for one in registers)
        return min(number, MAX_LEFT_OUT)

    @property
    def requests(self) -> list[RequestedSpan]:
        """The ranges that requests have read or written."""
        spans = []
        for link, unit, code, address, quantity, _ in self._polls:
            function = FUNCTIONS.get(cast("int", code))
            if function is not None and function.table is not None and address is not None:
                first = cast("int", address)
                span = range(first, first + max(cast("int", quantity or 1), 1))
                spans.append(
                    RequestedSpan(cast("str", link), cast("int", unit), function.table, span)
                )
        return spans

    def add(self, one: NamedTransaction) -> None:
        function = FUNCTIONS.get(one.function)
        if function is None or function.table is None or not one.took_effect:
            return
        only_writes = function.writes and one.write_address is None
        values = one.request_values if only_writes else one.response_values
        if values is None or one.function == MASK_WRITE_REGISTER:
            return
        key = (one.link, one.unit, one.function, one.address, one.quantity, one.write_address)
        poll = self._poll(key)
        before, poll.values = poll.values, values
        if before == values and not poll.is_shared:
            return
        at_ns = one.response_ns or one.start_ns
        if one.points:
            self._add_points(one, poll, at_ns)
        elif one.address is not None:
            span = range(one.address, one.address + len(values))
            self._follow(poll, RequestedSpan(one.link, one.unit, function.table, span))
            _add_changes(poll.series, values, () if poll.is_shared else before or (), at_ns)

    def add_reads(self, reads: AnsweredValues) -> None:
        """Take many reads of slaves without profiles, with the same result as `add` for each."""
        polls = []
        for index, asked in enumerate(reads.asked):
            link, unit, function, address, quantity = asked
            table = FUNCTIONS[function].table
            if table is not None:
                poll = self._poll((*asked, None))
                span = range(address, address + quantity)
                self._follow(poll, RequestedSpan(link, unit, table, span))
                if any(poll.series):
                    polls.append((poll, index, quantity))
        found: dict[ValueSeries, list[ValueChanges]] = {}
        for poll, index, quantity in polls:
            one = reads[index]
            before, poll.values = poll.values, one.values.last()
            if before is not None and len(before) != quantity:
                before = None
            for place, series in enumerate(poll.series):
                if series is not None:
                    changes = one.values.changes(before, place, every=poll.is_shared)
                    found.setdefault(series, []).append(changes)
        for series, several in found.items():
            _, times_ns, values = several[0] if len(several) == 1 else _joined(several)
            series.add_all(times_ns, values)

    def _poll(self, key: tuple[object, ...]) -> _FollowedPoll:
        poll = self._polls.get(key)
        if poll is None:
            poll = _FollowedPoll()
            if len(self._polls) < MAX_POLLS:
                self._polls[key] = poll
        return poll

    def _follow(self, poll: _FollowedPoll, asked: RequestedSpan) -> None:
        """Make sure that the registers or bits of a poll have their series of values."""
        if len(poll.series) != min(len(asked.span), MAX_OF_POLL):
            poll.series = self._series_of(asked)
            self._note_sharing(poll)

    def _note_sharing(self, poll: _FollowedPoll) -> None:
        """Mark the poll, and another one that follows one of its series."""
        for series in poll.series:
            if series is not None:
                first = self._first_polls.setdefault(series, poll)
                if first is not poll:
                    first.is_shared = poll.is_shared = True

    def _add_points(self, one: NamedTransaction, poll: _FollowedPoll, at_ns: int) -> None:
        names = [point.name for point in one.points]
        if names != poll.names:
            poll.names = names
            poll.series = [self._series(SeriesKey(one.link, one.unit, name)) for name in names]
            self._note_sharing(poll)
        for point, series in zip(one.points, poll.series, strict=True):
            if series is not None:
                series.reference, series.unit = point.reference, point.unit or ""
                series.add(at_ns, point.value, point.text)

    def _series_of(self, asked: RequestedSpan) -> list[ValueSeries | None]:
        """Return the series of values for the registers or bits of a poll, in address order.

        Series are made for at most MAX_OF_POLL. None stands for a register that is not collected,
        as there are too many others.
        """
        link, unit, table, span = asked
        known = self._registers.setdefault((link, unit, table), {})
        for address in span[:MAX_OF_POLL]:
            if len(self.series) >= self._most:
                break
            if known.get(address) is None:
                name = write_reference(None, table, address)
                known[address] = self._series(SeriesKey(link, unit, name), is_bit=table.is_bits)
        if self._registers_left_out < MAX_LEFT_OUT:
            before = len(known)
            for address in span:
                known.setdefault(address, None)
            self._registers_left_out += len(known) - before
        return [*map(known.get, span[:MAX_OF_POLL])]

    def _series(self, key: SeriesKey, *, is_bit: bool = False) -> ValueSeries | None:
        series = self.series.get(key)
        if series is None:
            if len(self.series) >= self._most:
                if len(self._left_out) < MAX_LEFT_OUT:
                    self._left_out.add(key)
                return None
            series = self.series[key] = ValueSeries(key.name, bit=is_bit)
        return series


def _joined(several: Iterable[ValueChanges]) -> ValueChanges:
    """Return the changes of a register that several polls read, in the order of the responses."""
    in_order = sorted(chain.from_iterable(zip(*one, strict=True) for one in several))
    rows, times_ns, values = ([one[place] for one in in_order] for place in range(3))
    return ValueChanges(rows, times_ns, values)


def _add_changes(
    followed: Sequence[ValueSeries | None], values: Sequence[int], before: Sequence[int], at_ns: int
) -> None:
    """Add to the series in `followed` those values that differ from `before`.

    The three sequences are in the order of the poll's addresses. `before` has the values of the
    last response; if its length differs, all values are added.
    """
    if len(before) != len(values):
        before = [-1] * len(values)
    for series, value, last in zip(followed, values, before, strict=False):
        if value != last and series is not None:
            series.add(at_ns, value)
