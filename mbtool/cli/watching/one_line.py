"""A widget for one line of text, which is drawn again only if its text has changed."""

# textual's Static computes the layout of the whole screen for each new text, which takes longer
# than drawing the table.

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.widget import Widget

from mbtool.cli.watching.spans import strip_of
from mbtool.views.watch_columns import cut_spans

if TYPE_CHECKING:
    from textual.strip import Strip

    from mbtool.views.watch_columns import Spans


class OneLine(Widget):
    """A widget that shows one line of text, or a few, cut at the width of the screen."""

    DEFAULT_CSS = "OneLine { height: 1; }"

    def __init__(self, name: str) -> None:
        super().__init__(id=name)
        self._lines: tuple[Spans, ...] = ()

    def show(self, *lines: Spans) -> None:
        if lines != self._lines:
            self._lines = lines
            self.styles.height = max(len(lines), 1)
            self.refresh()

    def render_line(self, y: int) -> Strip:
        width = self.size.width
        spans = cut_spans(self._lines[y], width) if y < len(self._lines) else []
        return strip_of(spans, width).apply_style(self.rich_style)
