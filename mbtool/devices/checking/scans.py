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
# A capture can be too short to have a master's second turn. So of addresses and units that answer
# what is asked, the rules SEC-201 and SEC-202 count only those that were requested first_time_ns
# (the first minutes of SEC-205) before the capture's end. If the capture has the opening of the
# first connection to an address, it counts in three further cases: its host was first heard when
# another one had been polling; the host did not ask it again for the time of SEC-201's limit; or it
# asked for the identification only, and did not ask again for IDENTIFIED_NS.
#
# Memory: the time at which each of the first MAX_HOSTS hosts was first heard. Later ones count as
# heard from the beginning.

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core import CONNECTION_JOINED
from mbtool.devices.checking.finding import event_finding, packets_of, transaction_finding
from mbtool.devices.checking.security_cases import (
    host_of,
    is_identification,
    master_text,
    place_text,
)
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.checking.unpolled import OPENED, Unpolled
from mbtool.modbus.functions import FUNCTIONS, ExceptionCode
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.core import WireEvent
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.checking.security_cases import SecurityCases
    from mbtool.devices.checking.security_limits import SecurityLimits
    from mbtool.devices.checking.unpolled import Attempts
    from mbtool.devices.model import Profile
    from mbtool.devices.named_transaction import NamedTransaction

MAX_HOSTS = 4096
MOST_UNITS = 64
"""More units of one slave than this count as scanned, even if the capture is short and all of them
answer. A gateway has fewer; a device that ignores the unit answers for every one."""

IDENTIFIED_NS = 10_000_000_000
"""A master that identifies its slaves before it polls them begins to poll within this time. A scan
asks for nothing else."""

_AS_ASKED = frozenset((Outcome.OK, Outcome.LATE, Outcome.NOT_CAPTURED))
"""Outcomes of requests that the slave may have answered as asked."""
_REFUSED_ADDRESS = frozenset((ExceptionCode.ILLEGAL_DATA_ADDRESS, ExceptionCode.ILLEGAL_DATA_VALUE))


