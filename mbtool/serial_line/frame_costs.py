"""Computes how unlikely a frame is as a request, and as a response, in a given bus state.

Costs are in bits: the negative logarithm of a probability, to base 2.
"""

# A response names the unit and function of the pending request, and fits its quantity or echoes its
# address. Without a pending request, a frame with the form of a request is a request. Requests and
# responses of 05, 06, 08, 15H and 16H look alike, so only the bus state and the silences tell them
# apart: masters wait longer before a retry than slaves take to respond. Some responses of 01, 02,
# 14H and 17H are as long as a request. Such a frame counts as the response, however late, if it
# would be an implausible request, or a request never heard on this line.

from __future__ import annotations

from functools import lru_cache
from math import log2

from mbtool.core import Direction
from mbtool.core.limits import LAST_UNIT
from mbtool.modbus.functions import (
    ECHOING,
    EXCEPTION_BIT,
    FUNCTIONS,
    NEVER_ECHOED,
    READ_BITS,
    WRITE_SEVERAL,
)
from mbtool.modbus.pdu import parse_pdu, pdu_length
from mbtool.modbus.register_access import keeps_limits
from mbtool.serial_line import costs
from mbtool.serial_line.bus_state import MAX_PENDING_NS, BusState, PendingRequest
from mbtool.serial_line.costs import is_implausible_request, is_implausible_response, is_padded
from mbtool.serial_line.line_history import ENOUGH_PAUSES, LineHistory
from mbtool.serial_line.line_statistics import LatencyStatistics

REMEMBERED = 256
"""The size of the cache of _breaks_limits, in PDUs. In doubt, the cost of the same frame is asked
for several times."""
USUAL_TIMEOUT_NS = 200_000_000
"""Masters seldom wait less than this, in ns, for a response."""

USUAL_RETRIES = 3
"""Masters usually repeat a request at most this many times."""

CostParts = tuple[float, float]
"""The cost of a frame in bits, in two parts: the first follows from the bus state, the second from
the silence before the frame."""


def frame_cost(
    history: LineHistory, state: BusState, unit: int, pdu: bytes, role: Direction, at_ns: int
) -> CostParts:
    """Return the cost, in bits, of taking a frame for `role`; its first byte began at `at_ns`.

    The first part of the cost follows from the bus state, the second from the silence before the
    frame. The second is 0 if silences do not tell who speaks.
    """
    if role is Direction.REQUEST:
        cost, by_time = _request_cost(history, state, unit, pdu, at_ns)
        if _is_only_a_response(history, state.pending, unit, pdu):
            cost += costs.REQUEST_FITS_PENDING
        if history.hears_only_slaves:
            cost += costs.REQUEST_ON_THE_SLAVES_SIDE
    else:
        cost, by_time = _response_cost(history, state, unit, pdu, at_ns)
    if unit > LAST_UNIT:
        cost += costs.RESERVED_UNIT
    return cost, by_time if history.trusts_silences else 0.0


def _request_cost(
    history: LineHistory, state: BusState, unit: int, pdu: bytes, at_ns: int
) -> CostParts:
    cost = costs.REQUEST
    if is_implausible_request(pdu):
        cost += costs.IMPLAUSIBLE_REQUEST
    pending, overdue = state.pending_at(at_ns), state.overdue
    is_retry = pending is not None and pending.is_same(unit, pdu)
    is_repeat = state.answered is not None and state.answered.is_same(unit, pdu)
    if is_repeat:
        if not history.trusts_silences or overdue is not None:
            again = costs.REPEAT_AGAIN if state.is_repeat else history.repeat.bits
            most = costs.REPEAT_AFTER_RESPONSE if history.trusts_silences else again
            cost += min(history.repeat.bits, again, most)
    elif state.last_response == pdu and _may_be_second_response(state.answered, unit, pdu):
        cost += costs.REQUEST_EQUALS_RESPONSE
    if not (is_retry or is_repeat or (unit, pdu) in history.requests):
        cost += _new_request_cost(pdu)
    if pending is None:
        return cost, _short_pause_cost(history, state, at_ns) if is_repeat else 0.0
    is_rewrite = not is_retry and pdu[0] in ECHOING and pending.has_address_of(unit, pdu)
    # A frame that writes another value to the same address may be the response with a wrong value.
    # So it does not show that the unit is absent.
    silent = history.unanswered_bits(unit) if is_rewrite else history.silent_bits(state, pending)
    if not is_retry:
        cost += max(history.no_answer.bits - silent, costs.MIN_UNANSWERED)
        if is_rewrite:
            cost += history.rewrite.bits
    elif overdue is not None and overdue.is_same(unit, pdu):
        is_usual = state.retries < USUAL_RETRIES - 1
        cost += costs.SECOND_RETRY if is_usual else history.retry.bits
    else:
        cost += max(history.retry.bits - silent, costs.RETRY_LIMITS[0])
    return cost, _early_cost(history, state, pending, at_ns, is_retry=is_retry)


