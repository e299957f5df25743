"""The rules for Mitsubishi FA3 modules: connections, remote reset, initial data setting."""

# Manual of the FA3 network interface modules, chapter 10:
#
#     10.2  two connections; a third one closes the one that was silent longest  FA3-X2
#     10.4  no response if the protocol id is not 0                              FA3-X1
#           41H, remote reset: no response, the module closes the connection     FA3-X3
#           and accepts no connection for the next 2 s                           FA3-X4
#     10.5  to apply settings: set Y9, wait until X9 is 1, clear Y9              FA3-X5
#           conversion starts with the settings when Y9 is set                   FA3-X6
#     10.3  a master that answers no alive check is disconnected, alarm 0E30H    FA3-X7
#           so is one whose request arrives in parts too far apart, alarm 0E40H  FA3-X8
#
# The names of the two flags are those in the profiles. On the digital modules, Y9 is an output, and
# there is no such handshake.
#
# Memory: for each module, its connections and the last MAX_RECENT requests and connection attempts
# (see lru_dict.py). The requests are kept because the transaction of a reset, which has no
# response, can be decoded after later transactions.

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.connections import foreign_text, is_foreign_message
from mbtool.devices.checking.finding import Finding, event_finding, is_joined, transaction_finding
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.model import BehaviourName
from mbtool.devices.profile_checks import has_other_data
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.modbus.functions import Function

MAX_CONNECTIONS = 2
MAX_RECENT = 64
RESET_NS = 2_000_000_000
"""The time in ns after a remote reset in which a module accepts no connection."""

MIN_UNANSWERED = 3
"""Number of alive checks (keep-alive probes) without an answer after which a module disconnects:
the default of its register 00F4H."""

_SETTINGS = range(0x0102, 0x0144)
"""Addresses of the holding registers with the settings of the analog modules. The settings take
effect when the master sets the coil Y9."""
_VALUES = range(0x02, 0x0A)
"""Addresses of the values of the eight channels: RWr2 to RWr9 (input registers), and RWw2 to RWw9
(holding registers)."""
_UNANSWERED = re.compile(r"^connection closed: reset.*, the last (\d+) unanswered$")
_REMOTE_RESET = 0x41
_REQUEST_FLAG = "Initial data setting request flag"
_COMPLETION_FLAG = "Initial data setting completion flag"


@dataclass(slots=True)
class _Module:
    connections: dict[str, int] = field(default_factory=dict)
    """The master's HOST:PORT of each open connection, and the time of its last request (ns); at
    most MAX_CONNECTIONS."""
    recent: deque[tuple[int, Finding]] = field(default_factory=lambda: deque(maxlen=MAX_RECENT))
    """The time (ns) of each recent request and connection attempt, and a finding that it came too
    soon after a reset. The finding is reported if a reset less than RESET_NS earlier is decoded
    later."""
    reset_by: str | None = None
    """HOST:PORT of the master that requested a remote reset; None once its connection is closed."""
    reset_ns: int | None = None
    reported: set[str | None] = field(default_factory=set)
    """HOST:PORT of each master (None if unknown) for which it was reported that it used the module
    too soon after the last reset. This is reported once for each master."""
    is_requested: bool = False
    """True from the write that sets Y9, the request flag, to the write that clears it."""
    is_completed: bool = False
    """True if the master read X9, the completion flag, as 1 since Y9 was set."""
    has_new_settings: bool = False
    """True from a write of settings until Y9 is set to apply them, or until a finding says that
    they were not applied."""


