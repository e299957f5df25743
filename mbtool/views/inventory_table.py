"""Prints an inventory: a row for each unit of each host, with details below it."""

#     host           unit  role     profile
#     192.168.3.250     1  slave    wago-750 91
#           seen 2026-11-22 09:14:03 .. 09:20:11, 812 transactions, 3 without answer
#           MAC 00:30:de:11:22:33 WAGO Kontakttechnik GmbH
#           says vendor "WAGO", product code "750-352"
#           03 read holding 0..99, 200; 800 times by 192.168.3.9
#           10 write registers 10..12; 12 times by 192.168.3.9
#
# On a terminal, long lines are wrapped. The units that never answered a master share one line,
# unless the caller asks for `everything`.

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.text import Text

from mbtool.core.moments import counted
from mbtool.ledger.baseline import ChangeKind, InventoryChange
from mbtool.ledger.inventory_ranges import (
    MAX_RANGES,
    AddressRange,
    AddressRanges,
    listed,
    ranges_text,
)
from mbtool.ledger.inventory_rows import Role, iso_time
from mbtool.modbus import FUNCTIONS, Transport, exception_name
from mbtool.modbus.functions import READ_WRITE_REGISTERS
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from rich.console import Console

    from mbtool.ledger.inventory_rows import (
        FunctionUse,
        InventoryDocument,
        MasterRow,
        ProfileFit,
        SlaveRow,
    )

# The code below prints how an inventory (who talks to whom, and which ranges) differs from an older
# one.
#
# A line has the kind of change, the host with its unit, and a text:
#
#     new host          10.0.0.66 unit 1    asked by 10.0.0.5
#     wider range       10.0.0.7 unit 1     03 read holding reads 100..119 by 10.0.0.5

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


UNKNOWN = "unknown"
"""Stands for the profile of a unit whose traffic tells none."""
_HANG = " " * 6
_FEW_RANGES = 12
_FEW_PLACES = 6
_MANY_ROWS = 60
"""If there are more units than this, units with equal details share one row."""
_QUIET = (Role.SILENT, Role.UNHEARD)
_SLAVE_HEADINGS = ("host", "unit", "role", "profile")
_MASTER_HEADINGS = ("master", "asks", "writes to", "requests", "seen")
_NUMBERS = frozenset(("unit", "asks", "writes to", "requests"))

_Entry = tuple[tuple[str, ...], str, "list[str]"]
"""A table row: its cells, its style for the library rich, and the lines of details under it."""


def print_inventory(
    console: Console, document: InventoryDocument, *, everything: bool = False
) -> None:
    """Print all units, then the masters.

    With `everything`, each unit that never answered has its own row, lists of ranges are not
    shortened, and units with equal details do not share a row.
    """
    most = MAX_RANGES if everything else _FEW_RANGES
    shown = [row for row in document.slaves if everything or row.role not in _QUIET]
    entries = [_slave_entry(row, most) for row in shown]
    if len(shown) > _MANY_ROWS and not everything:
        entries = list(_folded(shown, entries))
    _print(console, _SLAVE_HEADINGS, entries)
    if not everything:
        for line in _quiet_lines(document.slaves):
            _print_line(console, line, "  ", "yellow")
    if document.masters and document.slaves:
        console.print()
    _print(console, _MASTER_HEADINGS, [_master_entry(row) for row in document.masters])


def profile_text(row: SlaveRow) -> str:
    """Return the profile that fits a slave best, with its score of 0 to 100: `wago-750 91`.

    It is `NAME (named)` if the user named the profile, UNKNOWN if none is sure, and empty if the
    traffic was compared with no profile.
    """
    if row.device is not None:
        return f"{row.device} (named)"
    if row.fit is None:
        return ""
    return UNKNOWN if row.fit.profile is None else f"{row.fit.profile} {row.fit.score}"


def mac_text(macs: Sequence[str], makers: Sequence[str]) -> str:
    return " ".join((", ".join(macs), ", ".join(makers))).strip()


def identity_text(row: SlaveRow) -> str:
    """Return the identity that a slave reports: `vendor "WAGO", 42H model code "0003H"`."""
    return ", ".join(
        f'{"" if one.function in FUNCTIONS else f"{one.function:02X}H "}{one.name} "{one.text}"'
        for one in row.identity
    )


def function_label(function: int, name: str) -> str:
    """Return a function as code and name: `03 read holding`.

    `name` is used if the code is not standard.
    """
    known = FUNCTIONS.get(function)
    return f"{function:02X} {name if known is None else known.short}"