def _short_pause_cost(history: LineHistory, state: BusState, at_ns: int) -> float:
    """Return the extra cost, in bits, of a request that equals the one just answered.

    It is 0 unless the pause between the response and the request, which begins at `at_ns`, is
    unusually short.
    """
    if not history.trusts_silences or history.pauses < ENOUGH_PAUSES or state.last_ns is None:
        return 0.0
    is_short = at_ns - state.last_ns < history.shortest_pause_ns * costs.SHORT_PAUSE_SHARE
    return costs.SHORT_PAUSE if is_short else 0.0


def _usual_pause_cost(
    history: LineHistory, state: BusState, overdue: PendingRequest, at_ns: int
) -> float:
    """Return the extra cost, in bits, of a second response to `overdue` and its retry.

    It is 0 unless the second response, which begins at `at_ns`, comes as late after the first one
    as this master usually sends its next request.
    """
    answered, last_ns = state.answered, state.last_ns
    if last_ns is None or answered is None or answered.pdu != overdue.pdu:
        return 0.0
    if not history.trusts_silences or history.pauses < ENOUGH_PAUSES:
        return 0.0
    is_usual = at_ns - last_ns >= history.shortest_pause_ns * costs.USUAL_PAUSE_SHARE
    return costs.USUAL_PAUSE if is_usual else 0.0


def _early_cost(
    history: LineHistory, state: BusState, pending: PendingRequest, at_ns: int, *, is_retry: bool
) -> float:
    """Return the extra cost, in bits, of a request that comes while the master should still wait.

    `pending` is the request for whose response it waits. `is_retry` is True if the new request,
    which begins at `at_ns`, equals `pending`. 0 if the master has waited long enough.
    """
    if not history.trusts_silences:
        return 0.0
    waited_ns, overdue = at_ns - pending.awaited_from_ns, state.overdue
    if waited_ns <= 0 and not history.shows_master_wait(waited_ns):
        return 0.0  # The frames were merged, and nothing tells how long the master waited.
    if history.latency.is_known and history.latency.doublings_late(waited_ns) < 0:
        is_whole = is_retry and pending.pdu[0] in WRITE_SEVERAL and not history.timeout.is_known
        return max(costs.EARLY_REQUEST, _short_timeout_cost(waited_ns) if is_whole else 0.0)
    if history.timeout.is_known:
        return costs.EARLY_REQUEST if history.timeout.is_not_over(waited_ns) else 0.0
    if overdue is not None and overdue.is_same(pending.unit, pending.pdu):
        before_ns = pending.silence_before_ns or 0
        return costs.EARLY_REQUEST if waited_ns < before_ns * costs.SOONER else 0.0
    if is_retry and (pending.pdu[0] in ECHOING or pending.pdu[0] in WRITE_SEVERAL):
        return _short_timeout_cost(waited_ns)
    return 0.0


def _short_timeout_cost(waited_ns: int) -> float:
    """Return the extra cost, in bits, of a retry that comes sooner than masters usually send it."""
    return costs.SHORT_TIMEOUT * max(log2(USUAL_TIMEOUT_NS / max(waited_ns, 1)), 0.0)


def _may_be_second_response(answered: PendingRequest | None, unit: int, pdu: bytes) -> bool:
    """True if a frame that equals the last response may be a second response of the same slave.

    `answered` is the request that the last response answered; None if that is unknown.
    """
    return answered.unit == unit if answered else pdu[0] not in ECHOING


def _new_request_cost(pdu: bytes) -> float:
    """The extra cost, in bits, of a request that this line has not carried before.

    It is higher if the request breaks the standard's limits.
    """
    if pdu[0] in FUNCTIONS and _breaks_limits(pdu):
        return costs.NEW_REQUEST + costs.MALFORMED
    return costs.NEW_REQUEST


def _breaks_limits(pdu: bytes) -> bool:
    """True if a frame has the form of a request, and asks for more than the standard allows."""
    has_form, keeps = _as_request(pdu)
    return has_form and not keeps


@lru_cache(REMEMBERED)
def _as_request(pdu: bytes) -> tuple[bool, bool]:
    """Return if a PDU has the form of a request, and if as a request it keeps the limits."""
    request = parse_pdu(pdu, Direction.REQUEST)
    return request.problem is None, keeps_limits(request)


