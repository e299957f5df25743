"""Requests and their answers: what is not answered, asked again, or answered unasked."""

# MB-401  a request that stays without an answer
# MB-402  one that is answered when it is repeated; those before it are then no MB-401
# MB-403  an answer that no request in the capture asked for
#
# So an unanswered request is held until it is known what became of it: the same is answered within
# PATIENCE_NS, or not. What is not in the capture must not be missed in it. Hence nothing is said of
#
#     a request at the very end of the capture, whose answer may come after it,
#     an answer soon after its beginning, whose request may have come before it,
#     what surrounds bytes that are lost, or that could not be read,
#     a frame that may be another (Verdict.AMBIGUOUS), and the request before it to the same unit,
#     whose answer it may be,
#     what is carried out in silence: function 08 with sub-function 4, functions whose profile says
#     so, and what RTU over TCP sends to all units.
#
# Holds MAX_HELD requests at most; beyond, the oldest counts as unanswered. Of each line or
# connection it holds a few numbers, and of each repeated request MAX_RETRIES answers (kept.py).

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.finding import Finding, found, is_joined
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import asked_for
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.adu import Transport, Verdict
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile

MAX_HELD = 4096
MAX_RETRIES = 16
PATIENCE_NS = 5_000_000_000
"""How long a request is held, and how far into a capture an answer may be to what is not in it."""
EDGE_NS = 1_000_000_000
"""How much of the capture must follow a request that is to count as unanswered."""

_DIAGNOSTICS, _FORCE_LISTEN_ONLY = 0x08, 0x04
_LOST = frozenset((EventKind.GAP, EventKind.CUT, EventKind.DISCARDED))
_ONE_SIDED = frozenset((Outcome.NO_ANSWER, Outcome.UNSOLICITED))
_DAMAGE = frozenset((EventKind.SKIPPED, EventKind.BAD_CHECK, EventKind.FOREIGN))

_Party = tuple[str, str | None]
"""A line, or a link with the master's end of a connection."""
_Question = tuple[_Party, int, bytes]


@dataclass(slots=True)
class _State:
    """What is known of a line or a connection."""

    since_ns: int | None = None
    is_whole: bool = False
    """Its beginning is in the capture."""
    has_asked: bool = False
    """Since its beginning, or since bytes were lost."""
    is_damaged: bool = False
    """Bytes could not be read since the last request."""
    last_request_ns: int = 0
    lost_ns: int | None = None
    """When bytes were last lost."""


@dataclass(slots=True)
class _Retry:
    transaction: NamedTransaction
    is_told: bool = False


