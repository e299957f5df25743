"""Prints device profiles: files with the contents of a device's manual."""

# Anyone can write a profile, so it may contain markup or control characters; plain() makes them
# harmless.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType

from mbtool.core.moments import counted
from mbtool.devices import Access, ByteOrder, PointInstance, PointType, WordOrder, write_reference
from mbtool.modbus import FUNCTIONS, function_name
from mbtool.views.tables import plain, plain_table

if TYPE_CHECKING:
    from rich.table import Table

    from mbtool.devices import Area, FunctionRule, Point, Profile

_ACCESS = {Access.READ: "read", Access.READ_WRITE: "read, write", Access.WRITE: "write"}


def profile_list(profiles: Sequence[Profile]) -> RenderableType:
    """Return a table with a row for each profile."""
    table = plain_table("name", "device", "transports", "areas", "points")
    for profile in profiles:
        cells = {**profile_record(profile), "transports": ", ".join(profile.transports)}
        table.add_row(*(plain(str(cell)) for cell in cells.values()))
    return table


def profile_record(profile: Profile) -> dict[str, Any]:
    """Return the row of a profile in the list, as JSON data; areas and points are numbers."""
    return {
        "name": profile.name,
        "title": profile.title,
        "transports": list(profile.transports),
        "areas": len(profile.areas),
        "points": sum(len(point.addresses) for point in profile.points),
    }


def profile_page(profile: Profile) -> RenderableType:
    """Return the full contents of a profile: areas, functions, exceptions, points and notes."""
    parts: list[RenderableType] = [
        plain(profile.title, "bold"),
        plain(f"{profile.name}, by {profile.vendor}; {', '.join(profile.transports)}"),
        plain(f"source: {profile.source}"),
        plain(""),
        _areas(profile),
        plain(""),
        _functions(profile),
        plain(""),
        plain(_exceptions(profile)),
    ]
    timing = profile.timing
    silences = [
        ("t1.5 {}", timing.t1_5),
        ("t3.5 {}", timing.t3_5),
        ("at least {} before each request", timing.request_interval),
    ]
    timing_text = ", ".join(text.format(silence) for text, silence in silences if silence)
    if timing_text:
        parts.append(plain(f"timing: {timing_text}"))
    if profile.last_unit is not None:
        parts.append(plain(f"units: 1 to {profile.last_unit}"))
    if profile.any_unit:
        parts.append(plain("units: it answers whatever unit a request names"))
    if profile.points:
        parts += [plain(""), _points(profile)]
    notes = [*profile.notes, *_point_notes(profile)]
    if notes:
        parts.append(plain(""))
        parts += [plain(f"Note: {' '.join(note.split())}") for note in notes]
    return Group(*parts)


def _areas(profile: Profile) -> Table:
    """Areas with the same references stand together, under the name of the first one: they are ways
    to the same registers or bits.
    """
    table = plain_table("area", "references", "addresses", "table", "access")
    groups: dict[tuple[str, str], list[Area]] = {}
    for area in profile.areas:
        name, span = area.name.partition(",")[0], area.span(area.first, area.last)
        groups.setdefault((name, span), []).append(area)
    for (name, span), areas in groups.items():
        for number, area in enumerate(areas):
            cells = (
                "" if number else name,
                "" if number else span,
                f"{area.first:04X}..{area.last:04X}",
                area.table.value.replace("_", " "),
                _ACCESS[area.access],
            )
            table.add_row(*map(plain, cells))
    return table


def _functions(profile: Profile) -> Table:
    table = plain_table("function", "name", "at most")
    for key, rule in sorted(profile.functions.items()):
        code = int(key, 16)
        silent = "" if rule.answers else ", without an answer"
        data = "" if rule.data is None else f" (data {rule.data.upper()})"
        name = f"{rule.title or function_name(code)}{data}{silent}"
        table.add_row(key, plain(name), _limit(code, rule))
    return table


def _limit(code: int, rule: FunctionRule) -> str:
    known = FUNCTIONS.get(code)
    if rule.limit is not None:
        in_ascii = "" if rule.ascii_limit is None else f", in ASCII {rule.ascii_limit}"
        to_write = "" if rule.write_limit is None else f" to read, {rule.write_limit} to write"
        doubtful = ", which is doubtful" if rule.doubtful else ""
        return f"{rule.limit}{to_write}{in_ascii}{doubtful}"
    if known is None or known.table is None:
        return ""
    return "1" if known.limit == 1 else f"{known.limit}, by the standard"


