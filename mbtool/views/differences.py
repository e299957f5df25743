"""Prints the differences between two captures: a table for each slave."""

# Names come from profiles, and links from captures. Both may contain markup or control characters,
# so every cell goes through plain(), which makes them harmless.

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from mbtool.core.moments import counted
from mbtool.views.tables import plain, plain_table

if TYPE_CHECKING:
    from rich.console import Console

    from mbtool.devices import Difference

_NOTHING = "-"
_HEADINGS = ("differs", "function", "what")
_SMALLEST_P = 1e-12


def print_differences(
    console: Console, found: Sequence[Difference], sides: tuple[str, str] = ("A", "B")
) -> None:
    """Print a table for each slave, with a row for each difference and a column for each capture.

    `sides` are the headings of the columns of the two captures.
    """
    for slave, group in groupby(found, key=_slave):
        table = plain_table(*_HEADINGS, *sides)
        for one in group:
            cells = (one.what, what_text(one), one.a.text or _NOTHING, one.b.text or _NOTHING)
            table.add_row(one.kind.value, *map(plain, cells))
        console.print(plain(slave, "bold"))
        console.print(table)
        console.print()


def what_text(difference: Difference) -> str:
    """Describe the addresses that differ: the reference, and its name in the device's manual.

    Behind it are other requests whose latencies changed in the same way, and `p`, the probability
    that chance alone causes such a difference, if it was computed.
    """
    parts = [", ".join([difference.reference or "", *difference.alike])]
    if difference.name is not None and difference.name != difference.reference:
        parts.append(difference.name)
    if difference.p is not None:
        parts.append(f"({_chance(difference.p)})")
    return " ".join(parts).strip()


def count_text(found: Sequence[Difference]) -> str:
    """Say how many differences there are: `12 differences`."""
    return counted(len(found), "difference", ",")


def _slave(difference: Difference) -> str:
    if difference.unit is None:
        return f"connections to {difference.link}" if difference.link else "connections"
    where = f" on {difference.link}" if difference.link is not None else ""
    return f"unit {difference.unit}{where}"


def _chance(p: float) -> str:
    return f"p < {_SMALLEST_P:g}" if p < _SMALLEST_P else f"p = {p:.2g}"
