"""Reads the transactions of a recording that is to be played."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import CutError, DamageError, UsageError, WireEvent
from mbtool.modbus import Outcome
from mbtool.workflows.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.devices import Assignments, NamedTransaction


class Recorded(NamedTuple):
    """What is to be played, and the devices in it."""

    transactions: list[NamedTransaction]
    assignments: Assignments


def read_recorded(
    path: str,
    options: ReadingOptions,
    wanted: Callable[[NamedTransaction], bool],
    on_cut: Callable[[CutError | DamageError], None],
    on_remark: Callable[[str], None] = lambda _: None,
) -> Recorded:
    """The transactions of a capture or a log, in the order in which they ended.

    Of a file that is cut or damaged what is there is given, and `on_cut` is told; `on_remark` is
    told what else there is to know of it. Raises InputError, and UsageError for a unit that is on
    several links.
    """
    transactions: list[NamedTransaction] = []
    reading = Reading([path], options)
    try:
        for record in reading.records():
            if not isinstance(record, WireEvent) and wanted(record):
                transactions.append(record)
    except (CutError, DamageError) as error:
        on_cut(error)
    for remark in reading.remarks:
        on_remark(remark)
    _demand_one_slave_each(path, transactions)
    return Recorded(transactions, reading.assignments)


def _demand_one_slave_each(path: str, transactions: list[NamedTransaction]) -> None:
    """A unit that several recorded slaves share could only be played as a mixture of them."""
    links: dict[int, set[str]] = defaultdict(set)
    for one in transactions:
        if one.outcome not in (Outcome.BROADCAST, Outcome.UNSOLICITED):
            links[one.unit].add(one.link)
    for unit, names in sorted(links.items()):
        if len(names) > 1:
            few = sorted(names)[:4]
            more = f" and {len(names) - len(few)} more" if len(names) > len(few) else ""
            raise UsageError(
                f"{path}: unit {unit} is on several links ({', '.join(few)}{more}); "
                f"choose one with --where 'link == \"{few[0]}\"'"
            )
