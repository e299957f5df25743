"""Advises which requests of a polled list can be joined, and computes its cycle time then."""

# Reads of one unit with one function can be joined if the addresses between them can be read:
# another request has read them, and the slave answered. A gap that no request has read is not read,
# as the slave may refuse it. No joined read contains a range that the slave refused. A joined read
# has at most the quantity that the standard, or the device's profile, allows.
#
# A request takes a fixed time (for the slave, and for the bytes that every request has) and a time
# for each register or bit. The latter is computed from requests of different quantities to the same
# unit. On a serial line it is at least the time of the bytes.

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import linear_regression, mean, median
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat
from mbtool.modbus import FUNCTIONS

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.ledger.poll_cycle import PollList, PollStep
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.statistics_report import LinkReport

_REFUSALS = (2, 3, 4)
"""The exception codes by which a slave refuses a range of addresses."""
_MIN_PAUSE_RATIO = 3.0
"""A master is said to wait between its cycles if the pause before a cycle is longer than this many
times the median pause between the requests of the cycle, and longer than _LEAST_WAIT_NS."""
_LEAST_WAIT_NS = 5_000_000
"""The least pause (ns) before a cycle that counts as a wait of the master."""
_BAUDS = (2400, 4800, 9600, 19200, 38400, 57600, 115200)
"""The baud rates for which a shorter cycle is forecast, if they are above the line's own."""
_MOST_BAUDS = 2
"""A forecast names at most this many higher baud rates."""
_MIN_STANDARD_ERRORS = 2.5
"""The measured time for each further register is used if it exceeds the time of its bytes on the
line by more than this many standard errors; else the difference may be chance."""


@dataclass(frozen=True, slots=True)
class MergedRead:
    """Several reads of a list that could be one."""

    unit: int
    function: int
    address: int
    quantity: int
    count: int
    """The number of reads that this one replaces."""
    most_asked: int
    """The largest quantity that the slave has answered so far; a larger one is for its manual."""


@dataclass(frozen=True, slots=True)
class CycleAdvice:
    """The requests of a polled list after reads are merged, and the time of its cycle then."""

    merged: tuple[MergedRead, ...]
    requests: int
    """The number of requests in a cycle before any change."""
    requests_then: int
    busy_ns: int
    """The time from the first request of a cycle to the last response."""
    busy_then_ns: int
    cycle_ns: int
    wait_ns: int
    """The time from the last response of a cycle to the first request of the next."""
    waits: bool
    """True if the master waits between cycles: a shorter cycle would then only make the wait
    longer."""

    @property
    def cycle_then_ns(self) -> int:
        """The duration of a cycle if the master goes on as soon as it does today.

        A mean cycle takes longer than its median steps, as some requests are held up; fewer
        requests are held up less often.
        """
        held_up_ns = self.cycle_ns - self.busy_ns - self.wait_ns
        held_up_then_ns = held_up_ns * self.requests_then // self.requests
        return self.busy_then_ns + self.wait_ns + held_up_then_ns


@dataclass(frozen=True, slots=True)
class Forecast:
    """The time that the requests of a list on a serial line take, and would take, in ns."""

    baud: int
    units: int
    cycle_ns: int
    busy_ns: int
    with_unit_ns: int
    """The time (ns) by which a cycle would be longer with one more unit that is asked like the
    others."""
    at_bauds: tuple[tuple[int, int], ...]
    """Pairs of a faster baud rate and the time (ns) by which a cycle would be shorter: only the
    time of the characters becomes shorter."""
    waits: bool


Advised = tuple[str, str, CycleAdvice | Forecast]
"""The link, the master (empty on a serial line) and the advice."""