class ScanRules:
    """Finds masters that search for addresses, units, functions or registers (SEC-201 to SEC-204).

    Reports them at the end of the capture.
    """

    def __init__(self, limits: SecurityLimits, cases: SecurityCases) -> None:
        self._first_time_ns = limits.identification.window_ns
        self._turn_ns = limits.host_scan.window_ns
        """A host that connects to an address and does not ask it again for so long (ns) does not
        poll it."""
        self._hosts = Unpolled(limits.host_scan, cases)
        self._units = Unpolled(limits.unit_scan, cases, most_ordinary=MOST_UNITS)
        self._functions = Unpolled(limits.function_scan, cases)
        self._registers = Unpolled(limits.register_scan, cases)
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
        self._heard(source, transaction.start_ns)
        if not self._units.is_polled((source, slave), transaction.unit):
            self._note_unit(transaction, source, slave)
        if transaction.exception in _REFUSED_ADDRESS:
            self._note_register(transaction, source, slave)
        elif _is_missing(transaction, profile):
            self._note_function(transaction, source, slave)

    def takes(self, run: QuietRun) -> bool:
        """True if the masters poll all units in these transactions, and all hosts to which they
        open connections, so that no rule about scans needs to count them.
        """
        return all(
            self._units.is_polled((host_of(one.source), one.destination), unit)
            for one in run.connections
            for unit in one.units
        ) and all(
            self._hosts.is_polled((host_of(one.source),), host_of(one.destination))
            for one in run.connections
            if one.opened_ns is not None
        )

    def run(self, run: QuietRun) -> None:
        """Note the time of many answered reads of units that are all polled."""
        opened = (one.opened_ns or 0 for one in run.connections)
        self._end_ns = max(self._end_ns, run.last_request_ns, *opened)

    def opened(self, event: WireEvent) -> None:
        """Count the opening of a connection as an attempt to reach an IP address (SEC-201)."""
        source, host = host_of(event.source), host_of(event.destination)
        self._heard(source, event.ts_ns)
        if event.message.startswith(CONNECTION_JOINED):
            return
        self._hosts.note(
            (source,),
            host,
            OPENED,
            lambda: (host, event_finding("SEC-201", event, _hosts(source))),
            at_ns=event.ts_ns,
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

    def _heard(self, source: str, at_ns: int) -> None:
        self._end_ns = max(self._end_ns, at_ns)
        if source not in self._first_heard_ns and len(self._first_heard_ns) < MAX_HOSTS:
            self._first_heard_ns[source] = at_ns

    def _is_before_second_turn(self, attempts: Attempts) -> bool:
        """True if the capture ends before a master had to ask for the second time."""
        return self._end_ns - attempts.finding.ts_ns <= self._first_time_ns

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

    def _note_unit(self, transaction: NamedTransaction, source: str, slave: str) -> None:
        request, is_answered = _request(transaction), transaction.response_raw is not None
        as_asked = transaction.outcome in _AS_ASKED

        def first_unit() -> tuple[str, Finding]:
            text = (
                f"{master_text(transaction)} asks {{count}} units of "
                f"{place_text(transaction)} and polls none of them: {{examples}}"
            )
            return str(transaction.unit), _finding("SEC-202", transaction, text)

        is_polled = self._units.note(
            (source, slave),
            transaction.unit,
            request,
            first_unit,
            at_ns=transaction.start_ns,
            is_answered=is_answered,
            is_answered_as_asked=as_asked,
            packets=packets_of(transaction),
        )
        if is_polled and self._polled_ns is None:
            self._polled_ns = transaction.start_ns
        if transaction.destination is None:
            return
        host = host_of(transaction.destination)
        if is_polled:
            self._hosts.set_polled((source,), host)
            return
        self._hosts.note(
            (source,),
            host,
            hash((request, transaction.unit)),
            lambda: (host, _finding("SEC-201", transaction, _hosts(source))),
            at_ns=transaction.start_ns,
            is_answered=is_answered,
            is_answered_as_asked=as_asked,
            is_identification=is_identification(transaction),
            packets=packets_of(transaction),
        )

    def _note_function(self, transaction: NamedTransaction, source: str, slave: str) -> None:
        def first_function() -> tuple[str, Finding]:
            text = (
                f"{master_text(transaction)} asks unit {transaction.unit} of "
                f"{place_text(transaction)} for {{count}} functions that it does not have: "
                "{examples}"
            )
            finding = replace(_finding("SEC-203", transaction, text), unit=transaction.unit)
            return f"{transaction.function:02X}H", finding

        self._functions.note(
            (source, slave, transaction.unit),
            transaction.function,
            _request(transaction),
            first_function,
            at_ns=transaction.start_ns,
            is_answered=transaction.response_raw is not None,
            packets=packets_of(transaction),
        )

    def _note_register(self, transaction: NamedTransaction, source: str, slave: str) -> None:
        def first_register() -> tuple[str, Finding]:
            text = (
                f"unit {transaction.unit} of {place_text(transaction)} refuses "
                f"{master_text(transaction)} {{count}} different registers: {{examples}}"
            )
            finding = replace(_finding("SEC-204", transaction, text), unit=transaction.unit)
            return request_text(transaction), finding

        self._registers.note(
            (source, slave, transaction.unit),
            (transaction.function, transaction.address),
            _request(transaction),
            first_register,
            at_ns=transaction.start_ns,
            is_answered=True,
            packets=packets_of(transaction),
        )


def _finding(code: str, transaction: NamedTransaction, text: str) -> Finding:
    """Make a finding about several units, functions or registers from the first case of a scan.

    `code` is the code of the rule, `text` the message. The finding has no unit, function and
    reference, because these belong to the first case only.
    """
    one = transaction_finding(code, transaction, text)
    return replace(one, unit=None, function=None, reference=None)


def _hosts(source: str) -> str:
    return f"{source} asks {{count}} addresses and polls none of them: {{examples}}"


def _request(transaction: NamedTransaction) -> int:
    """A hash of a request's function, address and quantity, to recognise a repeated request."""
    return hash((transaction.function, transaction.address, transaction.quantity))


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
