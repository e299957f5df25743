"""Groups the statistics of an account by link, for tables and JSON documents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from mbtool.ledger.account import OTHER_LINKS, OTHER_UNITS, Account
from mbtool.ledger.bus_load import BusLoad, LineTime, bus_load, line_time
from mbtool.ledger.poll_cycle import PollLists
from mbtool.ledger.poll_statistics import PollStatistics
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.statistics_connections import ConnectionTally
from mbtool.ledger.time_bins import HourCount
from mbtool.ledger.unit_account import UnitAccount, UseAccount
from mbtool.modbus import Transport

if TYPE_CHECKING:
    from mbtool.ledger.master_tape import MasterTape

_SERIAL = frozenset(str(one) for one in Transport if one.is_serial)


@dataclass(frozen=True, slots=True, kw_only=True)
class FunctionReport:
    """The counts of all requests to one unit with one function code."""

    unit: int
    """The unit, or OTHER_UNITS for all units that are counted together."""
    device: str | None
    function: int
    function_name: str
    tally: RequestTally
    repetitions: int
    """The number of retries, by the rule of PollStatistics."""


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
    """The requests by hour; empty if the capture has no times."""
    is_whole: bool
    """False if a filter of the user left out transactions, so that events and periods tell nothing
    of those that are counted."""
    stray_frames: int
    """The number of frames with a wrong CRC or LRC that answer no request that is known; 0 if the
    statistics are not whole."""
    units: dict[int, UnitAccount]
    """The units and the times of their requests; empty if the capture has no times."""

    @property
    def is_serial(self) -> bool:
        return self.transport in _SERIAL

    def rate(self, count: int) -> float | None:
        """Return `count` divided by the watched time in seconds; None if that time is 0."""
        return count * 1e9 / self.watched_ns if self.watched_ns else None


def report(account: Account, *, with_cycles: bool = True) -> list[LinkReport]:
    """Return a report for each link that had a transaction, in the order in which the links first
    appeared.

    Without `with_cycles` it takes less time, and lacks the poll cycles, and the load of a line,
    which needs the master's time-out from them.
    """
    rows = {
        name: _Rows([], [], {}, {}, [])
        for name, link in account.links.items()
        if link.transport is not None
    }
    for poll in sorted(account.polls.values(), key=lambda one: one.number):
        rows[poll.key.link].polls.append(poll)
    for use in account.uses.values():
        rows[use.key.link].uses.append(use)
    for (name, number), unit in account.units.items():
        rows[name].units[number] = unit
    for (name, master), tape in account.tapes.items():
        if with_cycles:
            rows[name].tapes[master] = tape
    for (name, master), tally in account.connections.items():
        if name in rows:
            rows[name].connections.append((master, tally))
    watched_ns = account.watched_ns
    return [
        _link_report(account, name, some, watched_ns, with_cycles=with_cycles)
        for name, some in rows.items()
    ]


class _Rows(NamedTuple):
    """The counts and times of one link, read from the account."""

    polls: list[PollStatistics]
    uses: list[UseAccount]
    units: dict[int, UnitAccount]
    tapes: dict[str, MasterTape]
    connections: list[tuple[str, ConnectionTally]]


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


def unit_times(links: Sequence[LinkReport]) -> dict[tuple[str, int], UnitAccount]:
    """Return the statistics of each unit that has times; the key is link and unit."""
    return {(link.name, number): unit for link in links for number, unit in link.units.items()}


def _link_report(
    account: Account, name: str, rows: _Rows, watched_ns: int, *, with_cycles: bool
) -> LinkReport:
    link = account.links[name]
    lists = {master: tape.lists() for master, tape in rows.tapes.items()}
    timeouts = {master: found.timeout_ns or 0 for master, found in lists.items()}
    functions = _functions(rows)
    tally = merged([one.tally for one in functions])
    timeout_ns = max(timeouts.values(), default=0)
    load = bus_load(tally, link, timeout_ns) if with_cycles else None
    begin_ns, end_ns = link.whole_span()
    return LinkReport(
        name=name,
        transport=str(link.transport),
        settings=None if link.format is None or link.is_mixed else str(link.format),
        has_times=link.has_times,
        begin_ns=begin_ns,
        end_ns=end_ns,
        watched_ns=link.watched_ns,
        all_watched_ns=watched_ns,
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
            for poll in rows.polls
        ],
        masters=[
            MasterReport(master=master, requests=len(tape), lists=lists[master])
            for master, tape in rows.tapes.items()
        ],
        connections=rows.connections,
        hours=link.bins.hours() if link.has_times else [],
        is_whole=not account.left_out,
        stray_frames=0 if account.left_out else link.bad_checks - tally.damaged,
        units=rows.units if link.has_times else {},
    )


def _functions(rows: _Rows) -> list[FunctionReport]:
    uses: dict[tuple[int, int], list[UseAccount]] = {}
    for use in rows.uses:
        uses.setdefault((use.key.unit, use.key.function), []).append(use)
    polls: dict[tuple[int, int], list[RequestTally]] = {}
    for poll in rows.polls:
        key = poll.use.key
        polls.setdefault((key.unit, key.function), []).append(poll.tally)
    return [
        FunctionReport(
            unit=unit,
            device=some[0].unit.device,
            function=function,
            function_name=some[0].name,
            tally=merged([*polls.get((unit, function), ()), *(one.tally for one in some)]),
            repetitions=sum(one.repetitions for one in some),
        )
        for (unit, function), some in sorted(uses.items(), key=lambda one: one[0])
    ]
