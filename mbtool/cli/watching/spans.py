"""Turns spans (texts with styles) into what textual draws; without colours if NO_COLOR is set."""

from __future__ import annotations

import os
from functools import lru_cache
from itertools import groupby
from operator import itemgetter

from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual.strip import Strip
from textual.widget import Widget

from mbtool.views.watch_columns import Spans, cut_spans


def strip_of(spans: Spans, width: int) -> Strip:
    """Return one line of spans, cut or padded to exactly `width` characters.

    Spans of the same style become one segment, as drawing costs time for each segment.
    """
    plain = is_plain()
    segments = [
        Segment("".join(text for text, _ in alike), style_of(style, plain=plain))
        for style, alike in groupby(spans, itemgetter(1))
    ]
    return Strip(segments).adjust_cell_length(width)


def text_of(spans: Spans) -> Text:
    """Return spans as one text, which is never broken into lines."""
    plain = is_plain()
    text = Text(no_wrap=True, overflow="ellipsis")
    for part, style in spans:
        text.append(part, style_of(style, plain=plain))
    return text


def is_plain() -> bool:
    """True if the user wants no colours (NO_COLOR, see no-color.org)."""
    return bool(os.environ.get("NO_COLOR"))


@lru_cache(maxsize=256)
def style_of(text: str, *, plain: bool) -> Style:
    """Return the style that a text such as `bold red` names; with `plain`, without its colours."""
    style = Style.parse(text) if text else Style.null()
    return style.without_color if plain else style


# OneLine is a widget for one line of text, which is drawn again only if its text has changed.
#
# textual's Static computes the layout of the whole screen for each new text, which takes longer
# than drawing the table.


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