def seen_text(first_ns: int, last_ns: int) -> str:
    """Return two times (ns since 1970) as a range, the day only once: `2026-11-22 09:14:03 ..

    09:20:11`.
    """
    first, last = (iso_time(ns)[:19].replace("T", " ") for ns in (first_ns, last_ns))
    if first == last:
        return first
    return f"{first} .. {last[11:] if first[:10] == last[:10] else last}"


def _slave_entry(row: SlaveRow, most: int) -> _Entry:
    cells = (
        row.where,
        str(row.unit),
        row.role.value,
        profile_text(row),
    )
    style = "yellow" if row.role in _QUIET else ""
    return cells, style, slave_lines(row, most)


def _folded(rows: Sequence[SlaveRow], entries: Sequence[_Entry]) -> Iterator[_Entry]:
    """Yield the entries, with those joined into one that differ only in host, MAC and times.

    A joined entry shows the first unit, and lists the hosts of the others. `rows` has the unit of
    each entry.
    """
    alike: dict[tuple[object, ...], list[int]] = {}
    for index, (row, (cells, _, lines)) in enumerate(zip(rows, entries, strict=True)):
        told = [line for line in lines[1:] if line not in _mac_lines(row)]
        alike.setdefault((*cells[1:], *told), []).append(index)
    for several in alike.values():
        cells, style, lines = entries[several[0]]
        if len(several) > 1:
            others = [rows[index].where for index in several[1:]]
            lines = [
                *lines,
                f"and so {counted(len(others), 'host', ',')} more: {listed(others, _FEW_PLACES)}",
            ]
        yield cells, style, lines


def _master_entry(row: MasterRow) -> _Entry:
    cells = (
        row.host,
        f"{row.slaves:,}",
        f"{row.written:,}",
        f"{row.requests:,}",
        seen_text(row.first_ns, row.last_ns),
    )
    return cells, "", _mac_lines(row)


def _mac_lines(row: SlaveRow | MasterRow) -> list[str]:
    return [f"MAC {mac_text(row.macs, row.makers)}"] if row.macs else []


def slave_lines(row: SlaveRow, most: int = _FEW_RANGES) -> list[str]:
    """Return the lines of details below the row of a unit.

    `most` limits the ranges on each line.
    """
    return list(_lines(row, most))


def _lines(row: SlaveRow, most: int) -> Iterator[str]:
    counts = [one for one in row.transports if one != Transport.TCP]
    counts.append(f"seen {seen_text(row.first_ns, row.last_ns)}")
    counts.append(counted(row.transactions, "transaction", ","))
    if row.unanswered > row.unreached:
        counts.append(f"{row.unanswered - row.unreached:,} without answer")
    if row.unreached:
        counts.append(f"{row.unreached:,} that its gateway could not deliver")
    yield ", ".join(counts)
    yield from _mac_lines(row)
    if row.identity:
        yield f"says {identity_text(row)}"
    fit = row.fit
    if fit is not None:
        if fit.profile is not None:
            yield f"fits {fit.profile}, by {fit.why}"
        else:
            alone = "by its traffic alone its " if row.device else ""
            yield f"{alone}profile is not known: {fit.why}{_nearest_text(fit)}"
    yield from _use_lines(row.uses, most)
    if row.exceptions:
        texts = (
            f"{code:02X} {exception_name(code)} {_times(count)}"
            for code, count in row.exceptions.items()
        )
        yield f"exceptions: {', '.join(texts)}"


def _nearest_text(fit: ProfileFit) -> str:
    """Return which profile is the most alike, unless the reason why none fits names it."""
    if fit.nearest is None or fit.why_names_nearest:
        return ""
    return f"; the most alike is {fit.nearest}, score {fit.score} of 100"


def _use_lines(uses: Sequence[FunctionUse], most: int) -> Iterator[str]:
    """Yield a line for each function; masters that use it on the same ranges share a line.

    Functions that the unit always refused as unsupported share one line at the end. `most` limits
    the address ranges on each line.
    """
    groups: dict[tuple[object, ...], list[FunctionUse]] = {}
    lacking = []
    for use in uses:
        if use.requests and use.unsupported == use.requests:
            lacking.append(use)
            continue
        key = (use.function, use.writes, tuple(use.ranges), tuple(use.refused))
        groups.setdefault(key, []).append(use)
    for several in groups.values():
        yield _use_line(several, most)
    if lacking:
        by = _masters("; asked by", lacking)
        yield f"functions that it refuses as unknown: {_codes(use.function for use in lacking)}{by}"


