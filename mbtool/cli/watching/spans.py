"""Turns spans (texts with styles) into what textual draws; without colours if NO_COLOR is set."""

from __future__ import annotations

import os
from functools import lru_cache
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING

from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual.strip import Strip

if TYPE_CHECKING:
    from mbtool.views.watch_columns import Spans


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
