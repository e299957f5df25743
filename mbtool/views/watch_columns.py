"""Lays out the tables of live views: which columns fit a width, and the cells of a row."""

# A cell is a list of spans: texts with styles in the notation of the library rich. Columns of width
# 0 share the width that the other columns leave. A measured column takes no more than its widest
# cell, so that the others get the rest. If there is little room, columns of the highest rank are
# left out first; a column that the user chose is kept.

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from mbtool.views.tables import printable
from mbtool.watching.value_formats import ValueFormat

if TYPE_CHECKING:
    from mbtool.views.watch_places import PlaceColumn

Span = tuple[str, str]
Spans = list[Span]

_LONGEST_PART = 12
"""A text that is too long is cut between words, unless its last word is longer than this, in
characters."""
CUT = "…"
"""Ends a text that is cut."""
LEAST_REST = 22
"""Columns of width 0 share the width that the others leave. If they would get fewer characters
than this each, another column is left out."""


@dataclass(slots=True)
class DrawContext:
    """The state that the cells of a live table depend on, apart from the rows themselves."""

    now_ns: int = 0
    """The time for which the view is drawn, in ns since 1970."""
    formats: dict[Hashable, ValueFormat] = field(default_factory=dict)
    """The formats in which the user chose to see the values of single rows. The key is the row's
    `key`, which identifies the poll, point or transaction that the row shows."""
    marked: Collection[int] = ()
    """The `order` numbers (place among all records, from 1) of the transactions that the user
    marked."""
    is_over: bool = False
    """True if the capture has ended, so that the age of a row means nothing."""

    def format_of(self, key: Hashable) -> ValueFormat:
        return self.formats.get(key, ValueFormat.NAMED)


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchColumn:
    """A column of a live table."""

    name: str
    title: str
    width: int
    """The width in characters; 0 for a column that shares what the other columns leave."""
    cell: Callable[[Any, DrawContext], str | Spans]
    sort: Callable[[Any], Any]
    """Returns the value by which rows are sorted; the values of one column can be compared."""
    rank: int = 0
    """On a narrow screen, columns with the highest rank are left out first; a column of rank 0
    never is."""
    is_spared: bool = False
    """True for a column with a rank that is left out only where a column of width 0 would get fewer
    than LEAST_REST characters, even if it has a greater `least_share`."""
    is_right: bool = False
    fit: Callable[[Any, DrawContext, int], Spans] | None = None
    """Makes the cell for a width in characters; None if a cell that is too long is just cut."""
    least: int = 0
    """If more than 0, the column is measured: its width is that of its widest cell, from this to
    `width` characters. One of width 0 needs no more than its widest cell then, and at least this.
    """
    least_share: int = LEAST_REST
    """For a column of width 0: other columns are left out if this one would get fewer characters
    than this. If it is measured, its widest cell is enough."""
    is_usual: bool = True
    """False for a column that is shown only if the user chooses it."""

    @property
    def is_measured(self) -> bool:
        """True if the width depends on the widest cell."""
        return self.least > 0

    @property
    def most(self) -> int:
        """The number of characters in the widest cell from which on wider cells change nothing."""
        return self.width or self.least_share


def plain_column(
    name: str,
    title: str,
    width: int,
    field: str = "",
    *,
    text: Callable[[Any], str] = str,
    **more: Any,
) -> WatchColumn:
    """Return a column that shows an attribute of its rows, and is sorted by it.

    `field` is the name of the attribute, by default that of the column; `text` writes its value.
    `more` are other fields of WatchColumn.
    """
    value = attrgetter(field or name)
    cell = lambda row, _: text(value(row))  # noqa: E731
    return WatchColumn(name=name, title=title, width=width, cell=cell, sort=value, **more)


@dataclass(frozen=True, slots=True)
class FittedColumn:
    """A column with its width on the screen, in characters."""

    column: WatchColumn
    width: int
    prefix: str = ""
    """The part that all texts of the column begin with; it is left out of the cells."""


