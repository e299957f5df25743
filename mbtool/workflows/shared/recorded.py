"""Reads the transactions of a recording that is to be played."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import CutError, DamageError, UsageError, WireEvent
from mbtool.modbus import Outcome
from mbtool.replay import TimeRange
from mbtool.replay.damaged import DAMAGED_KINDS
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.devices import Assignments, NamedTransaction

Watch = Callable[[Reading, "Iterator[Record]"], "Iterator[Record]"]
"""Passes records on, and may show how far their reading has come."""


def unwatched(_: Reading, records: Iterator[Record]) -> Iterator[Record]:
    return records


class Recorded(NamedTuple):
    """What is to be played, and the devices in it."""

    transactions: list[NamedTransaction]
    assignments: Assignments
    damage: list[WireEvent]
    """Bytes that could not be read."""


def read_recorded(
    path: str,
    options: ReadingOptions,
    wanted: Callable[[NamedTransaction], bool],
    on_cut: Callable[[CutError | DamageError], None],
    on_remark: Callable[[str], None] = lambda _: None,
    watch: Watch = unwatched,
) -> Recorded:
    """The transactions of a capture or a log, in the order in which they ended.

    Of a file that is cut or damaged what is there is given, and `on_cut` is told; `on_remark` is
    told what else there is to know of it. Raises InputError, and UsageError for a unit that is on
    several links.
    """
    transactions: list[NamedTransaction] = []
    damage: list[WireEvent] = []
    reading = Reading([path], options)
    try:
        for record in watch(reading, reading.records()):
            if isinstance(record, WireEvent):
                if record.kind in DAMAGED_KINDS:
                    damage.append(record)
            elif wanted(record):
                transactions.append(record)
    except (CutError, DamageError) as error:
        on_cut(error)
    for remark in reading.remarks:
        on_remark(remark)
    _demand_one_slave_each(path, transactions)
    return Recorded(transactions, reading.assignments, damage)


def within(transactions: list[NamedTransaction], window: TimeRange) -> list[NamedTransaction]:
    """Those that begin in a window, which counts from the first request."""
    first_ns = min(
        (one.request_ns for one in transactions if one.request_ns is not None), default=0
    )
    return [one for one in transactions if one.start_ns - first_ns in window]


def where_none(window: TimeRange) -> str:
    """Where there is nothing to play, and what helps; for a message."""
    if window == TimeRange():
        return "; see what it holds with decode"
    return f" in the part {window}; give another --start and --end"


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
