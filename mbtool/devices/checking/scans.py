"""The rules about scans: a master that searches for addresses, units, functions or registers."""

# SEC-201  a master connects or sends requests to many IP addresses that it does not poll
# SEC-202  a master sends requests to many units of one IP address or line that it does not poll
# SEC-203  a master sends a unit many functions that the unit does not have: the unit refuses them
#          with exception 01, or neither the standard nor the unit's profile has them
# SEC-204  a unit refuses many of a master's register addresses, with exception 02 or 03
#
# A master that polls may also use many units and registers, but it repeats the same requests.
# unpolled.py leaves out everything that a master polls. As a poll may be recognised late, the
# findings come at the end of the capture.
#
# A capture can be too short to show that a master polls. So an address or unit that answers as
# asked counts for SEC-201 and SEC-202 only if its first request came at least the time of SEC-205
# before the end of the capture. If the capture has the opening of the
# first connection to an address, the address also counts in three other cases: the master was first
# heard when another host had already been polling; the master did not ask the address again for the
# time of SEC-201's limit; or the master only read the identification, and did not ask again for
# IDENTIFIED_NS.
#
# Memory: the time at which each of the first MAX_HOSTS hosts was first heard. Later ones count as
# heard from the beginning.

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from msgspec import structs

from mbtool.core import CONNECTION_JOINED, WireEvent
from mbtool.devices.checking.finding import Finding, event_finding, packets_of, transaction_finding
from mbtool.devices.checking.quiet_run import QuietRun, asked_number
from mbtool.devices.checking.security_cases import (
    SecurityCases,
    host_of,
    is_identification,
    master_text,
    place_text,
)
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.checking.unpolled import OPENED, Attempts, Unpolled
from mbtool.modbus.functions import FUNCTIONS, ExceptionCode
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.devices.checking.security_limits import SecurityLimits
    from mbtool.devices.model import Profile
    from mbtool.devices.named_transaction import NamedTransaction

MAX_HOSTS = 4096
MOST_UNITS = 64
"""More units of one slave than this count as scanned, even if the capture is short and all of them
answer. A gateway has fewer; a device that ignores the unit answers for every one."""

IDENTIFIED_NS = 10_000_000_000
"""A host that only asked for identifications counts as scanning if it sends no other request within
this time (ns): a master that identifies its slaves first begins to poll sooner."""

_AS_ASKED = frozenset((Outcome.OK, Outcome.LATE, Outcome.NOT_CAPTURED))
"""Outcomes of requests that the slave may have answered as asked."""
_REFUSED_ADDRESS = frozenset((ExceptionCode.ILLEGAL_DATA_ADDRESS, ExceptionCode.ILLEGAL_DATA_VALUE))


_AskedUnit = tuple[str, str, int]
"""The master's IP address, the slave's HOST:PORT, and the unit."""


