"""Shows device profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group
from rich.table import Table
from rich.text import Text

from mbtool.devices import write_reference
from mbtool.modbus import FUNCTIONS, function_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import RenderableType

    from mbtool.devices import Point, Profile


def profile_list(profiles: Sequence[Profile]) -> RenderableType:
    """All profiles, a line each."""
    table = _table("name", "device", "transports", "areas", "points")
    for profile in profiles:
        table.add_row(
            profile.name,
            profile.title,
            ", ".join(profile.transports),
            str(len(profile.areas)),
            str(sum(len(point.addresses) for point in profile.points)),
        )
    return table


def profile_page(profile: Profile) -> RenderableType:
    """Everything a profile says."""
    parts: list[RenderableType] = [
        Text(profile.title, style="bold"),
        Text(f"{profile.name}, by {profile.vendor}; {', '.join(profile.transports)}"),
        Text(f"source: {profile.source}"),
        Text(""),
        _areas(profile),
        Text(""),
        _functions(profile),
        Text(_exceptions(profile)),
    ]
    if profile.points:
        parts += [Text(""), _points(profile)]
    if profile.notes:
        parts.append(Text(""))
        parts += [Text(f"Note: {note}") for note in profile.notes]
    return Group(*parts)


def _areas(profile: Profile) -> Table:
    table = _table("area", "references", "addresses", "table", "access")
    for area in profile.areas:
        quantity = area.last - area.first + 1
        table.add_row(
            area.name,
            write_reference(profile, area.table, area.first, quantity),
            f"{area.first:04X}..{area.last:04X}",
            area.table.value.replace("_", " "),
            "read, write" if area.access == "rw" else "read",
        )
    return table


def _functions(profile: Profile) -> Table:
    table = _table("function", "name", "at most")
    for key, rule in sorted(profile.functions.items()):
        code = int(key, 16)
        known = FUNCTIONS.get(code)
        table.add_row(
            key,
            rule.title or function_name(code),
            str(rule.limit) if rule.limit else "" if known is None else "not stated",
        )
    return table


def _exceptions(profile: Profile) -> str:
    rules = profile.exceptions
    documented = ", ".join(f"{code:02X}" for code in rules.documented)
    return (
        f"exceptions: {rules.function:02X} for a function it lacks, {rules.address:02X} for an "
        f"address, {rules.value:02X} for a value; documented: {documented}"
    )


def _points(profile: Profile) -> Table:
    table = _table("reference", "point", "type", "values")
    for point in profile.points:
        first, last = point.addresses[0], point.addresses[-1]
        reference = write_reference(profile, point.table, first, point.type.words)
        if last != first:
            reference += " .. " + write_reference(profile, point.table, last, point.type.words)
        name = point.name.replace("{n}", "n")
        table.add_row(reference, name, point.type.value, _values(point))
    return table


def _values(point: Point) -> str:
    parts = [f"{value} {text}" for value, text in point.texts.items()]
    if point.minimum is not None or point.maximum is not None:
        parts.append(f"{point.minimum}..{point.maximum}")
    if point.default is not None:
        parts.append(f"default {point.default}")
    return ", ".join(parts) + (f" {point.unit}" if point.unit else "")


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table
