"""The rules about missing responses, retries, and responses without a request."""

# MB-401  a request has no response
# MB-402  a request has a response only after a retry; its earlier copies are then no MB-401
# MB-403  a response has no request in the capture
#
# At the end, the rules about damaged frames (RTU-201) and the watchdog of WAGO couplers.
#
# A request without a response is therefore pending until a retry gets a response, or until
# PATIENCE_NS have passed. An equal request that comes at the usual period of its poll is no retry,
# but the next poll. There is no finding if the capture may simply lack the other half:
#
#     a request at the end of the capture, whose response may follow later
#     a response at the beginning of the capture, whose request may have come before
#     a request or response right before or after bytes that are lost or unreadable
#     an ambiguous frame (Verdict.AMBIGUOUS), and the request before it to the same unit, which it
#     may respond to
#     a request that the device carries out in silence: function 08 with sub-function 4, a function
#     that has `answers = false` in its profile, and unit 0 of RTU over TCP
#
# Memory: at most MAX_PENDING pending requests (beyond that, the oldest counts as unanswered),
# MAX_RETRIES responses for each repeated request, and a few numbers for each line or connection
# (see sliding_window.py).

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.finding import Finding, event_finding, is_joined, transaction_finding
from mbtool.devices.checking.quiet_run import QuietRun, asked_number
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.model import BehaviourName, Profile
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.adu import Transport, Verdict
from mbtool.modbus.functions import DIAGNOSTICS, FORCE_LISTEN_ONLY, ExceptionCode
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.response import MAX_FRAMES, DamagedAnswers
from mbtool.modbus.transaction import Outcome

MAX_PENDING = 4096
MAX_RETRIES = 16
PATIENCE_NS = 5_000_000_000
"""The time, in ns, that a request waits for its response, or for the response to a retry. A
response that comes within this time of the beginning of the capture may have a request before the
capture."""
EDGE_NS = 1_000_000_000
"""If the capture ends less than this (ns) after a request, the response may have come after the
capture's end."""

PERIOD_TOLERANCE = 0.25
"""An equal request counts as the next poll, not as a retry, if its distance from the request before
differs from the poll's usual period by at most this share of the period."""

_LOST = frozenset((EventKind.GAP, EventKind.CUT, EventKind.DISCARDED))
_UNPAIRED = frozenset((Outcome.NO_ANSWER, Outcome.UNSOLICITED))
_DAMAGE = frozenset((EventKind.SKIPPED, EventKind.BAD_CHECK, EventKind.FOREIGN))

_Connection = tuple[str, str | None]
"""The link of a connection, and the master's HOST:PORT (None on a serial line)."""
_Request = tuple[_Connection, int, bytes]
"""The connection, unit and PDU of a request. A retry has the same three as the request that it
repeats."""


@dataclass(slots=True)
class _ConnectionState:
    since_ns: int | None = None
    """The time of the connection's first transaction or event, in ns; None before that."""
    is_complete: bool = False
    """True if the connection was opened during the capture, and no bytes were lost since."""
    has_request: bool = False
    """True if the capture has a request of the connection after the last loss of bytes."""
    is_damaged: bool = False
    """True if unreadable bytes came after the last request."""
    last_request_ns: int = 0
    last_loss_ns: int | None = None


@dataclass(slots=True)
class _Retry:
    transaction: NamedTransaction
    is_reported: bool = False