def _response_cost(
    history: LineHistory, state: BusState, unit: int, pdu: bytes, at_ns: int
) -> CostParts:
    if unit == 0:  # Nobody responds to a broadcast.
        return costs.UNREQUESTED_RESPONSE + costs.MALFORMED, 0.0
    if state.pending is not None and state.pending.fits(unit, pdu):
        return _fitting_response_cost(history, state, state.pending, pdu, at_ns)
    odd = costs.MALFORMED if is_implausible_response(pdu) else 0.0
    if history.hears_only_slaves:
        return costs.RESPONSE + odd, 0.0
    pending, overdue = state.pending_at(at_ns), state.overdue
    if pending is not None and pending.is_named_by(unit, pdu[0]):
        if pdu[0] in ECHOING or pending.is_same(unit, pdu):
            return _wrong_echo_cost(history, state, pending, pdu, at_ns)
        return costs.MISMATCHED_RESPONSE + odd, 0.0
    if overdue is not None and _answers_late(overdue, unit, pdu, at_ns):
        by_time = _usual_pause_cost(history, state, overdue, at_ns)
        return _late_response_cost(state, pending, overdue, pdu), by_time
    if state.follows_damage and _is_unrequested_exception(history, unit, pdu):
        odd += costs.UNREQUESTED_EXCEPTION
    if pending is None and state.follows_damage:
        return costs.RESPONSE_AFTER_DAMAGE + odd, 0.0
    is_first = pending is None and state.last_ns is None
    return (costs.RESPONSE_AT_START if is_first else costs.UNREQUESTED_RESPONSE) + odd, 0.0


def _wrong_echo_cost(
    history: LineHistory, state: BusState, pending: PendingRequest, pdu: bytes, at_ns: int
) -> CostParts:
    """The cost, in bits, of a response to a write that does not repeat what was written."""
    silence_ns = at_ns - pending.awaited_from_ns
    by_time = _lateness_cost(history, pending, silence_ns, is_echo=True)
    if not pending.has_address_of(pending.unit, pdu):
        return costs.MISMATCHED_ECHO, by_time
    times = history.wrong_echoes.get((pending.unit, pdu[0]), 0)
    cost = costs.WRONG_ECHO if pdu[0] in ECHOING else costs.WHOLE_ECHO
    if pending.unit not in history.answering:
        is_silent = pending.unit in history.unanswered
        cost += costs.WRONG_ECHO_OF_SILENT_UNIT if is_silent else costs.WRONG_ECHO_OF_NEW_UNIT
    cost -= costs.WRONG_ECHO_AGAIN * times
    return cost + history.unanswered_bits(pending.unit), by_time


def _is_unrequested_exception(history: LineHistory, unit: int, pdu: bytes) -> bool:
    """True for an exception response to a function that was never requested of its unit."""
    code = pdu[0] ^ EXCEPTION_BIT
    return code < EXCEPTION_BIT and (unit, code) not in history.functions


def _answers_late(overdue: PendingRequest, unit: int, pdu: bytes, at_ns: int) -> bool:
    """True if a frame can be a late response to `overdue`, a request that the master has given up.

    `at_ns` is the time at which the first byte of the frame began.
    """
    if pdu == overdue.pdu and pdu[0] in NEVER_ECHOED:  # The master repeats its read.
        return False
    return at_ns - overdue.awaited_from_ns <= MAX_PENDING_NS and overdue.fits(unit, pdu)


def _late_response_cost(
    state: BusState, pending: PendingRequest | None, overdue: PendingRequest, pdu: bytes
) -> float:
    # `after` is the request sent after the given-up one. It is pending, or was answered last.
    after = pending or state.answered
    is_other = after is not None and not after.is_same(overdue.unit, overdue.pdu)
    cost = costs.LATE_RESPONSE_TO_OTHER if is_other else costs.LATE_RESPONSE
    first = state.last_response
    is_second = state.answered is not None and state.answered.pdu == overdue.pdu
    is_like_first = len(pdu) == len(first) and (pdu == overdue.pdu) == (first == overdue.pdu)
    return cost + costs.UNLIKE_FIRST_RESPONSE if is_second and not is_like_first else cost


