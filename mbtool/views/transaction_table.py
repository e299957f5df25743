"""Prints transactions as a table that grows row by row, on a terminal or into a pipe."""

#     rtu rs485, unit 1 idec-ft1a-touch                            2026-11-22 UTC
#        #  time              ms  request -> response
#       12  09:14:03.201     8.2  03 read HR400001..400004 -> 100, 200, 300, 400
#       13  09:14:03.260     2.1  06 write HR400001 := 4660
#
# A heading has the link, master, unit and day of the rows below it; when one of them changes, a new
# heading is printed. A link, master or unit that changes often becomes a column, and is no longer
# in the heading: see PlaceColumns. The first SAMPLE rows are examined before any is printed, so
# that a table rarely changes its columns; a live table cannot wait for them and calls `pause`.
#
# On a terminal, a row whose text is too long for its line is shortened: points (named values) that
# did not change since the last reading are only counted. If the text is still too long, it
# continues on the lines below, at most MAX_LINES lines; a last line says how many more there are.
# --full shows all values. If the terminal has less than FEW_COLUMNS columns, addresses of one
# network are shown by their last number, and the heading has the other numbers. The findings
# (broken rules) of a row are below it.
#
# In a pipe, in a file and with --wide a row is one line, with the whole text at the end, and always
# has its link and unit.
#
# Text from a wire is never markup, and control characters in it are replaced.

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from rich.text import Text

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import SECOND_NS, clock_time, day, host_of
from mbtool.modbus import Outcome
from mbtool.views.cells import (
    ARROW,
    event_text,
    finding_texts,
    short_transaction_text,
    transaction_text,
)
from mbtool.views.changed_points import ChangedPoints
from mbtool.views.place_columns import PLACES, PlaceColumns, places_of
from mbtool.views.table_options import TableColumn, TableOptions, TimeStyle
from mbtool.views.tables import RowForm, printable

if TYPE_CHECKING:
    from rich.console import Console

    from mbtool.decode.usual_run import UsualRun
    from mbtool.devices import NamedTransaction, Profile

    Record = NamedTransaction | WireEvent

# Writes the times of table rows: the time of day (UTC or local), or seconds since another row.


class Times:
    """Writes the time of each row; the rows must come in the order in which they are shown."""

    def __init__(self, style: TimeStyle) -> None:
        self._style = style
        self._origin_ns: int | None = None

    def text(self, ts_ns: int) -> str:
        """Return the time of a row that starts at `ts_ns` (UTC ns), at least 12 characters.

        Call this once for each row, in order.
        """
        match self._style:
            case TimeStyle.UTC:
                return clock_time(ts_ns)
            case TimeStyle.LOCAL:
                return clock_time(ts_ns + _offset_ns(ts_ns))
        since_ns = ts_ns if self._origin_ns is None else self._origin_ns
        if self._origin_ns is None or self._style is TimeStyle.DELTA:
            self._origin_ns = ts_ns
        return f"{(ts_ns - since_ns) / 1e9:+12.6f}"

    def day_of(self, ts_ns: int) -> str:
        """Return the day of a row that starts at `ts_ns` (UTC ns), with the time zone.

        The text is "" if rows show seconds instead.
        """
        match self._style:
            case TimeStyle.UTC:
                return f"{day(ts_ns)} UTC"
            case TimeStyle.LOCAL:
                return f"{day(ts_ns + _offset_ns(ts_ns))} local time"
        return ""


