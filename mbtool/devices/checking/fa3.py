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
#     10.2, 10.4  a module that refuses or keeps what the manual has it take or drop  FA3-X9
#     10.5  a value is read although its completion flag was last read as off    FA3-X10
#     10.3  RWr1 has an alarm                                                    FA3-X11
#     10.4  42H, read model name: another model than the user named              FA3-X12
#
# The finding about a third connection is reported when the reaction of the module is seen. FA3-X2:
# the module closes the connection that was silent longest. FA3-X9: it refuses the new one, closes
# another one, or keeps all three.
#
# If a master reads or writes the times and the count in 00F2H to 00F5H, these values are used;
# until then the defaults of the manual.
#
# The names of the two flags are those in the profiles. On the digital modules, Y9 is an output, and
# there is no such handshake.
#
# Memory: for each module, its connections and the last MAX_RECENT requests and connection attempts;
# at most MAX_ENTRIES modules (LruDict in sliding_window.py). The requests are kept because the
# transaction of a reset, which has no response, can be decoded after later transactions.

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import ConnectionEnd, EventKind, WireEvent
from mbtool.core.moments import counted
from mbtool.devices.checking.connections import foreign_text, is_foreign_message
from mbtool.devices.checking.finding import Finding, event_finding, is_joined, transaction_finding
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.identity import answer_word
from mbtool.devices.model import BehaviourName, Profile
from mbtool.devices.profile_checks import has_other_data
from mbtool.modbus.functions import FUNCTIONS, WRITE_SINGLE_COIL, Function
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

MAX_CONNECTIONS = 2
MAX_RECENT = 64
RESET_NS = 2_000_000_000
"""The time in ns after a remote reset in which a module accepts no connection."""

REJECTING_NS = 10_000_000_000
"""The time in ns after an unanswered alive check in which a module may refuse its master (10.2)."""
GOES_ON_NS = 1_000_000_000
"""A module should close a connection when a third one opens. If it answers a request that came on
that connection more than this long (ns) after the third opened, it has not closed it."""
_COUNT, _SPLIT = 0x00F4, 0x00F5
_TIMERS = range(0x00F2, 0x00F6)
"""Addresses of the holding registers with the times of the alive check and of split reception."""
_ALARM = 0x0001
"""The address of the input register RWr1, the latest alarm."""
_CONVERSION = 0x0102
"""The address of the holding register that enables channels; a bit that is 0 enables."""
_FLAGS = range(0x10, 0x18)
"""Addresses of the discrete inputs X10 to X17: on if a value of the channel is converted."""
_SETTINGS = range(0x0102, 0x0144)
"""Addresses of the holding registers with the settings of the analog modules. The settings take
effect when the master sets the coil Y9."""
_VALUES = range(0x02, 0x0A)
"""Addresses of the values of the eight channels: RWr2 to RWr9 (input registers), and RWw2 to RWw9
(holding registers)."""
_REMOTE_RESET, _READ_MODEL_NAME = 0x41, 0x42
_REQUEST_FLAG = "Initial data setting request flag"
_COMPLETION_FLAG = "Initial data setting completion flag"


@dataclass(slots=True)
class _Third:
    """A third connection, and what the module has to do about it."""

    event: WireEvent
    others: tuple[str, ...]
    """The master's HOST:PORT of the connections beside it."""
    silent: str
    """The other connection that was silent longest."""


@dataclass(slots=True)
class _Module:
    connections: dict[str, int] = field(default_factory=dict)
    """The master's HOST:PORT of each open connection, and the time of its last request (ns); at
    most MAX_CONNECTIONS + 1."""
    third: _Third | None = None
    """The third connection, if the module's reaction to it is not known yet; otherwise None."""
    rejects_until_ns: int = 0
    """The time (ns) until which the module may refuse connections, after an alive check failed."""
    incomplete: dict[str, int] = field(default_factory=dict)
    """By HOST:PORT of a master, the time (ns) of the first part of its incomplete request; at most
    MAX_CONNECTIONS + 1."""
    timers: dict[int, int] = field(default_factory=dict)
    """The values of 00F2H to 00F5H that masters have read or written, by address."""
    enabled: int | None = None
    """The value of 0102H, in which a 0 enables a channel; None if nobody has read or written it."""
    flags: dict[int, int] = field(default_factory=dict)
    """By channel, from 0, its conversion completion flag as it was read last."""
    alarm: int = 0
    """The value that the last read of RWr1 returned."""
    model: int | None = None
    """The model code that was reported last."""
    recent: deque[tuple[int, Finding]] = field(default_factory=lambda: deque(maxlen=MAX_RECENT))
    """The time (ns) of each recent request and connection attempt, and a finding that it came too
    soon after a reset. The finding is reported if a reset less than RESET_NS earlier is decoded
    later."""
    answered: dict[str, tuple[int, Finding]] = field(default_factory=dict)
    """By HOST:PORT of a master, the time (ns) of the last request that was answered, and a finding
    that it should not have been; at most MAX_RECENT. The finding is reported if a reset before that
    time is decoded later."""
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
    is_polled: bool = False
    """True if the master read X9 since Y9 was set."""
    has_new_settings: bool = False
    """True from a write of settings until Y9 is set to apply them, or until a finding says that
    they were not applied."""


