"""Turns spans into what textual draws; without colours where NO_COLOR is set (no-color.org)."""

from __future__ import annotations

import os
from functools import lru_cache
from typing import TYPE_CHECKING

from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual.strip import Strip

if TYPE_CHECKING:
    from mbtool.views.watch_columns import Spans


def strip_of(spans: Spans, width: int) -> Strip:
    """One line of exactly a width."""
    plain = is_plain()
    segments = [Segment(text, style_of(style, plain=plain)) for text, style in spans]
    return Strip(segments).adjust_cell_length(width)


def text_of(spans: Spans) -> Text:
    """A text of one line that is not broken."""
    plain = is_plain()
    text = Text(no_wrap=True, overflow="ellipsis")
    for part, style in spans:
        text.append(part, style_of(style, plain=plain))
    return text


def is_plain() -> bool:
    """True if the user wants no colours."""
    return bool(os.environ.get("NO_COLOR"))


@lru_cache(maxsize=256)
def style_of(text: str, *, plain: bool) -> Style:
    """The style that a text names; with `plain` only bold, reverse, dim and underline of it."""
    style = Style.parse(text) if text else Style.null()
    return style.without_color if plain else style