def _offset_ns(ts_ns: int) -> int:
    """Return local time minus UTC in ns at the time `ts_ns`; 0 if the system does not know it."""
    try:
        return time.localtime(ts_ns // 1_000_000_000).tm_gmtoff * 1_000_000_000
    except (ValueError, OverflowError, OSError):
        return 0


T = TypeVar("T")

SAMPLE = 100
"""The number of first rows that decide which columns a table has, and how wide they are."""
MAX_LINES = 4
"""A row's text takes at most this many lines on a terminal; with --full there is no limit."""
_MIN_TEXT = 24
"""A wrapped text is at least this wide, in characters; a narrower terminal breaks its lines."""
_INDENT = 12
"""The indent, in characters, of a line that continues the text of a row."""
FEW_COLUMNS = 100
"""On a terminal narrower than this, in characters, IP addresses are shown by their last number."""

_WIDTHS = {
    TableColumn.NUMBER: 5,
    TableColumn.TIME: 12,
    TableColumn.LATENCY: 6,
    TableColumn.LINK: 15,
    TableColumn.MASTER: 21,
    TableColumn.SLAVE: 21,
    TableColumn.UNIT: 4,
    TableColumn.DEVICE: 20,
    TableColumn.ID: 5,
    TableColumn.OUTCOME: 12,
    TableColumn.PACKET: 13,
    TableColumn.FILE: 20,
}
_RIGHT = frozenset((TableColumn.NUMBER, TableColumn.LATENCY, TableColumn.UNIT, TableColumn.ID))
"""Columns whose cells are aligned to the right."""
_FITTED = frozenset(
    (
        TableColumn.LINK,
        TableColumn.MASTER,
        TableColumn.SLAVE,
        TableColumn.DEVICE,
        TableColumn.FILE,
    )
)
"""Columns that are as wide as the longest text in the first rows."""
_MAX_WIDTH = 45
"""The greatest width of a column of _FITTED: that of an IPv6 address with its port."""
_NO_BREAK = "\N{NO-BREAK SPACE}"
_COUNTED = re.compile(r" (x\d+)(?![^, ])")
"""Matches the number of equal values in a text, such as the x24 of `0 x24`."""
_TITLES = {TableColumn.NUMBER: "#", TableColumn.LATENCY: "ms"}
_TEXT_TITLE = "request -> response"
_USUAL = (TableColumn.NUMBER, TableColumn.TIME, TableColumn.LATENCY)


class _TableRow(NamedTuple):
    """A record (transaction or event), and what else the table needs to print its row."""

    number: int | None
    """The number of the transaction in the capture, from 1; None for an event."""
    record: Record
    profile: Profile | None
    places: tuple[str, str, str]
    """The texts of link, master and unit; "" for master and unit of an event."""
    start_ns: int
    """The time of the request or event (UTC ns)."""


class TransactionTable:
    """Prints the rows of a table. The first rows wait until their columns are decided.

    Call `pause` when no row comes for a while, and `flush` at the end.
    """

    def __init__(
        self, console: Console, options: TableOptions | None = None, *, sample: int = SAMPLE
    ) -> None:
        self._console = console
        self._options = options or TableOptions()
        self._sample = sample
        self._pending: list[_TableRow] | None = []
        self._wraps = console.is_terminal and not self._options.wide
        self._times = Times(self._options.time)
        self._points = ChangedPoints()
        self._styles: dict[str, tuple[str, str]] = {}
        self._places = PlaceColumns(is_narrow=self._wraps and console.width < FEW_COLUMNS)
        self._aligned = {column: _aligned(column, width) for column, width in _WIDTHS.items()}
        """For each column, a function that pads a text to the width of the column."""
        self._columns = self._options.columns
        if not self._columns and not self._wraps:
            self._columns = (*_USUAL, TableColumn.LINK, TableColumn.UNIT)
        self._is_chosen = bool(self._columns)
        self._heading = ""
        self._link = self._place = ""
        """The link of the last printed row, and the part of the last heading that names link,
        master and unit; both are compared with the next row, which may need a new heading."""
        self._titled: tuple[TableColumn, ...] = ()
        """The columns named in the line of titles that was printed last."""

    def add(self, number: int, record: Record, profile: Profile | None = None) -> None:
        """Add a transaction or a wire event; `number` counts the transactions so far, from 1.

        With a profile, the texts of findings contain the figures of the device.
        """
        places = places_of(record)
        if isinstance(record, WireEvent):
            row = _TableRow(None, record, profile, places, record.ts_ns)
        else:
            row = _TableRow(number, record, profile, places, record.start_ns)
        if self._pending is None:
            self._print(row)
            return
        self._pending.append(row)
        if len(self._pending) >= self._sample:
            self.flush()

    @property
    def takes_runs(self) -> bool:
        """True if `add_run` prints the same text as `add`: into a pipe or a file, not on a
        terminal.
        """
        return not self._console.is_terminal

    def form_of(self, like: NamedTransaction) -> RowForm:
        """Return the text that the rows of a UsualRun share with the row of the example `like`."""
        return RowForm.of(like, in_hex=self._options.in_hex)

    def add_run(self, number: int, run: UsualRun[RowForm]) -> None:
        """Print many transactions without points (named values); `number` is the first one's, from
        1.

        Call this only if `takes_runs` is True, and after SAMPLE calls of `add`.
        """
        cells = [self._run_cells(column, number, run) for column in self._columns]
        texts = [f" {form.text(some)}" for form, some in zip(run.forms, run.values, strict=True)]
        lines = [*map(" ".join, zip(*cells, texts, strict=True))]
        days = _texts_of(
            self._times.day_of, [one // SECOND_NS * SECOND_NS for one in run.request_ns]
        )
        begin = 0
        for date, some in groupby(days):
            end = begin + len([*some])
            self._print_heading(date)
            self._console.file.write("\n".join([*lines[begin:end], ""]))
            begin = end

    def _run_cells(self, column: TableColumn, number: int, run: UsualRun[RowForm]) -> Iterable[str]:
        """Return the cells of a column for the transactions of `run`, padded to the
        column's width.
        """
        aligned = self._aligned[column]
        match column:
            case TableColumn.NUMBER:
                return map(aligned, map(str, range(number, number + len(run))))
            case TableColumn.TIME:
                return map(aligned, map(self._times.text, run.request_ns))
            case TableColumn.LATENCY:
                return map(aligned, map(_latency_text, run.latency_ns))
            case TableColumn.ID:
                return map(aligned, map(str, run.transaction_ids))
            case TableColumn.PACKET:
                return map(aligned, map(_packets_text, run.request_packets, run.response_packets))
            case TableColumn.LINK:
                return _texts_of(lambda one: aligned(printable(one)), run.links)
            case TableColumn.MASTER:
                return _texts_of(lambda one: aligned(host_of(one)), run.sources)
            case TableColumn.SLAVE:
                return _texts_of(aligned, run.destinations)
            case TableColumn.UNIT:
                return _texts_of(lambda one: aligned(str(one.like.unit)), run.forms)
            case _:
                text_of = _MORE[column]
                return _texts_of(lambda one: aligned(printable(text_of(one.like))), run.forms)

    def pause(self) -> None:
        """Print the rows that wait until enough rows came to decide on the columns."""
        self.flush()

    def flush(self) -> None:
        """Print all rows that are not yet printed. The first call also decides on the columns."""
        pending, self._pending = self._pending, None
        if not pending:
            self._pending = pending
            return
        if not self._is_chosen:
            self._places.decide(row.places for row in pending)
        self._fit_widths(pending)
        for row in pending:
            self._print(row)

    def _print(self, row: _TableRow) -> None:
        if not self._is_chosen:
            self._places.note(row.places)
            self._columns = (*_USUAL, *self._places.in_row)
            self._note_place(row.record)
        self._print_heading(self._times.day_of(row.start_ns))
        prefix = self._prefix(row)
        style = _style(row.record)
        if isinstance(row.record, WireEvent):
            text, findings = event_text(row.record), []
        else:
            text = self._text(row.record, len(prefix))
            findings = finding_texts(row.record, row.profile)
        if self._wraps:
            self._print_wrapped(prefix, text, findings, style)
        else:
            self._print_line("  ! ".join((f"{prefix}{printable(text)}", *findings)), style)

    def _text(self, transaction: NamedTransaction, used: int) -> str:
        """Return the request and its result, shortened if they do not fit the rest of the line.

        `used` is the number of characters of the line that the columns before the text take.
        """
        points, in_hex = self._points.of(transaction), self._options.in_hex
        text = transaction_text(transaction, points.every, in_hex=in_hex)
        if not self._wraps or self._options.full or len(text) <= self._console.width - used:
            return text
        return short_transaction_text(transaction, points, in_hex=in_hex)

    def _print_heading(self, day: str) -> None:
        """Print a heading if link, master, unit or day changed, and titles if columns changed."""
        heading = ", ".join(filter(None, (self._place, day)))
        if heading != self._heading and heading:
            self._heading = heading
            for line in self._heading_lines(printable(heading)):
                self._print_line(line, "bold")
        if self._columns != self._titled:
            self._titled = self._columns
            titles = [self._aligned[one](_TITLES.get(one, one.value)) for one in self._columns]
            self._print_line(f"{' '.join(titles)}  {_TEXT_TITLE}", "dim")

    def _heading_lines(self, heading: str) -> list[str]:
        if not self._wraps:
            return [heading]
        return wrap(heading, self._console.width, subsequent_indent="    ", break_on_hyphens=False)

    def _note_place(self, record: Record) -> None:
        if not isinstance(record, WireEvent):
            self._link, self._place = record.link, self._places.heading(record)
        elif record.link != self._link and TableColumn.LINK not in self._columns:
            self._link = self._place = record.link

    def _fit_widths(self, rows: Sequence[_TableRow]) -> None:
        """Make the columns of links, hosts, devices and files as wide as these rows need.

        `rows` are those printed first. In a pipe, columns have at least the width in _WIDTHS,
        since a later row may need it.
        """
        for column in self._columns if self._is_chosen else self._places.in_row:
            if column in _FITTED:
                longest = max(len(printable(self._fitted_cell(column, row))) for row in rows)
                title = len(_TITLES.get(column, column.value))
                least = title if self._wraps else _WIDTHS[column]
                self._aligned[column] = _aligned(column, min(max(longest, least), _MAX_WIDTH))

    def _fitted_cell(self, column: TableColumn, row: _TableRow) -> str:
        if column in PLACES:
            return self._places.cell(column, row.places)
        return _MORE[column](row.record)

    def _prefix(self, row: _TableRow) -> str:
        """Return the text of all cells of a row that come before its request and result."""
        cells = []
        for column in self._columns:
            match column:
                case TableColumn.NUMBER:
                    text = "" if row.number is None else str(row.number)
                case TableColumn.TIME:
                    text = self._times.text(row.start_ns)
                case TableColumn.LATENCY:
                    text = _latency(row.record)
                case TableColumn.LINK | TableColumn.MASTER | TableColumn.UNIT:
                    text = row.places[PLACES.index(column)]
                    if self._places.networks:
                        text = self._places.cell(column, row.places)
                case _:
                    text = _MORE[column](row.record)
            cells.append(self._aligned[column](text))
        return printable(f"{' '.join(cells)}  ")

    def _print_wrapped(self, prefix: str, text: str, findings: Sequence[str], style: str) -> None:
        """Print a row whose text may take several lines, and its findings below it.

        `prefix` has the cells before the text; `style` is that of the row, such as `red`.
        """
        first, *below = self._wrapped(text, len(prefix))
        self._print_line(prefix + first, style)
        for finding in findings:
            below += self._wrapped(finding, _INDENT)
        for line in below:
            self._print_line(" " * _INDENT + line, style)

    def _wrapped(self, text: str, used: int) -> list[str]:
        """Break a text into lines for the terminal.

        The first line has `used` characters less, as the cells of the row come before it.
        """
        text, width = printable(text), self._console.width
        if len(text) <= width - used:
            return [text]
        room = max(width - _INDENT, _MIN_TEXT)
        request, arrow, result = text.partition(ARROW)
        if len(request) <= width - used and len(f"{arrow}{result}".lstrip()) <= room:
            return [request, f"{arrow}{result}".lstrip()]
        if width - used < _MIN_TEXT:
            lines = ["", *_lines(text, room)]
        else:
            # The first line has less room. So a filler as long as the taken part is put before the
            # text, and is removed again after wrapping.
            filler = "\0" * max(used - _INDENT, 0)
            lines = _lines(filler + text, room)
            lines[0] = lines[0].removeprefix(filler)
        left = len(lines) - MAX_LINES
        if left <= 1 or self._options.full:
            return lines
        return [*lines[:MAX_LINES], f"... {left} more lines; --full shows them"]

    def _print_line(self, line: str, style: str) -> None:
        before, after = self._codes(style) if style else ("", "")
        self._console.file.write(f"{before}{line.rstrip()}{after}\n")

    def _codes(self, style: str) -> tuple[str, str]:
        """Return the escape codes that a terminal gets before and after a text of this style.

        They are remembered, because Console.print is slow.
        """
        codes = self._styles.get(style)
        if codes is None:
            with self._console.capture() as capture:
                self._console.print(Text("|", style=style), end="")
            before, _, after = capture.get().partition("|")
            codes = self._styles[style] = before, after
        return codes


def _aligned(column: TableColumn, width: int) -> Callable[[str], str]:
    """Return a function that pads a cell's text with spaces to `width` characters."""
    return f"{{:{'>' if column in _RIGHT else '<'}{width}}}".format


def _lines(text: str, width: int) -> list[str]:
    """Break a text into lines, but not between a value and its count, as in `0 x24`."""
    together = _COUNTED.sub(f"{_NO_BREAK}\\1", text)
    return [line.replace(_NO_BREAK, " ") for line in wrap(together, width, break_on_hyphens=False)]


def _packets(record: Record) -> str:
    """Return the packet numbers of request and response, from 1: `12/13`, or `12` if equal."""
    if isinstance(record, WireEvent):
        return ""
    return _packets_text(record.request_packet, record.response_packet)


def _packets_text(first: int | None, last: int | None) -> str:
    if first == last:
        return "" if first is None else str(first)
    return "/".join("-" if one is None else str(one) for one in (first, last))


def _latency(record: Record) -> str:
    if isinstance(record, WireEvent) or record.latency_ns is None:
        return ""
    return _latency_text(record.latency_ns)


def _latency_text(latency_ns: int) -> str:
    return f"{latency_ns / 1e6:.1f}"


def _texts_of(make: Callable[[T], str], items: Sequence[T]) -> list[str]:
    """Return the text of each item; of equal items it is made only once."""
    texts = {one: make(one) for one in {*items}}
    return [texts[one] for one in items]


def _style(record: Record) -> str:
    if isinstance(record, WireEvent):
        return "" if record.kind in (EventKind.OPENED, EventKind.CLOSED) else "yellow"
    return "" if record.outcome in (Outcome.OK, Outcome.BROADCAST) else "red"


_MORE: dict[TableColumn, Callable[[Record], str]] = {
    TableColumn.SLAVE: lambda one: "" if isinstance(one, WireEvent) else one.destination or "",
    TableColumn.DEVICE: lambda one: "" if isinstance(one, WireEvent) else one.device or "",
    TableColumn.ID: lambda one: (
        "" if isinstance(one, WireEvent) or one.transaction_id is None else str(one.transaction_id)
    ),
    TableColumn.OUTCOME: lambda one: (
        one.kind.value if isinstance(one, WireEvent) else one.outcome.value
    ),
    TableColumn.PACKET: _packets,
    TableColumn.FILE: lambda one: "" if isinstance(one, WireEvent) else one.file or "",
}
"""For each column that is shown only if the user chooses it: a function that makes its cells."""