def _use_line(several: Sequence[FunctionUse], most: int) -> str:
    """Return a line with a function, its address ranges, and the masters that use these ranges.

    `several` has an item for each of these masters. `most` limits the ranges that are listed.
    """
    first = several[0]
    label = function_label(first.function, first.name)
    if first.function == READ_WRITE_REGISTERS:
        label += " (writes)" if first.writes else " (reads)"
    parts = [f"{label} {_addresses(first.ranges, first.references, most)}".rstrip()]
    if first.refused:
        parts.append(f"refused {_addresses(first.refused, first.refused_references, most)}")
    if any(one.left_out for one in several):
        parts.append("more ranges than are kept")
    count = sum(one.requests for one in several)
    parts.append((_times(count) if count else "answers only") + _masters(" by", several))
    return "; ".join(parts)


def _addresses(ranges: Sequence[AddressRange], references: Sequence[str], most: int) -> str:
    """Return ranges of addresses, and behind them what the unit's profile calls them."""
    known = [one for one in references if one]
    names = f" ({listed(known, most)})" if known else ""
    return f"{ranges_text(ranges, most)}{names}"


def _masters(word: str, uses: Iterable[FunctionUse]) -> str:
    """Return `word` and the addresses of the masters, such as `by 192.168.3.9`.

    The text is empty on a serial line, where masters have no addresses.
    """
    names = listed(list(dict.fromkeys(one.master for one in uses if one.master is not None)))
    return f"{word} {names}" if names else ""


def _codes(codes: Iterable[int]) -> str:
    """Write function codes in hexadecimal; consecutive codes become a range: `02..04, 07`."""
    return ", ".join(
        f"{first:02X}" if first == last else f"{first:02X}..{last:02X}"
        for first, last in AddressRanges((code, code) for code in codes).pairs
    )


def _quiet_lines(slaves: Sequence[SlaveRow]) -> Iterator[str]:
    """Yield one line for each master whose requests to some units were never answered."""
    groups: dict[tuple[Role, str | None], list[SlaveRow]] = {}
    for row in slaves:
        if row.role in _QUIET:
            groups.setdefault((row.role, next(iter(row.masters()), None)), []).append(row)
    for (role, master), rows in groups.items():
        hosts = list(dict.fromkeys(row.where for row in rows))
        if len(hosts) == 1:
            units = listed([str(row.unit) for row in rows], _FEW_RANGES)
            where = f"{hosts[0]} unit{'' if len(rows) == 1 else 's'} {units}"
        else:
            where = f"{counted(len(hosts), 'host', ',')}: {listed(hosts, _FEW_PLACES)}"
        by = f", asked by {master}" if master is not None else ""
        what = "no answer from" if role is Role.SILENT else "answers not captured of"
        yield f"{what} {where}{by}"


def _print(console: Console, headings: Sequence[str], entries: Sequence[_Entry]) -> None:
    """Print a table whose rows have lines of details under them."""
    if not entries:
        return
    columns = list(zip(*(cells for cells, _, _ in entries), strict=True))
    widths = [max(map(len, column)) for column in columns]
    # A column whose cells are all empty gets width 0 and is not shown.
    widths = [
        max(width, len(heading)) if width else 0
        for heading, width in zip(headings, widths, strict=True)
    ]

    def line(cells: Sequence[str]) -> str:
        texts = (
            printable(cell).rjust(width) if heading in _NUMBERS else printable(cell).ljust(width)
            for heading, cell, width in zip(headings, cells, widths, strict=True)
            if width
        )
        return "  ".join(texts).rstrip()

    console.print(Text(line(headings), "bold"), soft_wrap=True)
    for cells, style, under in entries:
        console.print(Text(line(cells), style or "bold cyan"), soft_wrap=True)
        for text in under:
            _print_line(console, text, _HANG)


def _print_line(console: Console, text: str, indent: str, style: str = "") -> None:
    """Print a line behind the spaces `indent`.

    On a terminal it is wrapped, and each part is indented; on a pipe it stays one line.
    """
    lines = [printable(text)]
    if console.is_terminal:
        width = max(console.width, _NARROWEST)
        lines = wrap(
            lines[0],
            width - len(indent),
            subsequent_indent="  ",
            break_on_hyphens=False,
        )
    for one in lines:
        console.print(Text(indent + one, style), soft_wrap=True)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count:,} times"