def advice_of(
    links: Iterable[LinkReport],
    format_of: Callable[[str], SerialFormat | None],
    profile_named: Callable[[str], Profile | None],
) -> list[Advised]:
    """Return the advice on all polled lists of links.

    `format_of` returns the settings of a serial line; `profile_named` the profile of this name,
    None if it is not in use.
    """
    found: list[Advised] = []
    for link in links:
        format_ = format_of(link.name) if link.is_serial else None
        character_ns = None if format_ is None else float(format_.character_ns)
        polls = [one.poll for one in link.polls]
        devices = {one.key.unit: one.device for one in polls if one.device is not None}

        def limit_of(unit: int, function: int, devices: dict[int, str] = devices) -> int | None:
            profile = profile_named(devices.get(unit, ""))
            rule = None if profile is None else profile.rule(function)
            return None if rule is None else rule.limit

        for master in link.masters:
            for each in master.lists.lists:
                advice = advise(each, polls, character_ns, limit_of)
                if advice is not None:
                    found.append((link.name, master.master, advice))
                if format_ is not None:
                    characters = {
                        id(poll.poll): poll.line_time.characters_ns / poll.poll.tally.requests
                        for poll in link.polls
                        if poll.line_time is not None and poll.poll.tally.requests
                    }
                    more = forecast(each, format_.baud, characters)
                    found.append((link.name, master.master, more))
    return found


def forecast(one: PollList[PollStatistics], baud: int, characters: Mapping[int, float]) -> Forecast:
    """Return what a list would take with one unit more, and at other baud rates.

    `characters` has the time (ns) that the characters of a request and its response take on the
    line, by the id of the poll.
    """
    pause_ns, busy_ns = _pause_and_busy(one)
    units = len({step.poll.key.unit for step in one.steps})
    own_ns = sum(characters.get(id(step.poll), 0.0) for step in one.steps)
    return Forecast(
        baud=baud,
        units=units,
        cycle_ns=one.period_ns,
        busy_ns=busy_ns,
        with_unit_ns=(busy_ns + pause_ns) // units,
        at_bauds=tuple(
            (faster, round(own_ns * (1 - baud / faster))) for faster in _BAUDS if faster > baud
        )[:_MOST_BAUDS],
        waits=_is_waiting(one, pause_ns),
    )


def _pause_and_busy(one: PollList[PollStatistics]) -> tuple[int, int]:
    """Return the median pause between the requests of a list, and the time from the first request
    to the last response (ns).
    """
    pauses = [step.pause_ns for step in one.steps[1:]]
    pause_ns = int(median(pauses)) if pauses else 0
    return pause_ns, sum(step.took_ns for step in one.steps) + sum(pauses)


def _is_waiting(one: PollList[PollStatistics], pause_ns: int) -> bool:
    return one.steps[0].pause_ns > max(_MIN_PAUSE_RATIO * pause_ns, _LEAST_WAIT_NS)


def advise(
    one: PollList[PollStatistics],
    polls: Iterable[PollStatistics],
    character_ns: float | None = None,
    limit_of: Callable[[int, int], int | None] = lambda unit, function: None,
) -> CycleAdvice | None:
    """Return advice on a list; None if none of its requests can be joined.

    `polls` are all polls of the link. `character_ns` is the time of a character on a serial line;
    None on a network. `limit_of` returns the largest quantity that the profile of a unit allows
    for a function; None if it has none.
    """
    polls = list(polls)
    groups: dict[tuple[int, int], list[PollStep[PollStatistics]]] = {}
    for step in one.steps:
        key = step.poll.key
        function = FUNCTIONS.get(key.function)
        is_read = function is not None and function.table is not None and not function.writes
        if is_read and key.address is not None and step.poll not in one.repeated:
            groups.setdefault((key.unit, key.function), []).append(step)
    merged: list[MergedRead] = []
    saved_ns, saved = 0, 0
    for (unit, code), steps in groups.items():
        limit = min(limit_of(unit, code) or FUNCTIONS[code].limit, FUNCTIONS[code].limit)
        known, refused = _known_and_refused(polls, unit, code)
        runs = _runs(steps, known, refused, limit)
        for run in runs:
            if len(run) > 1:
                span = _span(run)
                before = sum(step.took_ns for step in run)
                saved_ns += before - _predicted_time_ns(steps, len(span), character_ns)
                saved += len(run) - 1
                merged.append(
                    MergedRead(
                        unit=unit,
                        function=code,
                        address=span.start,
                        quantity=len(span),
                        count=len(run),
                        most_asked=max(
                            _quantity(poll) for poll in _answered_polls(polls, unit, code)
                        ),
                    )
                )
    if not merged:
        return None
    pause_ns, busy_ns = _pause_and_busy(one)
    return CycleAdvice(
        merged=tuple(sorted(merged, key=lambda each: (each.unit, each.function, each.address))),
        requests=len(one.steps),
        requests_then=len(one.steps) - saved,
        busy_ns=busy_ns,
        busy_then_ns=max(busy_ns - saved_ns - saved * pause_ns, 0),
        cycle_ns=one.period_ns,
        wait_ns=one.steps[0].pause_ns,
        waits=_is_waiting(one, pause_ns),
    )


