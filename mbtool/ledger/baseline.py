"""Compares an inventory with an older one, and reports the changes."""

# Each change is reported only once:
#
# - for a new host or a new unit, no further changes (functions, addresses, texts) are reported;
# - a master that sends its first request to a unit is one change, with its functions and addresses;
#   it is a "new writer" if it writes to the unit and did not do so before;
# - a new function is reported with its addresses, a known function only with addresses that the
#   older inventory does not have;
# - a new identity text is a change only if the older inventory shows requests with the function
#   that gave it. Run indicators are ignored, as they change when a machine starts or stops;
# - all units that a master asked and that never answered are one change, as after a scan.
#
# A master that is missing in the newer inventory is no change: its requests may be rarer than a
# capture is long.
#
# The name of a serial line is that of a port or of a file, so it may differ between two captures.
# If each inventory has exactly one serial line, both are taken for the same line.

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING

import msgspec

from mbtool.ledger.inventory_ranges import joined_ranges, listed, ranges_text, without
from mbtool.ledger.inventory_rows import Role, shown_host
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.identification import RUN_INDICATOR

if TYPE_CHECKING:
    from mbtool.ledger.inventory_rows import FunctionUse, InventoryDocument, MasterRow, SlaveRow

_UNANSWERED = (Role.SILENT, Role.UNHEARD)


class ChangeKind(StrEnum):
    """The kinds of changes between an older and a newer inventory, in the order of a report."""

    HOST = "new host"
    UNIT = "new unit"
    WRITER = "new writer"
    MASTER = "new master"
    FUNCTION = "new function"
    RANGE = "wider range"
    IDENTITY = "changed identity"
    MAC = "changed MAC"
    SILENT = "gone silent"