class ResponseRules:
    """Finds missing responses, retries, and responses without a request (MB-401 to MB-403).

    The caller passes transactions and events in the order in which they are decoded.
    """

    def __init__(
        self, usual_period_ns: Callable[[NamedTransaction], float | None] = lambda _: None
    ) -> None:
        """`usual_period_ns` returns the usual time (ns) from one request of a transaction's poll to
        the next; None if it is not known.
        """
        self._usual_period_ns = usual_period_ns
        self._states: LruDict[_Connection, _ConnectionState] = LruDict(_ConnectionState)
        self._has_responded: LruDict[tuple[str, int], list[bool]] = LruDict(lambda: [False])
        """By link and unit: a list with one element, which is True if the unit has responded."""
        self._pending: OrderedDict[_Request, deque[NamedTransaction]] = OrderedDict()
        self._pending_count = 0
        self._retries: LruDict[_Request, deque[_Retry]] = LruDict(lambda: deque(maxlen=MAX_RETRIES))
        """For each request, its retries that had a response. They are kept because the transaction
        of an earlier copy of the request, which had no response, can be decoded after them."""
        self._last_ns = 0

    def transaction(
        self, transaction: NamedTransaction, profile: Profile | None
    ) -> Iterator[Finding]:
        """Check the next transaction. Yields each finding as soon as it is certain.

        `profile` is the slave's; None if it has none.
        """
        connection = (transaction.link, transaction.source)
        state = self._states[connection]
        at_ns = transaction.start_ns
        if state.since_ns is None:
            state.since_ns = at_ns
        yield from self._advance(at_ns)
        if transaction.response_ns is not None:
            self._last_ns = max(self._last_ns, transaction.response_ns)
            self._has_responded[transaction.link, transaction.unit][0] = True
        is_ambiguous = Verdict.AMBIGUOUS in transaction.verdicts
        if is_ambiguous and transaction.outcome in _UNPAIRED:
            self._forget(connection, transaction.unit)
        if Verdict.CAPTURE_END in transaction.verdicts:
            state.last_request_ns = max(state.last_request_ns, at_ns)
            return
        if transaction.outcome is Outcome.NOT_CAPTURED:
            self._forget(connection, transaction.unit)  # The capture lacks request or response.
            return
        if transaction.outcome is Outcome.UNSOLICITED:
            if _is_surely_unsolicited(state, at_ns) and not is_ambiguous:
                yield transaction_finding("MB-403", transaction, _unsolicited_text(transaction))
            return
        state.has_request, state.is_damaged = True, False
        state.last_request_ns = max(state.last_request_ns, at_ns)
        request = (connection, transaction.unit, _request_bytes(transaction))
        if transaction.outcome is Outcome.NO_ANSWER:
            may_be_lost = state.last_loss_ns is not None and state.last_loss_ns >= at_ns
            if not (may_be_lost or is_ambiguous or _needs_no_response(transaction, profile)):
                yield from self._add_unanswered(request, transaction)
        elif transaction.outcome is not Outcome.BROADCAST:
            earlier = self._pending.pop(request, None)
            if earlier:
                self._pending_count -= len(earlier)
                yield from self._report_unanswered_repeats(earlier, transaction)
            elif transaction.retries:
                self._retries[request].append(_Retry(transaction))

    @property
    def has_pending(self) -> bool:
        """True if a request without a response still waits: a retry of it may get one."""
        return bool(self._pending)

    def takes(self, run: QuietRun) -> bool:
        """True if the method `run` may check these transactions together, not one by one.

        That is so if none of them may be the answered retry of a pending request, or the first
        response of a unit that a pending request is to.
        """
        units = {(one.link, unit) for one in run.connections for unit in one.units}
        pending = [
            (link, unit, pdu) for (link, _), unit, pdu in self._pending if (link, unit) in units
        ]
        if pending:
            if not all(self._has_responded[link, unit][0] for link, unit, _ in pending):
                return False
            rows = enumerate(run.rows.asked)
            asked = {(run.ends(place)[0], number >> 16) for place, number in rows}
            for link, unit, pdu in pending:
                address = int.from_bytes(pdu[1:3], "big")
                if (link, asked_number(unit, pdu[0], address, 0) >> 16) in asked:
                    return False
        connections = [(one.link, one.source) for one in run.connections]
        return self._states.would_keep(connections) and self._has_responded.has_room(units)

    def run(self, run: QuietRun) -> Iterator[Finding]:
        """Check many answered reads together, with the same result as `transaction` for each.

        `run` has the times of the reads, grouped by connection and by poll.
        """
        yield from self._advance(max(run.last_request_ns, run.last_event_ns))
        self._last_ns = max(self._last_ns, run.last_response_ns)
        for one in run.connections:
            if one.opened_ns is not None:
                self._states.pop((one.link, one.source))
            state = self._states[one.link, one.source]
            if one.opened_ns is not None:
                state.since_ns, state.is_complete = one.opened_ns, True
            if not one.units:
                continue
            if state.since_ns is None:
                state.since_ns = one.first_ns
            state.has_request, state.is_damaged = True, False
            state.last_request_ns = max(state.last_request_ns, one.last_request_ns)
        for form in sorted(run.forms, key=lambda one: one.places[-1]):
            self._has_responded[form.like.link, form.like.unit][0] = True

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Note lost or damaged bytes. Yields findings about requests that waited too long."""
        yield from self._advance(event.ts_ns)
        if event.kind in _LOST and not event.link:  # Part of a log is missing.
            self._pending.clear()
            self._pending_count = 0
            self._states.clear()
            return
        for end in (event.source or None, event.destination or None):
            connection = (event.link, end)
            if event.kind is EventKind.OPENED and end == event.source:
                self._states.pop(connection)
                opened = self._states[connection]
                opened.since_ns, opened.is_complete = event.ts_ns, not is_joined(event)
            elif connection not in self._states:
                continue
            elif event.kind in _LOST:
                state = self._states[connection]
                state.has_request = state.is_complete = False
                state.last_loss_ns = event.ts_ns
                self._forget(connection)
            elif event.kind in _DAMAGE:
                self._states[connection].is_damaged = True

    def close(self) -> Iterator[Finding]:
        """Report the requests that are still pending at the end of the capture.

        A request in the last EDGE_NS is not reported, because its response may come after the end
        of the capture. But on a serial line it is reported if the master has sent another request
        after it, because the master then no longer waited.
        """
        pending, self._pending = self._pending, OrderedDict()
        for (connection, _, _), transactions in pending.items():
            state = self._states[connection]
            for one in transactions:
                is_old = self._last_ns - one.start_ns >= EDGE_NS
                was_given_up = connection[1] is None and state.last_request_ns > one.start_ns
                if is_old or was_given_up:
                    yield self._no_response_finding(one)

    def _advance(self, now_ns: int) -> Iterator[Finding]:
        """Give a finding for each request that has waited more than PATIENCE_NS for a response at
        the time `now_ns`.
        """
        self._last_ns = max(self._last_ns, now_ns)
        while self._pending:
            transactions = next(iter(self._pending.values()))
            if now_ns - transactions[0].start_ns <= PATIENCE_NS:
                return
            yield self._give_up_oldest()

    def _add_unanswered(
        self, request: _Request, transaction: NamedTransaction
    ) -> Iterator[Finding]:
        # Over TCP, the transaction of a request without a response is decoded when its timeout
        # ends. So an answered retry of this request may have been decoded before.
        for retry in self._retries.get(request) or ():
            if self._is_next_poll(transaction, retry.transaction):
                continue
            if 0 < retry.transaction.start_ns - transaction.start_ns <= PATIENCE_NS:
                if not retry.is_reported:
                    retry.is_reported = True
                    times = retry.transaction.retries + 1
                    yield _retry_finding(transaction, retry.transaction, times)
                return
        self._pending.setdefault(request, deque()).append(transaction)
        self._pending_count += 1
        if self._pending_count > MAX_PENDING:
            yield self._give_up_oldest()

    def _report_unanswered_repeats(
        self, earlier: Iterable[NamedTransaction], answered: NamedTransaction
    ) -> Iterator[Finding]:
        """Report the unanswered requests `earlier`, which equal the answered one."""
        retried = []
        for one in earlier:
            if self._is_next_poll(one, answered):
                yield self._no_response_finding(one)
            else:
                retried.append(one)
        if retried:
            yield _retry_finding(retried[0], answered, len(retried) + 1)

    def _is_next_poll(self, one: NamedTransaction, other: NamedTransaction) -> bool:
        """True if `other` comes after the equal request `one` as the next poll does."""
        usual_ns = self._usual_period_ns(one)
        since_ns = other.start_ns - one.start_ns
        return usual_ns is not None and abs(since_ns - usual_ns) <= PERIOD_TOLERANCE * usual_ns

    def _give_up_oldest(self) -> Finding:
        request, transactions = next(iter(self._pending.items()))
        oldest = transactions.popleft()
        self._pending_count -= 1
        if not transactions:
            del self._pending[request]
        return self._no_response_finding(oldest)

    def _forget(self, connection: _Connection, unit: int | None = None) -> None:
        """Drop the pending requests to one unit on a connection, or to all its units if `unit` is
        None, without a finding.
        """
        for key in [k for k in self._pending if k[0] == connection and unit in (None, k[1])]:
            self._pending_count -= len(self._pending.pop(key))

    def _no_response_finding(self, transaction: NamedTransaction) -> Finding:
        text = f"{request_text(transaction)}: no answer"
        if not self._has_responded[transaction.link, transaction.unit][0]:
            text += f"; unit {transaction.unit} says nothing in this capture"
        return transaction_finding("MB-401", transaction, text)


def _retry_finding(first: NamedTransaction, answered: NamedTransaction, times: int) -> Finding:
    waited_ns = (answered.response_ns or answered.start_ns) - first.start_ns
    text = f"asked {times} times, answered after {waited_ns / 1e9:.1f} s"
    message = f"{request_text(answered)}: {text}"
    return transaction_finding("MB-402", answered, message, ts_ns=first.start_ns)


def _is_surely_unsolicited(state: _ConnectionState, at_ns: int) -> bool:
    """True if a response at the time `at_ns` certainly had no request.

    That is so if the capture would contain the request, because no bytes before the response are
    lost or damaged.
    """
    if state.is_damaged:
        return False
    if state.has_request or state.is_complete:
        return True
    return state.since_ns is not None and at_ns - state.since_ns > PATIENCE_NS


def _unsolicited_text(transaction: NamedTransaction) -> str:
    what = f"answer to {transaction.function_name}"
    if transaction.exception is not None:
        what = f"exception {transaction.exception:02X} to {transaction.function_name}"
    return f"{what}, which no request in the capture asked for"


def _needs_no_response(transaction: NamedTransaction, profile: Profile | None) -> bool:
    """True if the slave carries out the request, but must not respond to it.

    `profile` is the slave's; None if it has none.
    """
    if transaction.transport.over_tcp is Transport.RTU_TCP and transaction.unit == 0:
        return True
    if transaction.function == DIAGNOSTICS and transaction.sub_function == FORCE_LISTEN_ONLY:
        return True
    rule = profile.rule(transaction.function) if profile is not None else None
    return rule is not None and not rule.answers


def _request_bytes(transaction: NamedTransaction) -> bytes:
    """Return the PDU of the request; all bytes of the request if the PDU in them cannot be read."""
    raw = transaction.request_raw
    return whole_pdu(transaction.transport, raw) or raw or b""


# The code below finds frames with a wrong CRC or LRC, and which unit sent them (RTU-201).
#
# The unit id in a damaged frame proves nothing. So the frame is taken for the response to the
# request that was pending when it came. This request is known when its transaction ends without a
# response (modbus/response.py); until then the frame waits. On a serial line, the frame stops
# waiting when a transaction begins after it: then it answers no request. On TCP it goes on waiting,
# because a request without a response may end long after later requests (TIMEOUT_NS in
# decode/network_pairing.py).
#
# Memory: at most MAX_FRAMES waiting frames for each of MAX_ENTRIES links (LruDict in
# sliding_window.py).

_SHOWN = 16
"""A text shows at most this many bytes of a frame."""


class DamagedFrames:
    """Gives a finding for each damaged frame, with the unit if it is known."""

    def __init__(self) -> None:
        self._answers = DamagedAnswers()
        self._waiting: LruDict[str, deque[WireEvent]] = LruDict(deque)

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Take an event of the kind BAD_CHECK."""
        self._answers.note(event)
        if not self._waiting.has_room([event.link]):
            yield from map(_finding_without_unit, self._waiting.pop_oldest())
        waiting = self._waiting[event.link]
        waiting.append(event)
        if len(waiting) > MAX_FRAMES:
            yield _finding_without_unit(waiting.popleft())

    def transaction(self, one: NamedTransaction) -> Iterator[Finding]:
        """Take the next transaction."""
        if one.link not in self._waiting:
            return
        waiting = self._waiting[one.link]
        frame_ns = self._answers.frame_of(one)
        past_ns = one.start_ns if one.transport.is_serial else frame_ns or 0
        while waiting and waiting[0].ts_ns < past_ns:
            yield _finding_without_unit(waiting.popleft())
        if waiting and waiting[0].ts_ns == frame_ns:
            event = waiting.popleft()
            text = f"unit {one.unit}'s answer to {request_text(one)}: {_text(event)}"
            yield transaction_finding("RTU-201", one, text, ts_ns=event.ts_ns)
        if not waiting:
            self._waiting.pop(one.link)

    def close(self) -> Iterator[Finding]:
        """Give the findings about frames that still wait at the end of the capture."""
        for waiting in self._waiting.values():
            yield from map(_finding_without_unit, waiting)


