"""Shows device profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group
from rich.table import Table
from rich.text import Text

from mbtool.devices import PointType, write_reference
from mbtool.devices.values import Place
from mbtool.modbus import FUNCTIONS, function_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import RenderableType

    from mbtool.devices import FunctionRule, Point, Profile


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
        Text(""),
        Text(_exceptions(profile)),
    ]
    silences = [("t1.5", profile.timing.t1_5), ("t3.5", profile.timing.t3_5)]
    if any(text for _, text in silences):
        said = ", ".join(f"{name} {text}" for name, text in silences if text)
        parts.append(Text(f"timing: {said}"))
    if profile.any_unit:
        parts.append(Text("units: it answers whatever unit a request names"))
    if profile.points:
        parts += [Text(""), _points(profile)]
    notes = [*profile.notes, *_point_notes(profile)]
    if notes:
        parts.append(Text(""))
        parts += [Text(f"Note: {note}") for note in notes]
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
        table.add_row(key, rule.title or function_name(code), _limit(code, rule))
    return table


def _limit(code: int, rule: FunctionRule) -> str:
    known = FUNCTIONS.get(code)
    if rule.limit is not None:
        return str(rule.limit)
    if known is None or known.table is None:
        return ""
    return "1" if known.limit == 1 else f"{known.limit}, by the standard"


def _exceptions(profile: Profile) -> str:
    rules = profile.exceptions
    documented = ", ".join(f"{code:02X}" for code in rules.documented)
    return (
        f"exceptions: {rules.function:02X} for a function that it lacks, {rules.address:02X} for "
        f"an address outside its areas, {rules.value:02X} for a value or quantity that it does "
        f"not allow; the manual lists {documented}"
    )


def _points(profile: Profile) -> Table:
    table = _table("reference", "point", "type", "values")
    for point in profile.points:
        name = point.name.replace("{n}", "n").replace("{reference}", "(called by its reference)")
        table.add_row(_reference(profile, point), name, point.type.value, _values(point))
    return table


def _reference(profile: Profile, point: Point) -> str:
    """Where a point stands, or the first and the last of its series."""
    first, last = (
        write_reference(profile, point.table, address, point.type.words)
        for address in (point.addresses[0], point.addresses[-1])
    )
    if first == last:
        return first
    return f"{first} .. {last}"


def _values(point: Point) -> str:
    parts = [
        f"{value:04X}H = {text}" if point.type is PointType.HEX16 else f"{value} = {text}"
        for value, text in point.texts.items()
    ]
    if point.count > 1 and point.stride != point.type.words:
        parts.append(f"in steps of {point.stride} addresses")
    unit = f" {point.unit}" if point.unit else ""
    if point.minimum is not None and point.maximum is not None:
        parts.append(f"{point.minimum}..{point.maximum}{unit}")
    elif point.minimum is not None:
        parts.append(f"from {point.minimum}{unit} on")
    elif point.maximum is not None:
        parts.append(f"up to {point.maximum}{unit}")
    elif unit:
        parts.append(f"in{unit}")
    if point.default is not None:
        parts.append(f"default {_default(point, point.default)}")
    return ", ".join(parts)


def _point_notes(profile: Profile) -> list[str]:
    """Each note once, behind all the references that it is about."""
    about: dict[str, list[str]] = {}
    for point in profile.points:
        if point.note is not None:
            about.setdefault(point.note, []).append(_reference(profile, point))
    return [f"{', '.join(references)}: {note}" for note, references in about.items()]


def _default(point: Point, word: int) -> str:
    if point.type.words == 1:
        return Place(point, point.address, "").value([word]).text
    return str(word)


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table