def _exceptions(profile: Profile) -> str:
    rules = profile.exceptions
    documented = ", ".join(
        f"{code:02X} {rules.texts[code]}" if code in rules.texts else f"{code:02X}"
        for code in rules.documented
    )
    others = [
        (key, rule.value)
        for key, rule in sorted(profile.functions.items())
        if rule.value not in (None, rules.value)
    ]
    named = ", ".join(f"{code:02X} of function {key}" for key, code in others)
    return (
        f"exceptions: {rules.function:02X} for a function that it lacks, {rules.address:02X} for "
        f"an address outside its areas, {rules.value:02X} for a value or quantity that it does "
        f"not allow{f' ({named})' if named else ''}; the manual lists {documented}"
    )


def _points(profile: Profile) -> Table:
    table = plain_table("reference", "point", "type", "values")
    for point in profile.points:
        name = point.name.replace("{n}", "n").replace("{reference}", "(called by its reference)")
        cells = (_reference(profile, point), name, _type(point), _values(profile, point))
        table.add_row(*map(plain, cells))
    return table


def _reference(profile: Profile, point: Point) -> str:
    """Return the reference of a point (named value), such as `HR400001`.

    A point may stand for several registers of one kind: then the first and last reference.
    """
    writing = not point.allows(writing=False)
    first, last = (
        write_reference(profile, point.table, address, point.words, writing=writing)
        for address in (point.addresses[0], point.addresses[-1])
    )
    if first == last:
        return first
    return f"{first} .. {last}"


def _type(point: Point) -> str:
    parts = [point.type.value]
    if point.type is PointType.STRING:
        parts.append(f"{point.words} registers")
    if point.words > 1 and point.word_order is WordOrder.LOW_FIRST:
        parts.append("low word first")
    if point.byte_order is ByteOrder.LOW_FIRST:
        parts.append("low byte first")
    return ", ".join(parts)


def _values(profile: Profile, point: Point) -> str:
    parts = [f"bit {bit} = {name}" for bit, name in sorted(point.bits.items())]
    parts += [
        f"{value:04X}H = {text}" if point.type is PointType.HEX16 else f"{value} = {text}"
        for value, text in point.texts.items()
    ]
    if point.count > 1 and point.stride != point.words:
        parts.append(f"in steps of {point.stride} addresses")
    parts += [*_scale(point), *_range(point)]
    if point.default is not None:
        parts.append(f"default {_default(point, point.default)}")
    if point.block is not None:
        parts.append(f"in a read from {write_reference(profile, point.table, point.block)} on")
    area = profile.area(point.table, point.address, point.words)
    if point.access is not None and area is not None and area.access is not point.access:
        parts.append(f"{_ACCESS[point.access]} only")
    return ", ".join(parts)


def _scale(point: Point) -> list[str]:
    """Return the formula from register to value and the decimals: `number x 0.1`, `2 decimals`."""
    formula = "" if point.scale == 1 else f" x {point.scale:g}"
    if point.scale_from is not None:
        formula += f" x 10^{point.scale_from}"
    if point.offset:
        formula += f" {'+' if point.offset > 0 else '-'} {abs(point.offset):g}"
    ranged = point.minimum is not None or point.maximum is not None
    unit = f" {point.unit}" if point.unit and not ranged else ""
    parts = [f"number{formula}{unit}"] if formula else []
    if point.decimals is not None:
        parts.append(counted(point.decimals, "decimal"))
    if point.no_value is not None:
        parts.append(f"{point.no_value} is no value")
    return parts


def _range(point: Point) -> list[str]:
    unit = f" {point.unit}" if point.unit else ""
    if point.minimum is not None and point.maximum is not None:
        return [f"{point.minimum}..{point.maximum}{unit}"]
    if point.minimum is not None:
        return [f"from {point.minimum}{unit} on"]
    if point.maximum is not None:
        return [f"up to {point.maximum}{unit}"]
    return [f"in{unit}"] if unit and not _is_scaled(point) else []


def _is_scaled(point: Point) -> bool:
    return point.scale != 1 or bool(point.offset) or point.scale_from is not None


def _point_notes(profile: Profile) -> list[str]:
    """Return each note of points only once, after the references of all points that have it."""
    about: dict[str, list[str]] = {}
    for point in profile.points:
        if point.note is not None:
            about.setdefault(point.note, []).append(_reference(profile, point))
    return [f"{', '.join(references)}: {note}" for note, references in about.items()]


def _default(point: Point, word: int) -> str:
    if point.words == 1:
        return PointInstance(point, point.address, "").value([word]).text
    return str(word)
