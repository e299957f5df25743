"""What only the Mitsubishi FA3 modules do: connections, remote reset, initial data setting."""

# Manual of the FA3 network interface modules, chapter 10:
#
#     10.2  two connections; a third drops the one that was silent longest       FA3-X2
#     10.4  no answer where the protocol id is not 0                             FA3-X1
#           41H, remote reset: no answer, the connection drops                   FA3-X3
#           and none is taken for 2 s after that                                 FA3-X4
#     10.5  settings take effect by Y9 on, wait for X9 on, Y9 off                FA3-X5
#
# The names of the two flags are those of the profiles. On the digital modules Y9 is an output, and
# there is no such handshake.
#
# Holds for each module the connections it would hold, and the last MAX_RECENT attempts to speak to
# it, since a reset that nobody answers may be known only later (kept.py).

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.connections import foreign_text, is_foreign_message
from mbtool.devices.checking.finding import Finding, found, found_in, is_joined
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import asked_for
from mbtool.devices.model import BehaviourName
from mbtool.devices.profile_checks import has_other_data
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile
    from mbtool.devices.named_transaction import NamedTransaction

MAX_CONNECTIONS = 2
MAX_RECENT = 64
DEAF_NS = 2_000_000_000

_REMOTE_RESET = 0x41
_REQUEST_FLAG = "Initial data setting request flag"
_COMPLETION_FLAG = "Initial data setting completion flag"


@dataclass(slots=True)
class _Module:
    connections: dict[str, int] = field(default_factory=dict)
    """The masters' ends of open connections, by when they last spoke: MAX_CONNECTIONS of them."""
    recent: deque[tuple[int, Finding]] = field(default_factory=lambda: deque(maxlen=MAX_RECENT))
    """Attempts to speak to it, each as the finding that it is in the time after a reset."""
    reset_by: str | None = None
    deaf_from_ns: int | None = None
    told: set[str | None] = field(default_factory=set)
    """The masters' ends that spoke too soon after the last reset: a finding each."""
    is_requested: bool = False
    """Y9 was seen to be set, and not to be cleared."""
    is_completed: bool = False
    """X9 was seen to be 1 since then."""


class Fa3Rules:
    """Records about modules with this behaviour in; findings out."""

    def __init__(self) -> None:
        self._modules: LruDict[str, _Module] = LruDict(_Module)

    def transaction(self, transaction: NamedTransaction, profile: Profile) -> Iterator[Finding]:
        """Take the next transaction of a module."""
        module = self._modules[transaction.destination or transaction.link]
        source, at_ns = transaction.source or "", transaction.start_ns
        if source in module.connections:
            module.connections[source] = max(at_ns, module.connections[source])
        if _is_reset(transaction, profile) and transaction.outcome is Outcome.NO_ANSWER:
            yield found("FA3-X3", transaction, "a remote reset is asked for")
            yield from self._reset(module, source, at_ns)
        elif transaction.request_ns is not None and source != module.reset_by:
            text = f"{asked_for(transaction)} {{after}} after the remote reset"
            yield from self._attempt(module, at_ns, found("FA3-X4", transaction, text))
        yield from _handshake(module, transaction, profile)

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Take the next event of a module."""
        module = self._modules[event.destination or event.link]
        match event.kind:
            case EventKind.FOREIGN if is_foreign_message(event.raw):
                yield found_in("FA3-X1", event, foreign_text(event))
            case EventKind.OPENED:
                yield from self._opened(module, event)
            case EventKind.CLOSED:
                module.connections.pop(event.source, None)
                if event.source == module.reset_by:
                    module.deaf_from_ns, module.reset_by = event.ts_ns, None

    def _opened(self, module: _Module, event: WireEvent) -> Iterator[Finding]:
        module.connections[event.source] = event.ts_ns
        if len(module.connections) > MAX_CONNECTIONS:
            silent = min(module.connections, key=lambda source: module.connections[source])
            others = [source for source in module.connections if source != event.source]
            yield found_in(
                "FA3-X2",
                event,
                f"{event.source} connects beside {' and '.join(others)}; the module drops {silent}",
            )
            del module.connections[silent]
        if not is_joined(event):
            text = f"{event.source} connects {{after}} after the remote reset"
            yield from self._attempt(module, event.ts_ns, found_in("FA3-X4", event, text))

    def _reset(self, module: _Module, source: str, at_ns: int) -> Iterator[Finding]:
        module.reset_by, module.deaf_from_ns = source, at_ns
        module.told.clear()
        module.is_requested = False
        earlier, module.recent = module.recent, deque(maxlen=MAX_RECENT)
        for attempt_ns, finding in earlier:
            if attempt_ns > at_ns:
                yield from self._attempt(module, attempt_ns, finding)

    def _attempt(self, module: _Module, at_ns: int, finding: Finding) -> Iterator[Finding]:
        """Someone speaks to a module: a finding if it was reset less than 2 s ago."""
        since_ns = module.deaf_from_ns
        if since_ns is not None and since_ns < at_ns < since_ns + DEAF_NS:
            if finding.source not in module.told and len(module.told) < MAX_RECENT:
                module.told.add(finding.source)
                yield _with_time(finding, at_ns - since_ns)
        else:
            module.recent.append((at_ns, finding))


def _is_reset(transaction: NamedTransaction, profile: Profile) -> bool:
    """With other data than the manual's it is an error of its own, and resets nothing."""
    rule = profile.rule(_REMOTE_RESET)
    if transaction.function != _REMOTE_RESET:
        return False
    fixed = bytes.fromhex(rule.data) if rule is not None and rule.data is not None else b""
    return not has_other_data(transaction, fixed)


def _with_time(finding: Finding, after_ns: int) -> Finding:
    return replace(finding, message=finding.message.replace("{after}", f"{after_ns / 1e9:.1f} s"))


def _handshake(
    module: _Module, transaction: NamedTransaction, profile: Profile
) -> Iterator[Finding]:
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
            yield found("FA3-X5", transaction, "Y9 is cleared before X9 was seen to be on")
        module.is_requested = False


def is_fa3(profile: Profile) -> bool:
    """Whether a profile is of this family, or of a user's that builds on it."""
    return profile.behaviour is BehaviourName.FA3