def _quantity(poll: PollStatistics) -> int:
    return max(poll.key.quantity or 1, 1)


def _range(poll: PollStatistics) -> range:
    first = poll.key.address or 0
    return range(first, first + _quantity(poll))


def _answered_polls(polls: Iterable[PollStatistics], unit: int, code: int) -> list[PollStatistics]:
    return [
        poll
        for poll in polls
        if (poll.key.unit, poll.key.function) == (unit, code)
        and poll.key.address is not None
        and poll.tally.latency.count > sum(poll.tally.exceptions.values())
    ]


def _known_and_refused(
    polls: Sequence[PollStatistics], unit: int, code: int
) -> tuple[set[int], list[range]]:
    """The addresses that the slave has given, and the ranges that it refused."""
    known = {at for poll in _answered_polls(polls, unit, code) for at in _range(poll)}
    refused = [
        _range(poll)
        for poll in polls
        if (poll.key.unit, poll.key.function) == (unit, code)
        and poll.key.address is not None
        and any(poll.tally.exceptions.get(exception) for exception in _REFUSALS)
    ]
    return known, refused


def _runs(
    steps: Iterable[PollStep[PollStatistics]],
    known: set[int],
    refused: Sequence[range],
    limit: int,
) -> list[list[PollStep[PollStatistics]]]:
    """Divide reads into runs that can be one read each."""
    runs: list[list[PollStep[PollStatistics]]] = []
    for step in sorted(steps, key=lambda each: (_range(each.poll).start, -len(_range(each.poll)))):
        if runs:
            joined = _span([*runs[-1], step])
            is_known = all(at in known for at in joined)
            is_refused = any(
                bad.start >= joined.start and bad.stop <= joined.stop for bad in refused
            )
            if len(joined) <= limit and is_known and not is_refused:
                runs[-1].append(step)
                continue
        runs.append([step])
    return runs


def _span(run: Sequence[PollStep[PollStatistics]]) -> range:
    ranges = [_range(step.poll) for step in run]
    return range(min(each.start for each in ranges), max(each.stop for each in ranges))


def _predicted_time_ns(
    steps: Sequence[PollStep[PollStatistics]], quantity: int, character_ns: float | None
) -> int:
    """The time (ns) that a read of this quantity would take, by those of other quantities."""
    is_bits = (table := FUNCTIONS[steps[0].poll.key.function].table) is not None and table.is_bits
    bytes_of_one = 1 / 8 if is_bits else 2
    least = 0.0 if character_ns is None else character_ns * bytes_of_one
    points = [(_quantity(step.poll), step.took_ns) for step in steps]
    each = _time_of_one(points, least)
    fixed = median(took - each * count for count, took in points)
    return round(fixed + each * quantity)


def _time_of_one(points: Sequence[tuple[int, int]], least: float) -> float:
    """Return the time (ns) that one register or bit more takes, by least squares.

    Return `least` if the result is smaller, or exceeds it by at most _MIN_STANDARD_ERRORS standard
    errors.
    """
    counts = [count for count, _ in points]
    if len(points) < 3 or len(set(counts)) < 2:
        return least
    slope, offset = linear_regression(counts, [took for _, took in points])
    rest = sum((took - offset - slope * count) ** 2 for count, took in points)
    middle = mean(counts)
    width = sum((count - middle) ** 2 for count in counts)
    error = math.sqrt(rest / (len(points) - 2) / width)
    return slope if slope - least > _MIN_STANDARD_ERRORS * error else least