class ScanRules:
    """Finds masters that search for addresses, units, functions or registers (SEC-201 to SEC-204).

    Reports them at the end of the capture.
    """

    def __init__(self, limits: SecurityLimits, cases: SecurityCases) -> None:
        self._first_time_ns = limits.identification.window_ns
        self._turn_ns = limits.host_scan.window_ns
        """A host that connects to an address and does not ask it again within this time (ns) does
        not poll it."""
        self._hosts = Unpolled("SEC-201", _host_case, limits.host_scan, cases)
        self._units = Unpolled(
            "SEC-202", _unchanged_case, limits.unit_scan, cases, most_ordinary=MOST_UNITS
        )
        self._functions = Unpolled("SEC-203", _function_case, limits.function_scan, cases)
        self._registers = Unpolled("SEC-204", _register_case, limits.register_scan, cases)
        self._end_ns = 0
        """The time of the latest request, in ns."""
        self._polled_ns: int | None = None
        """The time (ns) of the request that showed for the first time that a host polls."""
        self._first_heard_ns: dict[str, int] = {}
        """The time (ns) at which each host was first heard."""

    def transaction(
        self, transaction: NamedTransaction, source: str, slave: str, profile: Profile | None
    ) -> None:
        """Count the next transaction for the rules about scans. It must have a request.

        `source` is the master's IP address and `slave` the slave's HOST:PORT. On a serial line,
        both are the name of the line. `profile` is the slave's; None if it has none.
        """
        self._note_sender(source, transaction.start_ns)
        is_polled = self._units.is_polled((source, slave), transaction.unit)
        is_refused = transaction.exception in _REFUSED_ADDRESS
        is_missing = not is_refused and _is_missing(transaction, profile)
        if is_polled and not is_refused and not is_missing:
            return  # The usual case.
        unit, function, address = transaction.unit, transaction.function, transaction.address
        asked = asked_number(unit, function, address, transaction.quantity)
        at_ns, packets = transaction.start_ns, packets_of(transaction)
        is_answered = transaction.response_raw is not None
        if not is_polled:
            self._note_unit(transaction, source, slave, asked)
        make = partial(_bare, transaction)
        if is_refused:
            self._registers.note(
                (source, slave, unit), (function, address), asked, at_ns, make,
                is_answered=True, packets=packets,
            )  # fmt: skip
        elif is_missing:
            self._functions.note(
                (source, slave, unit), function, asked, at_ns, make,
                is_answered=is_answered, packets=packets,
            )  # fmt: skip

    def takes(self, run: QuietRun) -> bool:
        """True if the masters poll all hosts to which these transactions open connections, so that
        the openings need not be counted.
        """
        return all(
            self._hosts.is_polled((host_of(one.source),), host_of(one.destination))
            for one in run.connections
            if one.opened_ns is not None
        )

    def run(self, run: QuietRun) -> None:
        """Count many answered reads, with the same result as `transaction` for each. Those of units
        that are known to be polled need not be counted.
        """
        opened = (one.opened_ns or 0 for one in run.connections)
        self._end_ns = max(self._end_ns, run.last_request_ns, *opened)
        unpolled = {
            (one.source, one.destination, unit)
            for one in run.connections
            for unit in one.units
            if not self._units.is_polled((host_of(one.source), one.destination), unit)
        }
        if unpolled:
            self._note_units(run, unpolled)
        rows = run.rows
        for place in run.refused:
            exception, (_, source, slave) = rows.exceptions[place], run.ends(place)
            asked = rows.asked[place]
            scope, function = (host_of(source), slave, asked >> 40), asked >> 32 & 0xFF
            things: Unpolled[NamedTransaction] = self._registers
            thing: object = function, asked >> 16 & 0xFFFF
            if exception == ExceptionCode.ILLEGAL_FUNCTION:
                things, thing = self._functions, function
            elif exception not in _REFUSED_ADDRESS:
                continue
            things.note(
                scope, thing, asked, rows.request_ns[place], partial(run.like, place),
                is_answered=True, packets=run.packets(place),
            )  # fmt: skip

    def _note_units(self, run: QuietRun, unpolled: Collection[tuple[str, str, int]]) -> None:
        """Count the requests of a run to units that are not known to be polled: those with these
        ends and units.
        """
        units: dict[_AskedUnit, list[int]] = {}
        for place, asked in enumerate(run.rows.asked):
            _, source, slave = run.ends(place)
            unit = asked >> 40
            if (source, slave, unit) in unpolled:
                units.setdefault((host_of(source), slave, unit), []).append(place)
        for (host, _, _), places in units.items():
            self._note_sender(host, run.rows.request_ns[places[0]])
        if self._units.has_room(len(units)) and self._hosts.has_room(len(units)):
            self._note_requests(run, units)
            return
        # The order of the requests decides which things are dropped.
        for place, one in sorted((place, one) for one, some in units.items() for place in some):
            self._note_requests(run, {one: [place]})

    def _note_requests(self, run: QuietRun, units: Mapping[_AskedUnit, list[int]]) -> None:
        """Count requests of a run: those at these places, to these units."""
        hosts: dict[tuple[str, str], list[int]] = {}
        polled: dict[tuple[str, str], int] = {}
        """The place of the request that shows that a host is polled."""
        for (source, slave, unit), places in units.items():
            host = source, host_of(slave)
            at = self._units.note_all(
                (source, slave), unit, run, places, lambda one: _unit_case(run.like(one))
            )
            if at is not None:
                polled[host] = min(polled.get(host, at), at)
                places = [place for place in places if place < at]
            hosts.setdefault(host, []).extend(places)
        for (source, slave_host), places in hosts.items():
            end = polled.get((source, slave_host), len(run))
            before = sorted(place for place in places if place < end)
            make = partial(_host_finding, run, _hosts(source))
            self._hosts.note_all((source,), slave_host, run, before, make)
            if end < len(run):
                self._hosts.set_polled((source,), slave_host)
        if polled and self._polled_ns is None:
            self._polled_ns = run.rows.request_ns[min(polled.values())]

    def opened(self, event: WireEvent) -> None:
        """Count the opening of a connection as an attempt to reach an IP address (SEC-201)."""
        source, host = host_of(event.source), host_of(event.destination)
        self._note_sender(source, event.ts_ns)
        if event.message.startswith(CONNECTION_JOINED):
            return
        self._hosts.note(
            (source,),
            host,
            OPENED,
            event.ts_ns,
            lambda: event_finding("SEC-201", event, _hosts(source)),
        )

    def close(self) -> None:
        """Count the IP addresses, units, functions and registers that a master requested but did
        not poll.

        Call this method at the end of the capture.
        """
        self._hosts.close(self._is_too_short)
        self._units.close(lambda _, attempts: self._is_before_second_turn(attempts))
        self._functions.close()
        self._registers.close()

    def _note_sender(self, source: str, at_ns: int) -> None:
        self._end_ns = max(self._end_ns, at_ns)
        if source not in self._first_heard_ns and len(self._first_heard_ns) < MAX_HOSTS:
            self._first_heard_ns[source] = at_ns

    def _is_before_second_turn(self, attempts: Attempts) -> bool:
        """True if the capture ends before a master had to ask for the second time."""
        return self._end_ns - attempts.at_ns <= self._first_time_ns

    def _is_too_short(self, source: str, attempts: Attempts) -> bool:
        """True if the capture may only lack the second turn of a master to an address."""
        if not self._is_before_second_turn(attempts):
            return False
        if not attempts.was_opened:
            return True
        quiet_ns = self._end_ns - attempts.last_ns
        if quiet_ns > (self._turn_ns if attempts.reads_more else IDENTIFIED_NS):
            return False
        first_ns = self._first_heard_ns.get(source)
        return self._polled_ns is None or first_ns is None or first_ns <= self._polled_ns

    def _note_unit(
        self, transaction: NamedTransaction, source: str, slave: str, asked: int
    ) -> None:
        """Count a request to a unit that is not known to be polled. `asked` is its
        `asked_number`.
        """
        at_ns, packets = transaction.start_ns, packets_of(transaction)
        is_answered = transaction.response_raw is not None
        as_asked = transaction.outcome in _AS_ASKED
        is_polled = self._units.note(
            (source, slave), transaction.unit, asked, at_ns, lambda: _unit_case(transaction),
            is_answered=is_answered, is_answered_as_asked=as_asked, packets=packets,
        )  # fmt: skip
        if is_polled and self._polled_ns is None:
            self._polled_ns = at_ns
        if transaction.destination is None:
            return
        host = host_of(transaction.destination)
        if is_polled:
            self._hosts.set_polled((source,), host)
            return
        self._hosts.note(
            (source,), host, asked, at_ns,
            lambda: _finding("SEC-201", transaction, _hosts(source)),
            is_answered=is_answered, is_answered_as_asked=as_asked,
            is_identification=is_identification(transaction), packets=packets,
        )  # fmt: skip