class Fa3Rules:
    """Checks how masters use FA3 modules: connections, remote resets, the handshake for settings.

    The findings are FA3-X1 to FA3-X12.
    """

    def __init__(self) -> None:
        self._modules: LruDict[str, _Module] = LruDict(_Module)

    def transaction(self, transaction: NamedTransaction, profile: Profile) -> Iterator[Finding]:
        """Check the next transaction of an FA3 module with this profile. Yields each finding as
        soon as it is certain.
        """
        module = self._modules[transaction.destination or transaction.link]
        source, at_ns = transaction.source or "", transaction.start_ns
        yield from self._goes_on(module, transaction, source)
        if source in module.connections:
            module.connections[source] = max(at_ns, module.connections[source])
        if _is_reset(transaction, profile) and transaction.response_raw is None:
            yield transaction_finding("FA3-X3", transaction, "a remote reset is asked for")
            yield from self._reset(module, source, at_ns)
        elif transaction.request_ns is not None and source != module.reset_by:
            text = f"{request_text(transaction)} {{after}} after the remote reset"
            yield from self._attempt(
                module, at_ns, transaction_finding("FA3-X4", transaction, text)
            )
        parts_ns, allowed_s = transaction.request_parts_ns, _timer(module, profile, _SPLIT)
        if parts_ns is not None and parts_ns > allowed_s * 1_000_000_000:
            text = (
                f"{request_text(transaction)}, its last part {parts_ns / 1e9:.0f} s after its "
                f"first; 00F5H is {allowed_s} s"
            )
            yield transaction_finding("FA3-X8", transaction, text)
        yield from _handshake(module, transaction)
        yield from _report_unapplied_settings(module, transaction, profile)
        yield from _report_unconverted_reads(module, transaction)
        yield from _alarm(module, transaction, profile)
        yield from _other_model(module, transaction, profile)
        _note_registers(module, transaction)

    def close(self) -> Iterator[Finding]:
        """Give the findings that are only known at the end of the capture."""
        for module in self._modules.values():
            if module.third is not None:
                yield _too_many(module.third, "the module takes two")

    def event(self, event: WireEvent, profile: Profile) -> Iterator[Finding]:
        """Check the next event of an FA3 module with this profile. Yields each finding as soon as
        it is certain.
        """
        module = self._modules[event.destination or event.link]
        match event.kind:
            case EventKind.FOREIGN if is_foreign_message(event.raw):
                yield event_finding("FA3-X1", event, foreign_text(event))
            case EventKind.OPENED:
                yield from self._judge_opened_connection(module, event)
            case EventKind.SKIPPED if event.source in module.connections:
                module.incomplete[event.source] = event.ts_ns
            case EventKind.CLOSED:
                end = ConnectionEnd.of(event) or ConnectionEnd("")
                yield from _alive_check(module, event, end, profile)
                yield from _gave_up(module, event, end, profile)
                yield from self._judge_third_connection(module, event, end)
                module.connections.pop(event.source, None)
                module.incomplete.pop(event.source, None)
                if event.source == module.reset_by:
                    module.reset_ns, module.reset_by = event.ts_ns, None

    def _judge_opened_connection(self, module: _Module, event: WireEvent) -> Iterator[Finding]:
        module.connections[event.source] = event.ts_ns
        if len(module.connections) > MAX_CONNECTIONS:
            silent = min(module.connections, key=lambda source: module.connections[source])
            others = [source for source in module.connections if source != event.source]
            if module.third is not None:  # No reaction to the third one was seen.
                yield _too_many(module.third, "the module takes two")
            module.third = _Third(event, tuple(others), silent)
            while len(module.connections) > MAX_CONNECTIONS + 1:
                del module.connections[silent]
                silent = min(module.connections, key=lambda source: module.connections[source])
        if not is_joined(event):
            text = f"{event.source} connects {{after}} after the remote reset"
            yield from self._attempt(module, event.ts_ns, event_finding("FA3-X4", event, text))

    def _judge_third_connection(
        self, module: _Module, event: WireEvent, end: ConnectionEnd
    ) -> Iterator[Finding]:
        """Tell what the module does about a third connection: FA3-X2, or FA3-X9 if it is wrong."""
        third, by_module = module.third, end.by == "slave" or end.reason == "refused"
        is_allowed = event.ts_ns < module.rejects_until_ns
        if module.reset_ns is not None:
            is_allowed = is_allowed or event.ts_ns < module.reset_ns + RESET_NS
        if third is None or event.source not in (*third.others, third.event.source):
            return
        module.third = None
        if event.source == third.silent and (by_module or not end.by):
            yield _too_many(third, f"the module drops {third.silent}")
        elif by_module and not is_allowed:
            done = "refuses it" if event.source == third.event.source else f"drops {event.source}"
            silent = f"{third.silent} was silent longest"
            text = f"{_connections_text(third)}; the module {done}, although {silent}"
            yield event_finding("FA3-X9", third.event, text)

    def _goes_on(
        self, module: _Module, transaction: NamedTransaction, source: str
    ) -> Iterator[Finding]:
        """Give FA3-X9 if the module answers on a connection that it must have ended."""
        if transaction.response_raw is None or transaction.request_ns is None:
            return
        third, at_ns = module.third, transaction.request_ns
        is_silent = third is not None and source == third.silent
        if third is not None and is_silent and at_ns > third.event.ts_ns + GOES_ON_NS:
            module.third = None
            text = (
                f"{_connections_text(third)}; the module goes on with all, also with {third.silent}"
            )
            yield event_finding("FA3-X9", third.event, text)
        text = f"answers {request_text(transaction)} on the connection of the remote reset"
        finding = transaction_finding("FA3-X9", transaction, text)
        if source == module.reset_by and module.reset_ns is not None and at_ns > module.reset_ns:
            module.reset_by = module.reset_ns = None
            yield finding
        module.answered.pop(source, None)
        module.answered[source] = at_ns, finding
        if len(module.answered) > MAX_RECENT:
            del module.answered[next(iter(module.answered))]

    def _reset(self, module: _Module, source: str, at_ns: int) -> Iterator[Finding]:
        module.reset_by, module.reset_ns = source, at_ns
        module.reported.clear()
        module.is_requested = False
        answered_ns, finding = module.answered.pop(source, (0, None))
        if finding is not None and answered_ns > at_ns:
            module.reset_by = module.reset_ns = None
            yield finding
            return
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


