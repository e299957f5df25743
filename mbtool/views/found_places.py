"""Shows the places of numbers that were looked for, and of a setting that was changed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mbtool.devices.point_types import PointType
from mbtool.devices.references import write_reference
from mbtool.values.finding import LIKELY, ChangedPlace, FoundPlace, Wanted
from mbtool.values.reasons import span_of
from mbtool.views.tables import plain, plain_table

if TYPE_CHECKING:
    from rich.table import Table

    from mbtool.values.word_readings import WordReading

LEAST_SHOWN = 0.01


def wanted_title(wanted: Wanted) -> str:
    """What was looked for, in a line: `Voltage = 236.8 V`."""
    seen = ", ".join(f"{one.value:g}" for one in wanted.sightings[:6])
    seen += f" and {len(wanted.sightings) - 6} more" if len(wanted.sightings) > 6 else ""
    name = f"{wanted.name} = " if wanted.name else ""
    return f"{name}{seen}{f' {wanted.unit}' if wanted.unit else ''}"


def places_table(places: Sequence[FoundPlace], unit: str, *, several_slaves: bool) -> Table:
    """The places of a number, the most probable first."""
    first = ["slave"] if several_slaves else []
    table = plain_table("likely", *first, "register", "type", "scale", "in the recording")
    for one in places:
        style = "bold" if one.likelihood >= LIKELY else ""
        cells = [
            percent(one.likelihood),
            *([one.slave] if several_slaves else []),
            write_reference(None, one.table, one.address, one.reading.words),
            type_text(one.reading),
            "" if not one.power else f"x {one.scale:g}",
            _span(one, unit),
        ]
        table.add_row(*(plain(cell, style) for cell in cells))
    return table


def changes_table(changes: Sequence[ChangedPlace], *, several_slaves: bool) -> Table:
    """The values that may be the changed setting, the most probable first."""
    first = ["slave"] if several_slaves else []
    table = plain_table("likely", *first, "register", "type", "before", "after", "")
    for one in changes:
        judged = one.judged
        is_text = judged.reading.type is PointType.STRING
        cells = [
            percent(one.likelihood),
            *([one.slave] if several_slaves else []),
            write_reference(None, judged.table, judged.address, judged.words),
            type_text(judged.reading),
            "a text" if is_text else span_of(one.before),
            "another text" if is_text else span_of(one.after),
            "written by a master" if one.is_written else "",
        ]
        style = "bold" if one.likelihood >= LIKELY else ""
        table.add_row(*(plain(cell, style) for cell in cells))
    return table


def percent(likelihood: float) -> str:
    """A likelihood in percent; never 100, as nothing is certain."""
    return (
        f"{min(100 * likelihood, 99.9):.1f} %"
        if likelihood < 0.1
        else (f"{min(round(100 * likelihood), 99)} %")
    )


def type_text(reading: WordReading) -> str:
    """A type and the order of its bytes: `int32 CDAB`."""
    return f"{reading.type} {reading.order}" if reading.words > 1 else str(reading.type)


def _span(one: FoundPlace, unit: str) -> str:
    low, high = f"{one.low:.7g}", f"{one.high:.7g}"
    span = low if low == high else f"{low} to {high}"
    never = f", never {one.outside[0]:.7g}" if one.outside else ""
    return f"{span}{f' {unit}' if unit else ''}{never}"


def found_document(
    wanted: Sequence[Wanted], found: Sequence[Sequence[FoundPlace]]
) -> list[dict[str, Any]]:
    """All places, for JSON."""
    return [
        {
            "name": one.name,
            "values": [seen.value for seen in one.sightings],
            "unit": one.unit,
            "places": [
                {
                    "likelihood": round(place.likelihood, 6),
                    "slave": place.slave,
                    "table": place.table,
                    "address": place.address,
                    "type": place.reading.type,
                    "order": place.reading.order if place.reading.words > 1 else None,
                    "scale": place.scale,
                    "low": place.low,
                    "high": place.high,
                    "outside": list(place.outside),
                }
                for place in places
            ],
        }
        for one, places in zip(wanted, found, strict=True)
    ]


def changed_document(changes: Sequence[ChangedPlace]) -> list[dict[str, Any]]:
    """All values that changed, for JSON."""
    return [
        {
            "likelihood": round(one.likelihood, 6),
            "slave": one.slave,
            "table": one.judged.table,
            "address": one.judged.address,
            "type": one.judged.reading.type,
            "order": one.judged.reading.order if one.judged.words > 1 else None,
            "before": one.before[-1],
            "after": one.after[-1],
            "written": one.is_written,
        }
        for one in changes
    ]
