"""Groups the counts of `Statistics` by link, for tables and JSON documents."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.ledger.bus_load import BusLoad, LineTime, bus_load, line_time
from mbtool.ledger.link_statistics import HourCount
from mbtool.ledger.poll_cycle import PollLists
from mbtool.ledger.poll_statistics import PollStatistics
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.statistics import OTHER_LINKS, OTHER_UNITS
from mbtool.ledger.statistics_connections import ConnectionTally
from mbtool.ledger.unit_times import UnitTimes
from mbtool.modbus import Transport, function_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.ledger.statistics import Statistics

_SERIAL = frozenset(str(one) for one in Transport if one.is_serial)


@dataclass(frozen=True, slots=True, kw_only=True)
class FunctionReport:
    """The counts of all requests to one unit with one function code."""

    unit: int
    """The unit, or OTHER_UNITS for those that are counted together."""
    device: str | None
    function: int
    function_name: str
    tally: RequestTally
    repetitions: int
    """The number of retries of the polls that are still known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PollReport:
    """The statistics of one poll, and the time of a serial line that its transactions took."""

    poll: PollStatistics
    line_time: LineTime | None
    """The part of the line's time that the poll took. None on a network, or if the baud rate or the
    times of the bytes are unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterReport:
    """The lists that one master polls in cycles on a link."""

    master: str
    """The master's host; empty on a serial line."""
    requests: int
    """The number of requests in which polled lists were searched: the last ones of the master."""
    lists: PollLists[PollStatistics]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkReport:
    """The statistics of one link: a serial bus, or a slave's address on a network."""

    name: str
    transport: str
    settings: str | None
    """Baud rate and character format of a serial line as text; None on a network, or if they are
    unknown or changed."""
    has_times: bool
    """False if the capture has no times of the bytes, so that rates and periods are unknown."""
    begin_ns: int
    end_ns: int
    watched_ns: int
    all_watched_ns: int
    """The time during which the captures were watched, on this link or another one."""
    tally: RequestTally
    load: BusLoad | None
    functions: list[FunctionReport]
    """One entry for each pair of unit and function code, sorted by unit, then by function code."""
    polls: list[PollReport]
    """The polls, in the order in which they were first seen."""
    masters: list[MasterReport]
    connections: list[tuple[str, ConnectionTally]]
    """For each master, its host and the counts of its connections to the link's slave."""
    hours: list[HourCount]
    is_whole: bool
    """False if a filter of the user left out transactions, so that events and periods tell nothing
    of those that are counted."""
    stray_frames: int
    """The number of frames with a wrong CRC or LRC that answer no request that is known; 0 if the
    statistics are not whole."""
    units: dict[int, UnitTimes]
    """The times of the requests to each unit; empty if the capture has no times."""

    @property
    def is_serial(self) -> bool:
        return self.transport in _SERIAL

    def rate(self, count: int) -> float | None:
        """Return `count` divided by the watched time in seconds; None if that time is 0."""
        return count * 1e9 / self.watched_ns if self.watched_ns else None


def report(statistics: Statistics, *, with_cycles: bool = True) -> list[LinkReport]:
    """Return a report for each link, in the order in which the links first appeared.

    Without `with_cycles` it takes less time, and lacks the poll cycles, and the load of a line,
    which needs the master's time-out from them.
    """
    polls: dict[str, list[PollStatistics]] = {}
    for poll in statistics.polls.values():
        polls.setdefault(poll.key.link, []).append(poll)
    groups: dict[str, list[tuple[int, int, RequestTally]]] = {}
    for (name, unit, function), tally in statistics.groups.items():
        groups.setdefault(name, []).append((unit, function, tally))
    units: dict[str, dict[int, UnitTimes]] = {}
    for (name, unit), times in statistics.units.items():
        units.setdefault(name, {})[unit] = times
    return [
        _link_report(
            statistics,
            name,
            sorted(polls.get(name, ()), key=lambda one: one.number),
            groups.get(name, []),
            units.get(name, {}),
            with_cycles=with_cycles,
        )
        for name in statistics.links
    ]


def is_counted_together(links: Sequence[LinkReport]) -> bool:
    """True if there were more links, or pairs of unit and function, than the statistics tell apart,
    so that figures of single units may be too small.
    """
    return any(
        link.name == OTHER_LINKS or any(one.unit == OTHER_UNITS for one in link.functions)
        for link in links
    )