def fitted(
    columns: Sequence[WatchColumn],
    width: int,
    chosen: Collection[str] | None = None,
    places: Mapping[str, PlaceColumn] | None = None,
    widest: Mapping[str, int] | None = None,
) -> list[FittedColumn]:
    """Return the columns to show on a screen of `width` characters, with their widths.

    If `chosen` names columns, exactly these are shown. With None, the usual columns are shown that
    are not empty, as many as fit, and those in `places` (link and master) always, with the width
    given there. `widest` has the number of characters in the widest cell of columns that are
    measured.
    """
    places = places or {}
    widest = widest or {}
    needed = _needed(columns, widest)
    columns = [_as_wide(one, needed) for one in columns]
    if chosen is None:
        columns = [_placed(one, places) for one in columns if not _may_be_left_out(one, widest)]
    kept = [one for one in columns if (one.is_usual if chosen is None else one.name in chosen)]
    kept = kept or list(columns[:1])
    while True:
        room = width - sum(one.width for one in kept) - (len(kept) - 1)
        last = max(reversed(kept), key=lambda one: one.rank)
        if chosen is not None or not last.rank or room >= _least_room(kept, last):
            break
        kept.remove(last)
    shares = _shares([one for one in kept if not one.width], max(room, 0), needed)
    result = []
    for one in kept:
        place = places.get(one.name) if chosen is None else None
        size = one.width or max(shares[one.name], 1)
        result.append(FittedColumn(one, size, "" if place is None else place.prefix))
    return result


def left_out(
    columns: Sequence[WatchColumn],
    shown: Sequence[FittedColumn],
    width: int,
    widest: Mapping[str, int],
) -> dict[str, str]:
    """Return why usual or chosen columns are not seen on a screen of `width` characters, by name.

    `shown` is the result of `fitted` for that width, and `widest` as there.
    """
    end, seen = 0, set()
    for one in shown:
        end += one.width + (1 if end else 0)
        if end <= width:
            seen.add(one.column.name)
    names = {one.column.name for one in shown} | {one.name for one in columns if one.is_usual}
    return {
        one.name: "empty" if _may_be_left_out(one, widest) else "no room at this width"
        for one in columns
        if one.name in names - seen
    }


def _needed(columns: Sequence[WatchColumn], widest: Mapping[str, int]) -> Mapping[str, int]:
    """Return the width that a column's widest cell needs, by name, where it is known."""
    return {
        one.name: max(widest[one.name], one.least)
        for one in columns
        if one.is_measured and widest.get(one.name, one.most) < one.most
    }


def _least_room(columns: Sequence[WatchColumn], last: WatchColumn) -> int:
    """Return the room that columns of width 0 need in all, so that `last` is not left out."""
    shares = [one.least_share for one in columns if not one.width]
    return sum(min(share, LEAST_REST) if last.is_spared else share for share in shares)


def _may_be_left_out(column: WatchColumn, widest: Mapping[str, int]) -> bool:
    """True for a column that may be left out, and is known to have no text in its cells."""
    return column.is_measured and column.rank > 0 and widest.get(column.name) == 0


def _as_wide(column: WatchColumn, needed: Mapping[str, int]) -> WatchColumn:
    """Return a column that is only as wide as its widest cell, or needs no more than that."""
    width = needed.get(column.name)
    if width is None:
        return column
    return replace(column, width=width) if column.width else replace(column, least_share=width)