class InventoryChange(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One change between an older and a newer inventory."""

    kind: ChangeKind
    host: str
    port: int | None = None
    unit: int | None = None
    text: str
    first_ns: int | None = None
    """The time (UTC ns) at which the newer capture first shows the unit, host or master of this
    change; None if the newer capture lacks it."""

    @property
    def where(self) -> str:
        place = shown_host(self.host, self.port)
        return place if self.unit is None else f"{place} unit {self.unit}"


def changes(old: InventoryDocument, new: InventoryDocument) -> list[InventoryChange]:
    """Return the changes from `old` to `new`, in the order of ChangeKind."""
    old = _with_line_of(old, new)
    known = {_key(row): row for row in old.slaves}
    old_hosts = {row.place for row in old.slaves}
    old_masters = {row.host for row in old.masters}
    found = list(_new_places(new, known, old_hosts))
    for row in new.slaves:
        before = known.get(_key(row))
        if before is not None:
            found += _unit_changes(before, row, old_masters)
    found += _macs(old, new)
    found += _absent(old, new)
    order = list(ChangeKind)
    return sorted(found, key=lambda one: order.index(one.kind))


def _key(row: SlaveRow) -> tuple[str, int | None, int]:
    return row.host, row.port, row.unit


def _with_line_of(old: InventoryDocument, new: InventoryDocument) -> InventoryDocument:
    """Return the older inventory, made comparable with the newer one.

    If each of the two has exactly one serial line, the older line gets the name of the newer one,
    so that their units are compared.
    """
    old_lines = {row.host for row in old.slaves if row.port is None}
    new_lines = {row.host for row in new.slaves if row.port is None}
    if len(old_lines) != 1 or len(new_lines) != 1 or old_lines == new_lines:
        return old
    (name,) = new_lines
    rows = [
        msgspec.structs.replace(row, host=name) if row.port is None else row for row in old.slaves
    ]
    return msgspec.structs.replace(old, slaves=rows)


def _new_places(
    new: InventoryDocument,
    known: dict[tuple[str, int | None, int], SlaveRow],
    old_hosts: set[tuple[str, int | None]],
) -> Iterator[InventoryChange]:
    """Yield a change for each host and each unit that only the newer inventory has.

    `known` has the older inventory's units by host, port and unit number; `old_hosts` has its pairs
    of host and port.
    """
    places: dict[tuple[str, int | None], list[SlaveRow]] = {}
    scanned: dict[tuple[str | None, ChangeKind], list[SlaveRow]] = {}
    for row in new.slaves:
        if _key(row) in known:
            continue
        if row.role in _UNANSWERED:
            kind = ChangeKind.UNIT if row.place in old_hosts else ChangeKind.HOST
            asker = next(iter(row.masters()), None)
            scanned.setdefault((asker, kind), []).append(row)
        else:
            places.setdefault(row.place, []).append(row)
    for place, rows in places.items():
        if place in old_hosts:
            yield from (_place_change(ChangeKind.UNIT, [row]) for row in rows)
        else:
            yield _place_change(ChangeKind.HOST, rows)
    for (_, kind), rows in scanned.items():
        yield _place_change(kind, rows)


def _place_change(kind: ChangeKind, rows: Sequence[SlaveRow]) -> InventoryChange:
    first = rows[0]
    silent = ", never answered" if first.role in _UNANSWERED else ""
    asked = _asked_by(rows)
    places = list(dict.fromkeys(row.where for row in rows))
    if len(places) > 1:
        return InventoryChange(
            kind=kind,
            host=first.host,
            port=first.port,
            text=f"{listed(places)}{asked}{silent}",
            first_ns=min(row.first_ns for row in rows),
        )
    units = "" if len(rows) == 1 else f"units {listed([str(row.unit) for row in rows])}"
    return InventoryChange(
        kind=kind,
        host=first.host,
        port=first.port,
        unit=first.unit if len(rows) == 1 else None,
        text=f"{units}{asked}{silent}".strip(" ,") or "heard for the first time",
        first_ns=min(row.first_ns for row in rows),
    )


def _asked_by(rows: Iterable[SlaveRow]) -> str:
    masters = list(dict.fromkeys(master for row in rows for master in row.masters()))
    return f" asked by {listed(masters)}" if masters else ""


def _unit_changes(
    before: SlaveRow, row: SlaveRow, old_masters: set[str]
) -> Iterator[InventoryChange]:
    """Yield the changes of one unit that both inventories have.

    `before` is its row in the older inventory, `row` that in the newer one. `old_masters` are the
    hosts of all masters in the older inventory.
    """

    def change(kind: ChangeKind, text: str) -> InventoryChange:
        return InventoryChange(
            kind=kind,
            host=row.host,
            port=row.port,
            unit=row.unit,
            text=text,
            first_ns=row.first_ns,
        )

    writers = _only_new(row.masters(writing=True), before.masters(writing=True))
    readers = [one for one in _only_new(row.masters(), before.masters()) if one not in writers]
    for kind, masters in ((ChangeKind.WRITER, writers), (ChangeKind.MASTER, readers)):
        for master in masters:
            known = "" if master in old_masters else " (a new host)"
            yield change(kind, f"{master}{known}: {_requested_text(row, master, kind)}")
    told = {*writers, *readers}
    uses = [use for use in row.uses if use.master not in told]
    for function in dict.fromkeys(use.function for use in uses):
        mine = [use for use in uses if use.function == function]
        theirs = [use for use in before.uses if use.function == function]
        if not theirs:
            yield change(ChangeKind.FUNCTION, "; ".join(_use_text(use) for use in mine))
            continue
        yield from (change(ChangeKind.RANGE, text) for text in _wider(mine, theirs))
    yield from (change(ChangeKind.IDENTITY, text) for text in _identity(before, row))
    if before.answered and not row.answered and row.unanswered:
        count = row.unanswered
        yield change(ChangeKind.SILENT, f"asked {count:,} times, and never answered")


def _requested_text(row: SlaveRow, master: str, kind: ChangeKind) -> str:
    """Return a text with the functions and addresses that a new master requests from a unit.

    If `kind` is WRITER, the text has only the functions that write.
    """
    is_writer = kind is ChangeKind.WRITER
    uses = [use for use in row.uses if use.master == master and (use.writes or not is_writer)]
    return "; ".join(_use_text(use, with_master=False) for use in uses)


def _wider(mine: Sequence[FunctionUse], theirs: Sequence[FunctionUse]) -> Iterator[str]:
    for writes in (False, True):
        uses = [use for use in mine if use.writes is writes]
        old = joined_ranges(use.all_ranges for use in theirs if use.writes is writes)
        more = without(joined_ranges(use.all_ranges for use in uses), old)
        if more:
            masters = [use.master for use in uses if use.master and without(use.all_ranges, old)]
            by = f" by {listed(masters)}" if masters else ""
            use = uses[0]
            verb = "writes" if writes else "reads"
            yield f"{use.function:02X} {use.name} {verb} {ranges_text(more)}{by}"


def _identity(before: SlaveRow, row: SlaveRow) -> Iterator[str]:
    functions = {use.function for use in before.uses}
    old, new = _texts(before), _texts(row)
    for (function, name), texts in new.items():
        if name == RUN_INDICATOR or function not in functions:
            continue
        had = old.get((function, name), [])
        more = [text for text in texts if text not in had]
        if more:
            was = f"{_quoted(had)} -> " if had else "not given before -> "
            yield f"{name}: {was}{_quoted(more)}"


def _macs(old: InventoryDocument, new: InventoryDocument) -> Iterator[InventoryChange]:
    """Yield a change for each host, of a slave or a master, that has a new MAC address."""
    before: dict[str, list[str]] = {}
    old_rows: list[SlaveRow | MasterRow] = [*old.slaves, *old.masters]
    new_rows: list[SlaveRow | MasterRow] = [*new.slaves, *new.masters]
    for row in old_rows:
        before.setdefault(row.host, []).extend(row.macs)
    told = set()
    for row in new_rows:
        had = before.get(row.host)
        more = [mac for mac in row.macs if had and mac not in had]
        if more and row.host not in told:
            told.add(row.host)
            makers = f" ({', '.join(row.makers)})" if row.makers else ""
            yield InventoryChange(
                kind=ChangeKind.MAC,
                host=row.host,
                text=f"{', '.join(dict.fromkeys(had or ()))} -> {', '.join(more)}{makers}",
                first_ns=row.first_ns,
            )


def _absent(old: InventoryDocument, new: InventoryDocument) -> Iterator[InventoryChange]:
    """Yield a change for each host with units that answered in the older inventory and are missing
    in the newer one. One change names all these units of a host.
    """
    present = {_key(row) for row in new.slaves}
    gone: dict[tuple[str, int | None], list[SlaveRow]] = {}
    for row in old.slaves:
        if row.answered and _key(row) not in present:
            gone.setdefault(row.place, []).append(row)
    for (host, port), rows in gone.items():
        units = listed([str(row.unit) for row in rows])
        yield InventoryChange(
            kind=ChangeKind.SILENT,
            host=host,
            port=port,
            unit=rows[0].unit if len(rows) == 1 else None,
            text="neither asked nor heard"
            if len(rows) == 1
            else f"units {units}: neither asked nor heard",
        )


def _texts(row: SlaveRow) -> dict[tuple[int, str], list[str]]:
    texts: dict[tuple[int, str], list[str]] = {}
    for one in row.identity:
        texts.setdefault((one.function, one.name), []).append(one.text)
    return texts


def _only_new(new: Sequence[str], old: Sequence[str]) -> list[str]:
    return [one for one in new if one not in old]


def _use_text(use: FunctionUse, *, with_master: bool = True) -> str:
    ranges = ranges_text(use.all_ranges)
    verb = f" {'writes' if use.writes else 'reads'} {ranges}" if ranges else ""
    by = f" by {use.master}" if with_master and use.master is not None else ""
    known = FUNCTIONS.get(use.function)
    name = use.name if known is None else known.short
    return f"{use.function:02X} {name}{verb}{by}"


def _quoted(texts: Iterable[str]) -> str:
    return ", ".join(f'"{text}"' for text in texts)