def unit_tallies(
    links: Sequence[LinkReport], *, broadcasts: bool = False
) -> dict[tuple[str, int], RequestTally]:
    """Return the counts of each unit; the key is link and unit.

    Units that only got broadcasts are left out, as no unit answers these, unless `broadcasts`.
    """
    tallies: dict[tuple[str, int], list[RequestTally]] = {}
    for link in links:
        for one in link.functions:
            if broadcasts or not one.tally.is_of_broadcasts:
                tallies.setdefault((link.name, one.unit), []).append(one.tally)
    return {unit: merged(some) for unit, some in tallies.items()}


def unit_polls(links: Sequence[LinkReport]) -> dict[tuple[str, int], list[PollStatistics]]:
    """Return the polls of each unit that are still known; the key is link and unit."""
    polls: dict[tuple[str, int], list[PollStatistics]] = {}
    for link in links:
        for one in link.polls:
            polls.setdefault((link.name, one.poll.key.unit), []).append(one.poll)
    return polls


def unit_times(links: Sequence[LinkReport]) -> dict[tuple[str, int], UnitTimes]:
    """Return the times of the requests to each unit; the key is link and unit."""
    return {(link.name, unit): times for link in links for unit, times in link.units.items()}


def _link_report(
    statistics: Statistics,
    name: str,
    polls: list[PollStatistics],
    groups: list[tuple[int, int, RequestTally]],
    units: dict[int, UnitTimes],
    *,
    with_cycles: bool,
) -> LinkReport:
    link = statistics.links[name]
    tapes = {
        master: tape
        for (of, master), tape in statistics.tapes.items()
        if of == name and with_cycles
    }
    lists = {master: tape.lists() for master, tape in tapes.items()}
    timeouts = {master: found.timeout_ns or 0 for master, found in lists.items()}
    functions = _functions(statistics, name, polls, groups)
    tally = merged([one.tally for one in functions])
    timeout_ns = max(timeouts.values(), default=0)
    load = bus_load(tally, link, timeout_ns) if with_cycles else None
    begin_ns, end_ns = link.whole_span()
    return LinkReport(
        name=name,
        transport="" if link.transport is None else str(link.transport),
        settings=None if link.format is None or link.is_mixed else str(link.format),
        has_times=link.has_times,
        begin_ns=begin_ns,
        end_ns=end_ns,
        watched_ns=link.watched_ns,
        all_watched_ns=statistics.watched_ns,
        tally=tally,
        load=load,
        functions=functions,
        polls=[
            PollReport(
                poll=poll,
                line_time=None
                if load is None
                else line_time(poll.tally, link, timeouts.get(poll.key.master, 0)),
            )
            for poll in polls
        ],
        masters=[
            MasterReport(master=master, requests=len(tape), lists=lists[master])
            for master, tape in tapes.items()
        ],
        connections=[
            (master, one) for (of, master), one in statistics.connections.items() if of == name
        ],
        hours=link.hours.counts(),
        is_whole=not statistics.left_out,
        stray_frames=0
        if statistics.left_out
        else statistics.bad_checks.get(name, 0) - tally.damaged,
        units=units if link.has_times else {},
    )


def _functions(
    statistics: Statistics,
    name: str,
    polls: list[PollStatistics],
    groups: list[tuple[int, int, RequestTally]],
) -> list[FunctionReport]:
    tallies: dict[tuple[int, int], list[RequestTally]] = {}
    repetitions: Counter[tuple[int, int]] = Counter()
    for poll in polls:
        tallies.setdefault((poll.key.unit, poll.key.function), []).append(poll.tally)
        repetitions[poll.key.unit, poll.key.function] += poll.repetitions
    for unit, function, tally in groups:
        tallies.setdefault((unit, function), []).append(tally)
    return [
        FunctionReport(
            unit=unit,
            device=statistics.devices.get((name, unit)),
            function=function,
            function_name=statistics.function_names.get(function) or function_name(function),
            tally=merged(some),
            repetitions=repetitions[unit, function],
        )
        for (unit, function), some in sorted(tallies.items(), key=lambda one: one[0])
    ]
