"""Writes an inventory in Graphviz's language: masters, hosts, and functions between them."""

# A host is a box that lists its units and their profiles; an arrow leads from a master to a host,
# with the function codes that the master uses there. The arrow of a master that writes is bold and
# red. Units that never answered are only counted.
#
#     mbtool inventory plant.pcap --format dot | dot -Tsvg > plant.svg

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.ledger.inventory_rows import Role
from mbtool.views.inventory_table import identity_text, mac_text, profile_text
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.ledger.inventory_rows import InventoryDocument, SlaveRow

_QUIET = (Role.SILENT, Role.UNHEARD)
_MAX_UNITS = 24
"""A host's box lists at most this many units; further units are only counted."""
_MAX_TEXT = 60


def inventory_dot(document: InventoryDocument) -> str:
    """Return the graph as text in Graphviz's language, with a line end."""
    return "\n".join(_lines(document)) + "\n"


def _lines(document: InventoryDocument) -> Iterator[str]:
    yield "digraph inventory {"
    yield '  rankdir=LR; node [shape=box, fontname="sans-serif"]; edge [fontname="sans-serif"];'
    places: dict[str, list[SlaveRow]] = {}
    for row in document.slaves:
        if row.role not in _QUIET:
            places.setdefault(row.where, []).append(row)
    slaves = {row.host for rows in places.values() for row in rows}
    for master in document.masters:
        # A host that is both master and slave gets two nodes, so that arrows do not cross.
        lines = [master.host, *([mac_text(master.macs, master.makers)] if master.macs else [])]
        if master.host in slaves:
            lines[0] += " (as master)"
        yield f"  {_node('master', master.host)} [label={_label(lines)}, style=rounded];"
    for where, rows in places.items():
        yield f"  {_node('slave', where)} [label={_label(_box(where, rows))}];"
    yield from _arrows(places)
    quiet = sum(row.role in _QUIET for row in document.slaves)
    if quiet:
        yield f"  label={_label([f'{quiet:,} more never answered'])};"
    yield "}"


def _box(where: str, rows: Sequence[SlaveRow]) -> list[str]:
    macs = rows[0].macs
    lines = [where, *([mac_text(macs, rows[0].makers)] if macs else [])]
    for row in rows[:_MAX_UNITS]:
        identity = identity_text(row)
        if len(identity) > _MAX_TEXT:
            identity = identity[: _MAX_TEXT - 3] + "..."
        parts = [f"unit {row.unit}", profile_text(row), identity]
        lines.append(": ".join(part for part in parts if part))
    if len(rows) > _MAX_UNITS:
        lines.append(f"and {len(rows) - _MAX_UNITS:,} more units")
    return lines


def _arrows(places: dict[str, list[SlaveRow]]) -> Iterator[str]:
    for where, rows in places.items():
        functions: dict[str, set[int]] = {}
        writers = {master for row in rows for master in row.masters(writing=True)}
        for row in rows:
            for use in row.uses:
                if use.master is not None:
                    functions.setdefault(use.master, set()).add(use.function)
        for master, codes in functions.items():
            label = " ".join(f"{code:02X}" for code in sorted(codes))
            style = ", color=red, penwidth=2" if master in writers else ""
            ends = f"{_node('master', master)} -> {_node('slave', where)}"
            yield f"  {ends} [label={_label([label])}{style}];"


def _node(kind: str, name: str) -> str:
    return _quoted(f"{kind} {printable(name)}")


def _label(lines: Sequence[str]) -> str:
    """Return the lines of a label as one quoted string, separated by a backslash and `n`."""
    return '"' + "\\n".join(_escaped(printable(line)) for line in lines) + '"'


def _quoted(text: str) -> str:
    return f'"{_escaped(text)}"'


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')