def _connections_text(third: _Third) -> str:
    return f"{third.event.source} connects beside {' and '.join(third.others)}"


def _too_many(third: _Third, what: str) -> Finding:
    return event_finding("FA3-X2", third.event, f"{_connections_text(third)}; {what}")


def _timer(module: _Module, profile: Profile, address: int) -> int:
    """The value of a timer (00F2H to 00F5H) that is in force: the one that a master wrote or read,
    or else the default. Outside its range the nearest limit counts (10.3).
    """
    for point in profile.points:
        if point.table is Table.HOLDING_REGISTERS and point.address == address:
            value = module.timers.get(address, int(point.default or 0))
            return int(min(max(value, point.minimum or 0), point.maximum or value))
    return module.timers.get(address, 0)


def _registers(transaction: NamedTransaction, table: Table) -> dict[int, int]:
    """The values of registers or bits of a table that the transaction read or wrote, by address."""
    known = FUNCTIONS.get(transaction.function)
    if known is None or known.table is not table or transaction.address is None:
        return {}
    if transaction.outcome is not Outcome.OK:
        return {}
    values = transaction.request_values if known.writes else transaction.response_values
    quantity = transaction.quantity or 1
    return dict(enumerate((values or ())[:quantity], transaction.address))


def _note_registers(module: _Module, transaction: NamedTransaction) -> None:
    """Keep the values of timers, of enabled channels and of completion flags."""
    holding = _registers(transaction, Table.HOLDING_REGISTERS)
    module.timers |= {at: value for at, value in holding.items() if at in _TIMERS}
    module.enabled = holding.get(_CONVERSION, module.enabled)
    for at, value in _registers(transaction, Table.DISCRETE_INPUTS).items():
        if at in _FLAGS:
            module.flags[at - _FLAGS.start] = value


def _report_unconverted_reads(module: _Module, transaction: NamedTransaction) -> Iterator[Finding]:
    """Give FA3-X10 if the value of an enabled channel is read while its flag was last read as
    off.
    """
    if module.enabled is None or module.has_new_settings:
        return
    named = {point.name for point in transaction.points if point.name.startswith("CH")}
    read = _registers(transaction, Table.INPUT_REGISTERS) if named else {}
    off = [
        at - _VALUES.start
        for at in read
        if at in _VALUES
        and not module.enabled >> at - _VALUES.start & 1
        and module.flags.get(at - _VALUES.start) == 0
    ]
    if off:
        channels = " ".join(f"CH{channel + 1}" for channel in off)
        flags = " ".join(f"X{_FLAGS.start + channel:X}" for channel in off)
        text = f"{request_text(transaction)}, but {flags} of {channels} was last read as off"
        yield transaction_finding("FA3-X10", transaction, text)
        for channel in off:
            del module.flags[channel]  # Reported once, until the flag is read again.


