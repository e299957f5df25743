"""Joins the series of registers into series of numbers where their type is sure enough."""

# The series of a register has its changes. At each time at which a register of a range changes, the
# registers of the range are one row. The rows are judged like answers (judging.py). If samples of a
# series were dropped at its limit, it is not known which changes came together, so its register is
# not joined.
#
# Only registers that no profile names are joined. The name of a joined series ends in MARK.

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from mbtool.devices.point_types import PointType
from mbtool.devices.references import write_reference
from mbtool.modbus.tables import Table
from mbtool.values.judging import Judged, WordHistory, judge
from mbtool.values.value_series import ValueSeries
from mbtool.values.values import RequestedSpan, SeriesKey
from mbtool.values.word_readings import numbers_in

MARK = "?"
"""Stands behind a value whose type is guessed."""
_TABLES = {
    write_reference(None, table, 0).split()[0]: table
    for table in (Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS)
}


class _Register(NamedTuple):
    address: int
    key: SeriesKey
    series: ValueSeries


def with_guesses(
    series: Mapping[SeriesKey, ValueSeries], requests: Sequence[RequestedSpan] = ()
) -> dict[SeriesKey, ValueSeries]:
    """Return the series, with those of several registers joined that are surely one number.

    A joined series stands in the place of its first register. `requests` are the ranges that were
    read or written, as far as they are known; no value begins or ends inside of one.
    """
    joined: dict[SeriesKey, tuple[SeriesKey, ValueSeries]] = {}
    gone: set[SeriesKey] = set()
    for registers in _ranges(series):
        first = registers[0]
        asked = [
            one.span
            for one in requests
            if (one.link, one.unit) == (first.key.link, first.key.unit)
            and first.key.name.startswith(write_reference(None, one.table, 0)[:-1])
        ]
        for judged, own, history in _judged_numbers(registers, asked):
            made = _series_of(judged, own, history)
            if made is not None:
                joined[own[0].key] = made
                gone.update(one.key for one in own)
    if not joined:
        return dict(series)
    found: dict[SeriesKey, ValueSeries] = {}
    for key, one in series.items():
        if key in joined:
            new_key, new = joined[key]
            found[new_key] = new
        elif key not in gone:
            found[key] = one
    return found


def guessed_name(judged: Judged) -> str:
    """The name of a value whose type is guessed: `holding 4..5 float32 CDAB ?`."""
    place = write_reference(None, judged.table, judged.address, judged.words)
    order = f" {judged.reading.order}" if judged.words > 1 else ""
    return f"{place} {judged.reading.type}{order} {MARK}"


def is_shown(judged: Judged) -> bool:
    """True if a guess is sure enough to be shown in place of the words, and says more than they."""
    numbers = judged.reading.type not in (PointType.STRING, PointType.UINT16, PointType.HEX16)
    return judged.is_sure and numbers


def _ranges(series: Mapping[SeriesKey, ValueSeries]) -> Iterator[list[_Register]]:
    """Give the registers side by side that no profile names, range by range."""
    slaves: dict[tuple[str, int, Table], list[_Register]] = {}
    for key, one in series.items():
        word, _, number = key.name.partition(" ")
        table = _TABLES.get(word)
        is_whole = one.samples and len(one.samples) == one.changes + 1 and not one.texts
        if table is not None and number.isdigit() and is_whole and not one.bit:
            slaves.setdefault((key.link, key.unit, table), []).append(
                _Register(int(number), key, one)
            )
    for registers in slaves.values():
        registers.sort(key=lambda one: one.address)
        start = 0
        for at in range(1, len(registers) + 1):
            if at == len(registers) or registers[at].address != registers[at - 1].address + 1:
                yield registers[start:at]
                start = at


def _judged_numbers(
    registers: Sequence[_Register], asked: Sequence[range]
) -> Iterator[tuple[Judged, Sequence[_Register], WordHistory]]:
    """Give the numbers of a range that are sure, each with its registers and their words."""
    history = _history(registers)
    if len(history.rows) < 2:
        return
    edges = [
        WordHistory(history.table, span.start, [0], [(0,) * len(span)])
        for span in asked
        if history.first <= span.start and span.stop <= history.stop
    ]
    for judged in judge([history, *edges]):
        if is_shown(judged):
            begin = judged.address - registers[0].address
            yield judged, registers[begin : begin + judged.words], history


def _history(registers: Sequence[_Register]) -> WordHistory:
    """The words of a range at each time at which one of them changes."""
    # Before a register is first seen, use its first value.
    changes: dict[int, list[tuple[int, int]]] = {}
    for place, one in enumerate(registers):
        for sample in one.series.samples:
            changes.setdefault(sample.ts_ns, []).append((place, int(sample.value)))
    row = [int(one.series.samples[0].value) for one in registers]
    rows, times = [], []
    for ts_ns in sorted(changes):
        for place, value in changes[ts_ns]:
            row[place] = value
        rows.append(tuple(row))
        times.append(ts_ns)
    word = registers[0].key.name.partition(" ")[0]
    return WordHistory(_TABLES[word], registers[0].address, times, rows, is_asked=False)


def _series_of(
    judged: Judged, registers: Sequence[_Register], history: WordHistory
) -> tuple[SeriesKey, ValueSeries] | None:
    """The series of a number; None if a row that was not judged holds no number of its type."""
    name = guessed_name(judged)
    first = registers[0].key
    made = ValueSeries(name)
    begin = judged.address - history.first
    columns = [[row[begin + word] for row in history.rows] for word in range(judged.words)]
    numbers = numbers_in(columns, judged.reading)
    if numbers is None:
        return None
    for ts_ns, number in zip(history.times_ns, numbers, strict=True):
        if math.isfinite(number):
            made.add(ts_ns, _rounded_number(number, judged.reading.type))
    return SeriesKey(first.link, first.unit, name), made


def _rounded_number(number: float, type_: PointType) -> float:
    """The number without digits that a 32-bit float does not have."""
    return float(f"{number:.7g}") if type_ is PointType.FLOAT32 else number