def _finding_without_unit(event: WireEvent) -> Finding:
    return event_finding("RTU-201", event, f"unit unknown: {_text(event)}")


def _text(event: WireEvent) -> str:
    shown = event.raw[:_SHOWN].hex(" ") + (" ..." if len(event.raw) > _SHOWN else "")
    return f"{event.message}: {shown}"


# The rule for WAGO 750 couplers: a watchdog that has expired.
#
# Manual of the WAGO-I/O-SYSTEM 750, watchdog registers (from 1000H on): once the watchdog has
# expired, the coupler responds with exception 04 to every request until the watchdog is started
# again. A single exception 04 between other responses is a failed request; two in a row mean that
# the watchdog has expired.
#
# Memory: for each coupler, the first exception 04 in a row (LruDict in sliding_window.py).


@dataclass(slots=True)
class _Coupler:
    first: NamedTransaction | None = None
    """The first transaction with exception 04 since the coupler last gave another response; None
    if there is none."""
    is_reported: bool = False


class WagoRules:
    """Finds couplers whose watchdog has expired (finding WAGO-X1)."""

    def __init__(self) -> None:
        self._couplers: LruDict[str, _Coupler] = LruDict(_Coupler)

    def transaction(self, transaction: NamedTransaction) -> Iterator[Finding]:
        """Check the next transaction of a coupler. Gives WAGO-X1 if its watchdog has expired."""
        coupler = self._couplers[transaction.destination or transaction.link]
        if transaction.exception == ExceptionCode.SERVER_DEVICE_FAILURE:
            if coupler.first is None:
                coupler.first = transaction
            elif not coupler.is_reported:
                coupler.is_reported = True
                yield transaction_finding(
                    "WAGO-X1",
                    coupler.first,
                    f"exception 04 to {request_text(coupler.first)}, and to the request after it",
                )
        elif transaction.response_raw is not None:
            coupler.first, coupler.is_reported = None, False


def is_wago(profile: Profile) -> bool:
    """True if the profile is that of a WAGO 750 coupler, or extends such a profile."""
    return profile.behaviour is BehaviourName.WAGO