def _shares(
    columns: Sequence[WatchColumn], room: int, needed: Mapping[str, int]
) -> Mapping[str, int]:
    """Return the widths of columns of width 0, by name: `room` characters in all.

    Each gets the same, but one whose widest cell is known no more than that, as long as others need
    more. What nobody needs goes to the last column.
    """
    wanted = {one.name: needed.get(one.name, room) for one in columns}
    left, shares = list(wanted), {}
    while len(left) > 1:
        if sum(map(wanted.__getitem__, left)) <= room:
            small = left[:-1]
        else:
            small = [name for name in left if wanted[name] <= room // len(left)]
        if not small:
            break
        for name in small:
            shares[name] = wanted[name]
            room -= wanted[name]
            left.remove(name)
    for at, name in enumerate(left):
        shares[name] = room // len(left) + (at < room % len(left))
    return shares


def _placed(column: WatchColumn, places: Mapping[str, PlaceColumn]) -> WatchColumn:
    """Return a column; if `places` has it, with the width given there and never left out.

    `places` has link and master, if there are several.
    """
    place = places.get(column.name)
    return column if place is None else replace(column, width=place.width, rank=0, is_usual=True)


def title_spans(
    columns: Sequence[FittedColumn], sorted_by: str | None, *, descending: bool
) -> Spans:
    """Return the line of titles. The title of the column `sorted_by` ends in v (descending) or ^.

    With `sorted_by` None, rows are not sorted.
    """
    texts = []
    for one in columns:
        title = one.column.title
        if one.column.name == sorted_by:
            title = f"{title[: max(one.width - 1, 0)]}{'v' if descending else '^'}"
        texts.append(_aligned(title, one.width, is_right=one.column.is_right))
    return [(" ".join(texts), "bold underline")]


def row_spans(row: Any, columns: Sequence[FittedColumn], context: DrawContext) -> Spans:
    """Return the texts of a row's cells with their styles, padded or cut to the columns' widths."""
    spans: Spans = []
    for number, one in enumerate(columns):
        if number:
            spans.append((" ", ""))
        fit = one.column.fit
        cell = one.column.cell(row, context) if fit is None else fit(row, context, one.width)
        if isinstance(cell, str):
            cell = cell.removeprefix(one.prefix)
            spans.append((_aligned(printable(cell), one.width, is_right=one.column.is_right), ""))
        else:
            spans += cut_spans(cell, one.width)
    return spans


def row_text(row: Any, columns: Sequence[WatchColumn], context: DrawContext) -> str:
    """Return all cells of a row as one text, for the user's search."""
    cells = (one.cell(row, context) for one in columns)
    return " ".join(
        cell if isinstance(cell, str) else "".join(text for text, _ in cell) for cell in cells
    )


def widest_cells(
    rows: Sequence[Any], columns: Sequence[WatchColumn], context: DrawContext
) -> dict[str, int]:
    """Return the number of characters in the widest cell in `rows` of each measured column.

    Without rows nothing is known.
    """
    widths = {}
    for one in columns if rows else ():
        if one.is_measured:
            cells = (one.cell(row, context) for row in rows)
            widths[one.name] = max(
                len(cell) if isinstance(cell, str) else sum(len(text) for text, _ in cell)
                for cell in cells
            )
    return widths


def cut_spans(spans: Spans, width: int) -> Spans:
    """Return spans of exactly `width` characters: cut, with CUT at the end, or padded."""
    spans = [(printable(text), style) for text, style in spans]
    length = sum(len(text) for text, _ in spans)
    if length <= width:
        return [*spans, (" " * (width - length), "")]
    result: Spans = []
    left = kept = _cut_at("".join(text for text, _ in spans), width)
    for text, style in spans:
        if len(text) >= left:
            result.append((text[:left], style))
            break
        result.append((text, style))
        left -= len(text)
    return [*result, (CUT.ljust(width - kept)[: width - kept], "dim")]


def _cut_at(text: str, width: int) -> int:
    """Return the number of characters of a text to keep when it is cut to `width` and CUT is added.

    The cut is behind a space, so that no number looks like a shorter one, and no word is halved.
    """
    end = max(width - len(CUT), 0)
    if text[end : end + 1] == " ":
        return end
    space = text.rfind(" ", max(end - _LONGEST_PART, 0), end)
    return space + 1 or end


def _aligned(text: str, width: int, *, is_right: bool) -> str:
    if len(text) > width:
        text = f"{text[: _cut_at(text, width)]}{CUT}"[:width]
    return f"{text:>{width}}" if is_right else f"{text:<{width}}"
