"""What all tables share: their look, and text in which nothing is obeyed."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text


def printable(text: str) -> str:
    """Text that came off a wire or from a file, without what a terminal would obey."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else "?" for char in text)


def plain(text: str, style: str = "") -> Text:
    """The same for rich, to which brackets in it are brackets and no markup."""
    return Text(printable(text), style)


def plain_table(*headings: str) -> Table:
    """An empty table without a frame, whose cells are broken into lines where they must be."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table
