"""Finds the values of registers in a capture, for a simulated slave that replays them."""

# At each moment a register has the value that was last read or written in the capture; before the
# first read or write, it has the first known value. Time counts from the capture's first request.
# Each capture is read only once, however many registers need it.

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mbtool.core import UsageError, WireEvent
from mbtool.devices import NamedTransaction, Profile, write_reference
from mbtool.modbus import Outcome
from mbtool.replay import Recording
from mbtool.workflows.shared.read_all import read_all
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.slave.device import Course, FromCapture, Recall


def recorded_values(profile: Profile, on_remark: Callable[[str], None] = lambda _: None) -> Recall:
    """Return a function that finds how the values of registers change over time in a capture.

    `profile` gives the register's name in errors. `on_remark` gets lines for the user about a
    capture, such as that it is cut. The returned function raises InputError for a file that cannot
    be read. It raises UsageError for a file without the value, and if the user named no unit or
    link and several have the value.
    """
    captures: dict[Path, list[NamedTransaction]] = {}
    recordings: dict[tuple[Path, str | None], Recording] = {}

    def recall(wanted: FromCapture) -> Course:
        transactions = captures.get(wanted.path)
        if transactions is None:
            transactions = captures[wanted.path] = _read(wanted.path, on_remark)
        unit = _unit(wanted, transactions)
        link = _link(wanted, unit, transactions)
        recording = recordings.get((wanted.path, link))
        if recording is None:
            recording = recordings[wanted.path, link] = Recording.of(
                one for one in transactions if one.link == link
            )
        return _course(wanted, unit, recording, profile)

    return recall


def _read(path: Path, on_remark: Callable[[str], None]) -> list[NamedTransaction]:
    reading = Reading([str(path)], ReadingOptions(any_port=True))
    return [
        record
        for record in read_all(reading, on_remark, "{error}; taking what is there")
        if not isinstance(record, WireEvent) and record.request_raw is not None
    ]


def _unit(wanted: FromCapture, transactions: list[NamedTransaction]) -> int:
    found = {one.unit for one in transactions if one.outcome is not Outcome.BROADCAST}
    if wanted.unit is not None or len(found) == 1:
        return found.pop() if wanted.unit is None else wanted.unit
    if not found:
        raise UsageError(f"{wanted.path} holds no transaction; see what it has with decode")
    units = ", ".join(map(str, sorted(found)))
    raise UsageError(f"{wanted.path} has the units {units}; write one, as unit = {min(found)}")


def _link(wanted: FromCapture, unit: int, transactions: list[NamedTransaction]) -> str | None:
    found = {one.link for one in transactions if one.unit == unit}
    if wanted.link is not None or len(found) <= 1:
        return found.pop() if wanted.link is None and found else wanted.link
    links, first = ", ".join(sorted(found)), min(found)
    raise UsageError(f"{wanted.path} has unit {unit} on {links}; write one, as link = '{first}'")


def _course(wanted: FromCapture, unit: int, recording: Recording, profile: Profile) -> Course:
    timeline = recording.timeline(unit, wanted.table)
    span = range(wanted.address, wanted.address + wanted.words)
    for address in span:
        if timeline.at(address, 0) is None:
            reference = write_reference(profile, wanted.table, address)
            where = f" on {wanted.link}" if wanted.link is not None else ""
            raise UsageError(f"{wanted.path} holds no value of {reference} of unit {unit}{where}")

    def course(moment_ns: int) -> list[int]:
        at_ns = round(moment_ns * wanted.speed)
        if wanted.loop and recording.length_ns:
            at_ns %= recording.length_ns
        seen = (timeline.at(address, recording.begin_ns + at_ns) for address in span)
        return [value for value, _ in filter(None, seen)]

    return course