def _fitting_response_cost(
    history: LineHistory, state: BusState, pending: PendingRequest, pdu: bytes, at_ns: int
) -> CostParts:
    """The cost, in bits, of a response that fits the pending request and begins at `at_ns`."""
    silence_ns, is_echo = at_ns - pending.awaited_from_ns, pdu == pending.pdu
    by_time = _lateness_cost(history, pending, silence_ns, is_echo=is_echo)
    if by_time and _is_only_a_response(history, pending, pending.unit, pdu):
        by_time = 0.0
    if pdu[0] in READ_BITS and not (is_echo or is_padded(pending.pdu, pdu)):
        return costs.MALFORMED, by_time
    if not is_echo:
        return costs.RESPONSE, by_time
    if pdu[0] in NEVER_ECHOED:
        # A read of 17 to 24 bits from an address of 0300H to 03FFH has the form of its response:
        # its third byte, 03, is the byte count.
        return costs.ECHO_OF_READ, by_time
    if pdu[0] not in ECHOING:
        return costs.ECHO_OF_UNKNOWN_FUNCTION, by_time or costs.ECHO_IN_TIME
    before_ns = pending.silence_before_ns
    if not state.direction_known and before_ns and silence_ns > 2 * before_ns:
        by_time += costs.REVERSED_PAIR
    if not history.trusts_silences:
        return costs.RESPONSE + history.silent_bits(state, pending), by_time
    return costs.RESPONSE, by_time


def _lateness_cost(
    history: LineHistory, pending: PendingRequest, silence_ns: int, *, is_echo: bool
) -> float:
    """Return the cost, in bits, of the silence between a request and its response.

    It is 0 unless the response is late. `is_echo` is True if the response equals the request, so
    that it may be a retry instead.
    """
    if not history.trusts_silences:
        return 0.0
    latency = history.latency
    if not is_echo:
        doublings = latency.doublings_late(silence_ns)
        if doublings <= LatencyStatistics.MARGIN_DOUBLINGS:
            return 0.0
        return min(costs.LATE + costs.LATE_PER_DOUBLING * doublings, costs.MAX_LATENESS)
    most, timeout = costs.MAX_ECHO_LATENESS, history.timeout
    if timeout.is_known:
        share = timeout.over_probability(silence_ns)
        if share >= 1.0 and latency.doublings_late(silence_ns) > costs.NEAR_DOUBLINGS:
            return costs.MAX_ECHO_LATENESS
        if share > 0.0:
            retry = costs.REQUEST + history.retry.bits
            return retry + costs.NEAR_TIMEOUT * (2 * share - 1)
        if timeout.is_not_over(silence_ns):
            most = costs.LATE_BEFORE_TIMEOUT
    heard = history.echo_latencies.get((pending.unit, pending.pdu[0]))
    if heard and heard.has_taken_as_long(silence_ns):
        return 0.0
    if history.all_echo_latencies.has_taken_as_long(silence_ns):
        most = min(most, costs.LATE_AS_OTHERS)
    # An echo (a response that equals its request) that comes later than any other response may be a
    # retry. So MARGIN_DOUBLINGS is allowed for only if it comes sooner than any retry can.
    doublings = latency.doublings_late(silence_ns, LatencyStatistics.MIN_WRITE_NS)
    is_soon = silence_ns < LatencyStatistics.MIN_RETRY_NS
    if doublings <= (LatencyStatistics.MARGIN_DOUBLINGS if is_soon else 0.0):
        return 0.0
    return min(costs.LATE + costs.LATE_PER_DOUBLING * doublings, most)


def _is_only_a_response(
    history: LineHistory, pending: PendingRequest | None, unit: int, pdu: bytes
) -> bool:
    """True if a frame has the length of a request, but is improbable as one.

    That is so if the frame fits the pending request as its response, and its contents are
    implausible in a request or were never heard in one.
    """
    if pending is None or pdu[0] not in FUNCTIONS or pdu == pending.pdu:
        return False
    if not pending.fits(unit, pdu):
        return _is_malformed_response(pending, unit, pdu)
    if pdu_length(pdu, Direction.REQUEST) != len(pdu):
        return False
    if is_implausible_request(pdu) or not _as_request(pdu)[1]:
        return True
    if (unit, pdu) in history.requests or pending.expected.size != len(pdu):
        return False
    # If function, high byte of the address and quantity are those of the pending request, the frame
    # is probably the next request of the master's list.
    is_alike = (pdu[1], pdu[3:5]) == (pending.pdu[1], pending.pdu[3:5])
    return not is_alike and (pdu[0] not in READ_BITS or is_padded(pending.pdu, pdu))


def _is_malformed_response(pending: PendingRequest, unit: int, pdu: bytes) -> bool:
    """True if a frame answers the pending request with a wrong byte count, and is out of the
    standard's limits as a request: 03 03 123400 to a read of one register.
    """
    is_of_request = unit == pending.unit and pdu[0] == pending.pdu[0]
    if not is_of_request or pdu_length(pdu, Direction.RESPONSE) != len(pdu):
        return False
    return _breaks_limits(pdu)