class AnswerRules:
    """Records in, in the order in which they are decoded; findings out."""

    def __init__(self) -> None:
        self._states: LruDict[_Party, _State] = LruDict(_State)
        self._heard: LruDict[tuple[str, int], list[bool]] = LruDict(lambda: [False])
        """Slaves, by whether they have said anything."""
        self._held: OrderedDict[_Question, deque[NamedTransaction]] = OrderedDict()
        self._number_held = 0
        self._retries: LruDict[_Question, deque[_Retry]] = LruDict(
            lambda: deque(maxlen=MAX_RETRIES)
        )
        """Answered requests that an equal one without an answer went before."""
        self._last_ns = 0

    def transaction(
        self, transaction: NamedTransaction, profile: Profile | None
    ) -> Iterator[Finding]:
        """Take the next transaction."""
        party = (transaction.link, transaction.source)
        state = self._states[party]
        at_ns = transaction.start_ns
        if state.since_ns is None:
            state.since_ns = at_ns
        yield from self._pass(at_ns)
        if transaction.response_ns is not None:
            self._note_time(transaction.response_ns)
            self._heard[transaction.link, transaction.unit][0] = True
        is_doubtful = Verdict.AMBIGUOUS in transaction.verdicts
        if is_doubtful and transaction.outcome in _ONE_SIDED:
            self._forget(party, transaction.unit)
        if transaction.outcome is Outcome.UNSOLICITED:
            if _was_unasked(state, at_ns) and not is_doubtful:
                yield found("MB-403", transaction, _unasked_text(transaction))
            return
        state.has_asked, state.is_damaged = True, False
        state.last_request_ns = max(state.last_request_ns, at_ns)
        question = (party, transaction.unit, _asked(transaction))
        if transaction.outcome is Outcome.NO_ANSWER:
            was_lost = state.lost_ns is not None and state.lost_ns >= at_ns
            if not (was_lost or is_doubtful or _is_silent(transaction, profile)):
                yield from self._not_answered(question, transaction)
        elif transaction.outcome is not Outcome.BROADCAST:
            earlier = self._held.pop(question, None)
            if earlier:
                self._number_held -= len(earlier)
                yield _repeated(earlier[0], transaction, len(earlier) + 1)
            elif transaction.retries:
                self._retries[question].append(_Retry(transaction))

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Take the next event."""
        yield from self._pass(event.ts_ns)
        if event.kind in _LOST and not event.link:  # A hole in a log.
            self._held.clear()
            self._number_held = 0
            self._states.clear()
            return
        for party in ((event.link, event.source or None), (event.link, event.destination or None)):
            if event.kind is EventKind.OPENED and party[1] == event.source:
                self._states.pop(party)
                opened = self._states[party]
                opened.since_ns, opened.is_whole = event.ts_ns, not is_joined(event)
            elif party not in self._states:
                continue
            elif event.kind in _LOST:
                self._states[party].has_asked = self._states[party].is_whole = False
                self._states[party].lost_ns = event.ts_ns
                self._forget(party)
            elif event.kind in _DAMAGE:
                self._states[party].is_damaged = True

    def close(self) -> Iterator[Finding]:
        """The capture ends."""
        held, self._held = self._held, OrderedDict()
        for (party, _, _), transactions in held.items():
            state = self._states[party]
            for one in transactions:
                is_late = self._last_ns - one.start_ns >= EDGE_NS
                was_given_up = party[1] is None and state.last_request_ns > one.start_ns
                if is_late or was_given_up:
                    yield self._unanswered(one)

    def _pass(self, now_ns: int) -> Iterator[Finding]:
        """Give up on what was held for long enough."""
        self._note_time(now_ns)
        while self._held:
            transactions = next(iter(self._held.values()))
            if now_ns - transactions[0].start_ns <= PATIENCE_NS:
                return
            yield self._give_up_oldest()

    def _note_time(self, now_ns: int) -> None:
        self._last_ns = max(self._last_ns, now_ns)

    def _not_answered(
        self, question: _Question, transaction: NamedTransaction
    ) -> Iterator[Finding]:
        # On a network a request counts as unanswered long after the same one was answered.
        for retry in self._retries.get(question) or ():
            if 0 < retry.transaction.start_ns - transaction.start_ns <= PATIENCE_NS:
                if not retry.is_told:
                    retry.is_told = True
                    times = retry.transaction.retries + 1
                    yield _repeated(transaction, retry.transaction, times)
                return
        yield from self._hold(question, transaction)

    def _hold(self, question: _Question, transaction: NamedTransaction) -> Iterator[Finding]:
        self._held.setdefault(question, deque()).append(transaction)
        self._number_held += 1
        if self._number_held > MAX_HELD:
            yield self._give_up_oldest()

    def _give_up_oldest(self) -> Finding:
        question, transactions = next(iter(self._held.items()))
        oldest = transactions.popleft()
        self._number_held -= 1
        if not transactions:
            del self._held[question]
        return self._unanswered(oldest)

    def _forget(self, party: _Party, unit: int | None = None) -> None:
        for question in [one for one in self._held if one[0] == party and unit in (None, one[1])]:
            self._number_held -= len(self._held.pop(question))

    def _unanswered(self, transaction: NamedTransaction) -> Finding:
        text = f"{asked_for(transaction)}: no answer"
        if not self._heard[transaction.link, transaction.unit][0]:
            text += f"; unit {transaction.unit} says nothing in this capture"
        return found("MB-401", transaction, text)


def _repeated(first: NamedTransaction, answered: NamedTransaction, times: int) -> Finding:
    waited_ns = (answered.response_ns or answered.start_ns) - first.start_ns
    text = f"asked {times} times, answered after {waited_ns / 1e9:.1f} s"
    return found("MB-402", answered, f"{asked_for(answered)}: {text}", ts_ns=first.start_ns)


def _was_unasked(state: _State, at_ns: int) -> bool:
    if state.is_damaged:
        return False
    if state.has_asked or state.is_whole:
        return True
    return state.since_ns is not None and at_ns - state.since_ns > PATIENCE_NS


def _unasked_text(transaction: NamedTransaction) -> str:
    what = f"answer to {transaction.function_name}"
    if transaction.exception is not None:
        what = f"exception {transaction.exception:02X} to {transaction.function_name}"
    return f"{what}, which no request in the capture asked for"


def _is_silent(transaction: NamedTransaction, profile: Profile | None) -> bool:
    """Whether a request is carried out without an answer."""
    if transaction.transport is Transport.RTU_TCP and transaction.unit == 0:
        return True
    if transaction.function == _DIAGNOSTICS and transaction.sub_function == _FORCE_LISTEN_ONLY:
        return True
    rule = profile.rule(transaction.function) if profile is not None else None
    return rule is not None and not rule.answers


def _asked(transaction: NamedTransaction) -> bytes:
    """What is asked: the PDU, or the bytes where a log of others has none that can be read."""
    raw = transaction.request_raw
    return whole_pdu(transaction.transport, raw) or raw or b""