def _bare(transaction: NamedTransaction) -> NamedTransaction:
    """Return a transaction without its bytes and values, to be kept for a message."""
    return structs.replace(
        transaction,
        request_raw=None,
        response_raw=None,
        request_values=None,
        response_values=None,
        points=[],
    )


def _unchanged_case(case: tuple[str, Finding]) -> tuple[str, Finding]:
    return case


def _host_case(finding: Finding) -> tuple[str, Finding]:
    """Return the slave's IP address in the finding of a first request or opening, and the finding,
    which takes less memory than a transaction.
    """
    return host_of(finding.destination or finding.link), finding


def _unit_case(one: NamedTransaction) -> tuple[str, Finding]:
    """Return the unit of a request as text, and the finding if it is the first of a scan."""
    text = (
        f"{master_text(one)} asks {{count}} units of {place_text(one)} and polls none of them: "
        "{examples}"
    )
    return str(one.unit), _finding("SEC-202", one, text)


def _function_case(one: NamedTransaction) -> tuple[str, Finding]:
    text = (
        f"{master_text(one)} asks unit {one.unit} of {place_text(one)} for {{count}} functions "
        "that it does not have: {examples}"
    )
    return f"{one.function:02X}H", replace(_finding("SEC-203", one, text), unit=one.unit)


def _register_case(one: NamedTransaction) -> tuple[str, Finding]:
    text = (
        f"unit {one.unit} of {place_text(one)} refuses {master_text(one)} {{count}} different "
        "registers: {examples}"
    )
    return request_text(one), replace(_finding("SEC-204", one, text), unit=one.unit)


def _finding(code: str, transaction: NamedTransaction, text: str) -> Finding:
    """Make a finding about several units, functions or registers from the first case of a scan.

    `code` is the code of the rule, `text` the message. The finding has no unit, function and
    reference, because these belong to the first case only.
    """
    one = transaction_finding(code, transaction, text)
    return replace(one, unit=None, function=None, reference=None)


def _host_finding(run: QuietRun, text: str, place: int) -> Finding:
    return _finding("SEC-201", run.like(place), text)


def _hosts(source: str) -> str:
    return f"{source} asks {{count}} addresses and polls none of them: {{examples}}"


def _is_missing(transaction: NamedTransaction, profile: Profile | None) -> bool:
    """True if the unit refuses the request's function with exception 01, or probably does not have
    it.

    It probably does not have a function that neither the standard nor the unit's profile lists.
    `profile` is None if the unit has none.
    """
    if transaction.exception == ExceptionCode.ILLEGAL_FUNCTION:
        return True
    if transaction.function in FUNCTIONS:
        return False
    return profile is None or profile.rule(transaction.function) is None
