"""A table with a cursor that draws only the rows on the screen."""

# The app sets rows and columns many times a second. The cursor stays on its row, by the row's key,
# wherever sorting or new rows move it. On the last row of a growing table the cursor follows the
# end, until the user moves it up.

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

from rich.segment import Segment
from rich.style import Style
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from mbtool.cli.watching.spans import is_plain, strip_of
from mbtool.views.watch_columns import DrawContext, FittedColumn, row_spans, title_spans

if TYPE_CHECKING:
    from textual.events import Click, MouseScrollDown, MouseScrollUp
    from textual.geometry import Region


_CURSOR = Style(bgcolor="#0b2a55")
"""The style of the cursor's row, with colours: a dark background, as errors are red and values that
changed are reversed."""
_REVERSED, _UPRIGHT = Style(reverse=True), Style(reverse=False)
_WHEEL_ROWS = 3


def _under_cursor(strip: Strip, width: int) -> Strip:
    """Return the cursor's row in its style; without colours its text is reversed.

    Text that was reversed already becomes normal, so that it still differs.
    """
    if not is_plain():
        return Strip(Segment.apply_style(strip, post_style=_CURSOR), width)
    segments = []
    for text, style, _ in strip:
        style = style or Style.null()
        segments.append(Segment(text, style + (_UPRIGHT if style.reverse else _REVERSED)))
    return Strip(segments, width)


class LiveTable(Widget, can_focus=True):
    """The rows of one view, with a cursor."""

    DEFAULT_CSS = "LiveTable { height: 1fr; }"

    class Moved(Message):
        """Sent when the user has moved the cursor."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: Sequence[Any] = ()
        self.columns: Sequence[FittedColumn] = ()
        """The columns that are drawn; those at the end may lie beyond the screen."""
        self._drawing = DrawContext()
        self._sorted_by: tuple[str | None, bool] = (None, False)
        self._empty = ""
        self._base = Style.null()
        """The style of the widget, from its CSS; computed once for all lines of a drawing."""
        self._top = 0
        self._cursor = 0
        self._key: Hashable = None
        self.follows = False
        """True if the cursor stays on the last row when new rows come."""

    @property
    def row(self) -> Any | None:
        """The row under the cursor; None if there is no row."""
        return self.rows[self._cursor] if self._cursor < len(self.rows) else None

    @property
    def cursor(self) -> int:
        """The index of the row under the cursor."""
        return self._cursor

    def take(self, rows: Sequence[Any], sorted_by: tuple[str | None, bool]) -> None:
        """Take the rows to draw; the cursor stays on its row. `show` draws them.

        `sorted_by` has the name of the column that the rows are sorted by (None: not sorted), and
        True if the greatest value comes first.
        """
        self.rows, self._sorted_by = rows, sorted_by
        self._cursor = len(rows) - 1 if self.follows else self._place_of_cursor(rows)
        self._cursor = max(self._cursor, 0)
        self._key = self.rows[self._cursor].key if self.rows else self._key
        self._scroll()

    def show(
        self, columns: Sequence[FittedColumn], context: DrawContext, *, empty: str = ""
    ) -> None:
        """Draw the rows, or the text `empty` if there are none."""
        self.columns, self._drawing, self._empty = columns, context, empty
        self.refresh()

    @property
    def rows_on_screen(self) -> Sequence[Any]:
        return self.rows[self._top : self._top + self.page]

    def begin_view(self, *, follows: bool, key: Hashable = None) -> None:
        """Prepare for the rows of another view; `key` belongs to the row to put the cursor on.

        With `follows`, the cursor goes to the last row and stays there.
        """
        self.rows = ()
        self._cursor = self._top = 0
        self._key, self.follows = key, follows

    def move(self, by: int) -> None:
        self.go_to(self._cursor + by)

    def go_to(self, index: int) -> None:
        """Put the cursor on the row at `index`, from 0, or on the last row if there are fewer."""
        if not self.rows:
            return
        grows = self._may_follow
        self._cursor = min(max(index, 0), len(self.rows) - 1)
        self._key = self.rows[self._cursor].key
        self.follows = grows and self._cursor == len(self.rows) - 1
        self._scroll()
        self.refresh()
        self.post_message(self.Moved())

    @property
    def _may_follow(self) -> bool:
        """True if the view shows its newest row last, and rows are not sorted by a column."""
        return self.can_follow and self._sorted_by[0] is None

    can_follow = False
    """True for a view (table) whose last row is the newest."""

    @property
    def page(self) -> int:
        """The number of rows that the table has room for on the screen, without the titles."""
        return max(self.size.height - 1, 1)

    def render_lines(self, crop: Region) -> list[Strip]:
        self._base = self.rich_style
        return super().render_lines(crop)

    def render_line(self, y: int) -> Strip:
        width = self.size.width
        if y == 0:
            name, descending = self._sorted_by
            strip = strip_of(title_spans(self.columns, name, descending=descending), width)
            return strip.apply_style(self._base)
        index = self._top + y - 1
        if not self.rows and y == 2:
            return strip_of([(f"  {self._empty}", "dim")], width).apply_style(self._base)
        if index >= len(self.rows):
            return Strip.blank(width, self._base)
        strip = strip_of(row_spans(self.rows[index], self.columns, self._drawing), width)
        strip = strip.apply_style(self._base)
        if index == self._cursor and self.has_focus:
            return _under_cursor(strip, width)
        return strip

    def on_click(self, event: Click) -> None:
        if event.y:
            self.go_to(self._top + event.y - 1)

    def on_mouse_scroll_down(self, event: MouseScrollDown) -> None:
        event.stop()
        self.move(_WHEEL_ROWS)

    def on_mouse_scroll_up(self, event: MouseScrollUp) -> None:
        event.stop()
        self.move(-_WHEEL_ROWS)

    def _place_of_cursor(self, rows: Sequence[Any]) -> int:
        """Return the index in `rows` of the row that the cursor is on, found by its key.

        If that row is gone, returns the old index, or the last row (-1 if there are no rows).
        """
        at = self._cursor
        if at < len(rows) and rows[at].key == self._key:
            return at
        for index, row in enumerate(rows):
            if row.key == self._key:
                return index
        return min(at, len(rows) - 1)

    def _scroll(self) -> None:
        page = self.page
        if self._cursor < self._top:
            self._top = self._cursor
        elif self._cursor >= self._top + page:
            self._top = self._cursor - page + 1
        self._top = max(min(self._top, len(self.rows) - page), 0)
