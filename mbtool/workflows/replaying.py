"""Plays a recording's slaves."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from mbtool.core import CutError, DamageError, InputError, UsageError, WireEvent
from mbtool.modbus import Outcome
from mbtool.replay import OnMiss, RecordedSlave, Recording
from mbtool.slave import open_shell
from mbtool.workflows.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import LinkSpec
    from mbtool.devices import NamedTransaction
    from mbtool.slave import Shell


def read_recording(
    path: str,
    options: ReadingOptions,
    wanted: Callable[[NamedTransaction], bool],
    on_cut: Callable[[CutError | DamageError], None],
    on_remark: Callable[[str], None] = lambda _: None,
) -> Recording:
    """The transactions of a capture or a log, ready to be played.

    Of a file that is cut or damaged what is there is played, and `on_cut` is told; `on_remark`
    is told what else there is to know of it. Raises InputError, UsageError.
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
    recording = Recording.of(transactions)
    if not recording.answers:
        raise InputError(f"{path}: no request to play an answer for; see what it holds with decode")
    _demand_one_slave_each(path, transactions)
    return recording


def recorded_slave(
    recording: Recording,
    link: LinkSpec,
    *,
    on_miss: OnMiss,
    speed: float | None,
    allow_remote: bool,
) -> Shell:
    """The recording's slaves on a link, not yet started. Raises UsageError."""
    responder = RecordedSlave(recording, on_miss=on_miss, speed=speed)
    return open_shell(link, responder, allow_remote=allow_remote)


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
