"""Makes tables of one style, and removes control characters from texts for a terminal."""

from __future__ import annotations

import json

from rich.table import Table
from rich.text import Text


def printable_json(text: str) -> str:
    """Return a JSON text in which characters that cannot be printed are written as JSON escapes."""
    if text.isascii():
        return text
    return "".join(
        one if one.isprintable() or one == "\n" else json.dumps(one)[1:-1] for one in text
    )


def printable(text: str) -> str:
    """Replace control characters in a text by ?, because a terminal would obey them."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else "?" for char in text)


def plain(text: str, style: str = "") -> Text:
    """Return a text for the library rich, without control characters; brackets are not markup."""
    return Text(printable(text), style)


def plain_table(*headings: str) -> Table:
    """Return an empty table without a frame; long cells take several lines."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table