def _alarm(module: _Module, transaction: NamedTransaction, profile: Profile) -> Iterator[Finding]:
    """Give FA3-X11 if RWr1 has an alarm that it did not have when it was read last."""
    code = _registers(transaction, Table.INPUT_REGISTERS).get(_ALARM)
    if code is None:
        return
    is_new, module.alarm = code not in (0, module.alarm), code
    if is_new:
        meaning = next(
            (
                point.texts[code]
                for point in profile.points
                if point.table is Table.INPUT_REGISTERS
                and point.address == _ALARM
                and code in point.texts
            ),
            "see the manual's list of alarm codes",
        )
        yield transaction_finding("FA3-X11", transaction, f"RWr1 is {code:04X}H: {meaning}")


def _other_model(
    module: _Module, transaction: NamedTransaction, profile: Profile
) -> Iterator[Finding]:
    """Give FA3-X12 if 42H has the code of another model than that of the profile."""
    code = answer_word(transaction) if transaction.function == _READ_MODEL_NAME else None
    if code is None or code in (profile.model_code, module.model):
        return
    rule = profile.rule(_READ_MODEL_NAME)
    texts = rule.answer.texts if rule is not None and rule.answer is not None else {}
    if code in texts and profile.model_code is not None:
        module.model = code
        text = f"42H says {code:04X}H, {texts[code]}; it was named {profile.name}"
        yield transaction_finding("FA3-X12", transaction, text)


def _handshake(module: _Module, transaction: NamedTransaction) -> Iterator[Finding]:
    """Follow the handshake that applies settings: set Y9, wait until X9 is 1, clear Y9.

    Gives FA3-X5 if Y9 is cleared or set again before X9 was read as 1, and if a value is used while
    Y9 is on and X9 was never read.
    """
    if transaction.outcome is not Outcome.OK:
        return
    known = FUNCTIONS.get(transaction.function)
    if known is None:
        return
    if known.table not in (Table.COILS, Table.DISCRETE_INPUTS):
        first = transaction.address or 0
        span = range(first, first + (transaction.quantity or 1))
        if module.is_requested and not module.is_polled and _is_of_values(known, span):
            module.is_polled = True  # Reported once.
            text = f"{request_text(transaction)}, while Y9 is on and X9 was not read"
            yield transaction_finding("FA3-X5", transaction, text)
        return
    values = {point.name: point.value for point in transaction.points}
    if _COMPLETION_FLAG in values:
        module.is_polled = True
    if values.get(_COMPLETION_FLAG) == 1:
        module.is_completed = True
    requested = values.get(_REQUEST_FLAG) if known.writes else None
    if requested == 1:
        if not module.is_requested:
            module.is_requested, module.is_completed, module.is_polled = True, False, False
        elif transaction.function == WRITE_SINGLE_COIL:
            yield transaction_finding("FA3-X5", transaction, "Y9 is set, but it is on already")
    elif requested == 0:
        if module.is_requested and not module.is_completed:
            yield transaction_finding(
                "FA3-X5", transaction, "Y9 is cleared before X9 was seen to be on"
            )
        module.is_requested = False


def _report_unapplied_settings(
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


def _alive_check(
    module: _Module, event: WireEvent, end: ConnectionEnd, profile: Profile
) -> Iterator[Finding]:
    """Give FA3-X7 if a connection was reset after as many keep-alive probes without an answer as
    00F4H says.
    """
    by_module = end.reason == "reset" and end.by != "master"
    if by_module and end.unanswered >= _timer(module, profile, _COUNT):
        module.rejects_until_ns = event.ts_ns + REJECTING_NS
        checks = counted(end.unanswered, "alive check")
        text = f"a reset after {checks} without an answer; the alarm is 0E30H"
        yield event_finding("FA3-X7", event, text)


def _gave_up(
    module: _Module, event: WireEvent, end: ConnectionEnd, profile: Profile
) -> Iterator[Finding]:
    """Give FA3-X8 if the module ended a connection because the last part of a request did not
    come.
    """
    begun_ns, allowed_s = module.incomplete.get(event.source), _timer(module, profile, _SPLIT)
    if begun_ns is None or end.by != "slave":
        return
    if event.ts_ns - begun_ns >= allowed_s * 1_000_000_000:
        text = f"the last part of a request did not come within {allowed_s} s (00F5H)"
        yield event_finding("FA3-X8", event, f"{text}; the alarm is 0E40H")


def is_fa3(profile: Profile) -> bool:
    """True if the profile is that of an FA3 module, or extends such a profile."""
    return profile.behaviour is BehaviourName.FA3