class Fa3Rules:
    """Checks how masters use FA3 modules: connections, remote resets, the handshake for settings.

    The findings are FA3-X1 to FA3-X8.
    """

    def __init__(self) -> None:
        self._modules: LruDict[str, _Module] = LruDict(_Module)

    def transaction(self, transaction: NamedTransaction, profile: Profile) -> Iterator[Finding]:
        """Check the next transaction of an FA3 module with this profile. Yields each finding as
        soon as it is certain.
        """
        module = self._modules[transaction.destination or transaction.link]
        source, at_ns = transaction.source or "", transaction.start_ns
        if source in module.connections:
            module.connections[source] = max(at_ns, module.connections[source])
        if _is_reset(transaction, profile) and transaction.outcome is Outcome.NO_ANSWER:
            yield transaction_finding("FA3-X3", transaction, "a remote reset is asked for")
            yield from self._reset(module, source, at_ns)
        elif transaction.request_ns is not None and source != module.reset_by:
            text = f"{request_text(transaction)} {{after}} after the remote reset"
            yield from self._attempt(
                module, at_ns, transaction_finding("FA3-X4", transaction, text)
            )
        if Verdict.LATE_PARTS in transaction.verdicts:
            text = f"{request_text(transaction)}, its last part more than 30 s after its first"
            yield transaction_finding("FA3-X8", transaction, text)
        yield from _handshake(module, transaction)
        yield from _unapplied(module, transaction, profile)

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Check the next event of an FA3 module. Yields each finding as soon as it is certain."""
        module = self._modules[event.destination or event.link]
        match event.kind:
            case EventKind.FOREIGN if is_foreign_message(event.raw):
                yield event_finding("FA3-X1", event, foreign_text(event))
            case EventKind.OPENED:
                yield from self._opened(module, event)
            case EventKind.CLOSED:
                yield from _alive_check(event)
                module.connections.pop(event.source, None)
                if event.source == module.reset_by:
                    module.reset_ns, module.reset_by = event.ts_ns, None

    def _opened(self, module: _Module, event: WireEvent) -> Iterator[Finding]:
        module.connections[event.source] = event.ts_ns
        if len(module.connections) > MAX_CONNECTIONS:
            silent = min(module.connections, key=lambda source: module.connections[source])
            others = [source for source in module.connections if source != event.source]
            yield event_finding(
                "FA3-X2",
                event,
                f"{event.source} connects beside {' and '.join(others)}; the module drops {silent}",
            )
            del module.connections[silent]
        if not is_joined(event):
            text = f"{event.source} connects {{after}} after the remote reset"
            yield from self._attempt(module, event.ts_ns, event_finding("FA3-X4", event, text))

    def _reset(self, module: _Module, source: str, at_ns: int) -> Iterator[Finding]:
        module.reset_by, module.reset_ns = source, at_ns
        module.reported.clear()
        module.is_requested = False
        earlier, module.recent = module.recent, deque(maxlen=MAX_RECENT)
        for attempt_ns, finding in earlier:
            if attempt_ns > at_ns:
                yield from self._attempt(module, attempt_ns, finding)

    def _attempt(self, module: _Module, at_ns: int, finding: Finding) -> Iterator[Finding]:
        """Yield `finding` (FA3-X4) if a request or connection attempt at `at_ns` came too soon
        after a reset: less than RESET_NS. It is yielded once for each master.

        Otherwise remember `finding`, because the transaction of a reset before it can be decoded
        later.
        """
        since_ns = module.reset_ns
        if since_ns is not None and since_ns < at_ns < since_ns + RESET_NS:
            if finding.source not in module.reported and len(module.reported) < MAX_RECENT:
                module.reported.add(finding.source)
                yield _with_time(finding, at_ns - since_ns)
        else:
            module.recent.append((at_ns, finding))


def _is_reset(transaction: NamedTransaction, profile: Profile) -> bool:
    """True if the request is a remote reset (41H) with the data that the manual fixes.

    A module ignores a reset with other data.
    """
    rule = profile.rule(_REMOTE_RESET)
    if transaction.function != _REMOTE_RESET:
        return False
    fixed = bytes.fromhex(rule.data) if rule is not None and rule.data is not None else b""
    return not has_other_data(transaction, fixed)


def _with_time(finding: Finding, after_ns: int) -> Finding:
    return replace(finding, message=finding.message.replace("{after}", f"{after_ns / 1e9:.1f} s"))


def _handshake(module: _Module, transaction: NamedTransaction) -> Iterator[Finding]:
    """Follow the handshake that applies settings: set Y9, wait until X9 is 1, clear Y9.

    Gives FA3-X5 if Y9 is cleared before X9 was read as 1.
    """
    if transaction.outcome is not Outcome.OK:
        return
    known = FUNCTIONS.get(transaction.function)
    if known is None or known.table not in (Table.COILS, Table.DISCRETE_INPUTS):
        return
    values = {point.name: point.value for point in transaction.points}
    if values.get(_COMPLETION_FLAG) == 1:
        module.is_completed = True
    requested = values.get(_REQUEST_FLAG) if known.writes else None
    if requested == 1:
        if not module.is_requested:
            module.is_requested, module.is_completed = True, False
    elif requested == 0:
        if module.is_requested and not module.is_completed:
            yield transaction_finding(
                "FA3-X5", transaction, "Y9 is cleared before X9 was seen to be on"
            )
        module.is_requested = False


def _unapplied(
    module: _Module, transaction: NamedTransaction, profile: Profile
) -> Iterator[Finding]:
    """Give FA3-X6 if channel values are read or written while new settings are not applied.

    Settings are applied when Y9 is set after they were written.
    """
    known = FUNCTIONS.get(transaction.function)
    if known is None or transaction.address is None or transaction.outcome is not Outcome.OK:
        return
    span = range(transaction.address, transaction.address + (transaction.quantity or 1))
    if known.writes and known.table is Table.HOLDING_REGISTERS and _overlap(span, _SETTINGS):
        module.has_new_settings = any(point.name == _REQUEST_FLAG for point in profile.points)
    elif known.writes and known.table is Table.COILS and module.is_requested:
        module.has_new_settings = False
    elif module.has_new_settings and _is_of_values(known, span):
        module.has_new_settings = False
        text = f"{request_text(transaction)}, but Y9 was not set since settings were written"
        yield transaction_finding("FA3-X6", transaction, text)


def _is_of_values(function: Function, span: range) -> bool:
    if function.table is Table.INPUT_REGISTERS or function.writes:
        return function.table is not Table.COILS and _overlap(span, _VALUES)
    return False


def _overlap(one: range, other: range) -> bool:
    return one.start < other.stop and other.start < one.stop


def _alive_check(event: WireEvent) -> Iterator[Finding]:
    """Give FA3-X7 if a connection was reset after keep-alive probes without an answer."""
    match = _UNANSWERED.search(event.message)
    if match is not None and int(match[1]) >= MIN_UNANSWERED:
        text = f"a reset after {match[1]} alive checks without an answer; the alarm is 0E30H"
        yield event_finding("FA3-X7", event, text)


def is_fa3(profile: Profile) -> bool:
    """True if the profile is that of an FA3 module, or extends such a profile."""
    return profile.behaviour is BehaviourName.FA3
