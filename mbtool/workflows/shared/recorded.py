"""Reads the transactions of a recording that a slave, master or bus is to replay."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import InputError, UsageError, WireEvent
from mbtool.devices import Assignments, NamedTransaction
from mbtool.modbus import Outcome
from mbtool.replay import TimeRange
from mbtool.replay.connections import ConnectionHistory, RecordedConnection, in_window
from mbtool.replay.damaged import DAMAGED_KINDS
from mbtool.workflows.shared.read_all import Watch, read_all, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from mbtool.replay.traffic import Sample


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayOptions:
    """The options that all commands of `replay` share: which part of a recording to play, and how
    fast.
    """

    reading: ReadingOptions = field(default_factory=ReadingOptions)
    wanted: Callable[[NamedTransaction], bool] = lambda _: True
    rate: Fraction | None = Fraction(1)
    """Recorded time divided by real time: 2 plays twice as fast; None as fast as possible."""
    window: TimeRange = field(default_factory=TimeRange)
    answers_only: bool = False
    """True if connections are neither opened, refused nor ended as recorded."""


class Recorded(NamedTuple):
    """The transactions to replay, the profiles of their devices, damaged frames, connections."""

    transactions: list[NamedTransaction]
    assignments: Assignments
    damage: list[WireEvent]
    """The events about bytes that could not be decoded, for example because of a wrong CRC."""
    history: ConnectionHistory
    """The TCP connections, with the number of all their requests."""

    def connections(
        self, options: PlayOptions, origin_ns: int | None, on_remark: Callable[[str], None]
    ) -> list[RecordedConnection]:
        """Return the connections to the slave of the transactions, in the part to be played; none
        if the user wants answers only, or if the transactions are of several slaves.

        The part counts from `origin_ns` (UTC ns), or from the first request if it is None.
        """
        asked = [one for one in self.transactions if one.request_ns is not None]
        slaves = {one.destination or one.link for one in asked}
        if options.answers_only or not asked:
            return []
        first_ns = min(one.start_ns for one in asked) if origin_ns is None else origin_ns
        found = in_window(self.history.of_slaves(slaves), options.window, first_ns)
        if len(slaves) > 1 and found:
            on_remark(
                f"mbtool: connections are not played as recorded, as {len(slaves)} slaves share "
                "one link; give each a link of its own: --on WHO=LINK"
            )
            return []
        return found


def read_recorded(
    path: str,
    options: PlayOptions,
    on_remark: Callable[[str], None] = lambda _: None,
    watch: Watch = unwatched,
    *,
    may_repeat_units: bool = False,
) -> Recorded:
    """Read the transactions of a capture or a log, in the order in which they ended.

    If the file is cut or damaged, the readable part is returned, and `on_remark` gets a line for
    the user. `watch` passes on the records as they are read, and may show the progress. Raises
    InputError if the file cannot be read at all, or if `options.wanted` accepts no transaction.
    Raises UsageError if a unit is on several links, unless `may_repeat_units` is True.
    """
    transactions: list[NamedTransaction] = []
    damage: list[WireEvent] = []
    history = ConnectionHistory()
    reading = Reading([path], options.reading)
    count = 0
    for record in read_all(reading, on_remark, "mbtool: {error}; playing what is there", watch):
        if isinstance(record, WireEvent):
            if record.kind in DAMAGED_KINDS:
                damage.append(record)
            history.add_event(record)
        else:
            count += 1
            history.add(record)
            if options.wanted(record):
                transactions.append(record)
    if count and not transactions:
        raise InputError(
            f"{path}: none of its {count:,} transactions fits the condition (where); "
            "see their fields with decode"
        )
    if not may_repeat_units:
        demand_one_slave_each(path, transactions)
    return Recorded(transactions, reading.assignments, damage, history)


def lateness_p99_ns(sample: Sample, options: PlayOptions) -> int | None:
    """The 99th percentile, in ns, of the delays between the recorded time of a message and its
    sending.

    `sample` has the delays in ns. None if it is empty, or if the user chose to replay as fast as
    possible.
    """
    late = sorted(sample.values)
    return late[len(late) * 99 // 100] if late and options.rate else None


def within(transactions: list[NamedTransaction], window: TimeRange) -> list[NamedTransaction]:
    """Return the transactions that begin in `window`, which counts from the first request."""
    first_ns = min(
        (one.request_ns for one in transactions if one.request_ns is not None), default=0
    )
    return [one for one in transactions if one.start_ns - first_ns in window]


def where_none(window: TimeRange) -> str:
    """Return the end of an error message that says "nothing to play": which part was chosen, and
    what to do.
    """
    if window == TimeRange():
        return "; see what it holds with decode"
    return f" in the part {window}; give another --start and --end"


def demand_one_slave_each(path: str, transactions: Sequence[NamedTransaction]) -> None:
    """Raise UsageError if a unit is on several links.

    Units with the same number on several links are different slaves, and a replay on one link can
    have only one slave for each unit. `path` is named in the message.
    """
    links: dict[int, set[str]] = defaultdict(set)
    for one in transactions:
        if one.request_raw is not None and one.outcome is not Outcome.BROADCAST:
            links[one.unit].add(one.link)
    for unit, names in sorted(links.items()):
        if len(names) > 1:
            few = sorted(names)[:4]
            more = f" and {len(names) - len(few)} more" if len(names) > len(few) else ""
            raise UsageError(
                f"{path}: unit {unit} is on several links ({', '.join(few)}{more}); "
                f"choose one with --where 'link == \"{few[0]}\"', or, as the slave, give each a "
                "link of its own: --on WHO=LINK, or --on all=tcp:127.0.0.0/24:1502"
            )
