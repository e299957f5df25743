"""Prints how an inventory (who talks to whom, and which ranges) differs from an older one."""

# A line has the kind of change, the host with its unit, and a text:
#
#     new host          10.0.0.66 unit 1    asked by 10.0.0.5
#     wider range       10.0.0.7 unit 1     03 read holding reads 100..119 by 10.0.0.5

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

from rich.text import Text

from mbtool.ledger.baseline import ChangeKind
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from mbtool.ledger.baseline import InventoryChange

_KIND_WIDTH = max(len(kind.value) for kind in ChangeKind)
_WIDEST_PLACE = 40
_INDENT = " " * 4
_NARROWEST = 40


def print_changes(console: Console, changes: Sequence[InventoryChange]) -> None:
    """Print a line for each change; on a narrow terminal its text goes to a line of its own."""
    width = min(max((len(one.where) for one in changes), default=0), _WIDEST_PLACE)
    for one in changes:
        head = f"{one.kind.value:<{_KIND_WIDTH}}  {printable(one.where):<{width}}"
        text = printable(one.text)
        if not console.is_terminal or len(head) + 2 + len(text) <= console.width:
            line = Text(f"{head}  {text}")
        else:
            parts = wrap(text, max(console.width, _NARROWEST) - len(_INDENT))
            line = Text("\n".join([head.rstrip(), *(_INDENT + part for part in parts)]))
        line.stylize("bold yellow", 0, len(one.kind.value))
        console.print(line, soft_wrap=True)
