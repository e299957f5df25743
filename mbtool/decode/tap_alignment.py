"""Aligns the requests that one tap heard with the responses that another tap heard."""

# Each of the two adapters delivers bytes with its own delay, so a response can seem to begin before
# its request has ended. These rules hold on every line, within the difference of the delays:
#
#     1  a response follows its request         the response may seem up to SKEW_NS too early
#     2  the next request follows the response  the request may seem up to SKEW_NS too early
#     3  a request has at most one response, and responses come in the order of the requests
#     4  a master waits for a response before it sends the next request
#
# Among all alignments that keep rules 1 to 3, the one with the lowest cost is taken. A cost is a
# time in ns: by how much a response is too early for its request or too late for the next one, plus
# the constants below for a pair whose contents do not fit, a request without a response (rule 4)
# and a response without a request. So a pair whose times are wrong by less than SKEW_NS is still
# aligned. If a capture begins with a response whose request is missing, that response stays alone;
# otherwise every later response of a fast poll would be assigned to the wrong request. If earlier
# responses seemed early, a later one costs nothing for being early by the same time.
#
# At most MAX_ALIGNED requests and responses are examined; later ones do not affect the first.

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.decode.pairing import BUS_TIMEOUT_NS
from mbtool.modbus.adu import Adu
from mbtool.modbus.expected_response import is_response_code, is_response_to
from mbtool.modbus.pdu import Pdu, parse_pdu

if TYPE_CHECKING:
    from collections.abc import Sequence

SKEW_NS = 50_000_000
"""The largest difference in ns between the delays of two adapters: three times the 16 ms for which
the latency timer of an FTDI adapter holds bytes back."""

MAX_ALIGNED = 8

_MISMATCH_NS = 4 * SKEW_NS
"""Cost (ns) of aligning a request and a response of the same unit and function of which the
response does not fit, for instance because of its quantity. That is rarer than a lost response."""
_IMPATIENCE = 8
"""Cost (ns) of a request without a response, for each ns by which the master waited less than
SKEW_NS before its next request. Masters wait longer for a response."""
_UNSOLICITED_NS = MAX_ALIGNED * SKEW_NS
"""Cost (ns) of a response without a request: slaves do not send on their own."""
_FIRST_UNSOLICITED_NS = SKEW_NS
"""Cost (ns) of a response without a request if it is the first of a capture: its request may have
been sent before the capture."""
_IMPOSSIBLE_NS = sys.maxsize


@dataclass(frozen=True, slots=True, eq=False)
class TapRequest:
    """A request that a tap heard, with its parsed PDU."""

    adu: Adu
    pdu: Pdu

    @classmethod
    def of(cls, adu: Adu) -> TapRequest:
        return cls(adu, parse_pdu(adu.pdu, Direction.REQUEST))


def can_answer(request: Adu, response: Adu) -> bool:
    """True if a response, or exception response, has the unit and the function of a request."""
    return request.unit == response.unit and is_response_code(request.pdu[0], response.pdu[0])


def request_of_first(
    requests: Sequence[TapRequest],
    responses: Sequence[Adu],
    until_ns: int,
    *,
    ahead_ns: int = 0,
    at_start: bool = False,
) -> int | None:
    """Return the index of the request that the first response belongs to; None if it has none.

    `requests` and `responses` are all ADUs of the two taps that began until `until_ns`, in order of
    time; the first request may be an older, pending one. `ahead_ns` is the time by which earlier
    responses seemed to begin before their request ended. `at_start` is True if the capture begins
    here, so that the request of the first response may be missing.
    """
    if len(requests) > MAX_ALIGNED:
        until_ns = min(until_ns, requests[MAX_ALIGNED].adu.start_ns)
    requests, responses = requests[:MAX_ALIGNED], responses[:MAX_ALIGNED]
    if _pairs_in_order_cost_nothing(requests, responses, ahead_ns):
        return 0  # The usual case; no alignment can cost less.

    def costs(request: int, response: int) -> tuple[int, int, int]:
        """Return the lowest costs (ns) of aligning the requests from the index `request` on with
        the responses from the index `response` on.

        The first cost is that of making the first two a pair, the second that of leaving the first
        request without a response, the third that of leaving the first response without a request.
        """
        has_request, has_response = request < len(requests), response < len(responses)
        paired = unanswered = unsolicited = _IMPOSSIBLE_NS
        if has_request and has_response:
            pair_ns = _pair_cost(requests, request, responses[response], ahead_ns)
            paired = lowest(request + 1, response + 1) + pair_ns
        if has_request:
            unanswered = lowest(request + 1, response) + _unanswered_cost(requests, request)
        if has_response:
            is_first = at_start and response == 0
            alone_ns = _unsolicited_cost(responses[response], until_ns, is_first)
            unsolicited = lowest(request, response + 1) + alone_ns
        return paired, unanswered, unsolicited

    @cache
    def lowest(request: int, response: int) -> int:
        at_end = request == len(requests) and response == len(responses)
        return 0 if at_end else min(costs(request, response))

    for request in range(len(requests)):
        paired, unanswered, unsolicited = costs(request, 0)
        if paired <= min(unanswered, unsolicited):
            return request
        if unsolicited < unanswered:
            return None
    return None


def _pairs_in_order_cost_nothing(
    requests: Sequence[TapRequest], responses: Sequence[Adu], ahead_ns: int
) -> bool:
    """True if there is no cost in pairing the n-th response with the n-th request, for every n."""
    answered = len(responses)
    return (
        0 < answered <= len(requests)
        and not any(
            _pair_cost(requests, index, each, ahead_ns) for index, each in enumerate(responses)
        )
        and not any(_unanswered_cost(requests, index) for index in range(answered, len(requests)))
    )


def _pair_cost(requests: Sequence[TapRequest], index: int, response: Adu, ahead_ns: int) -> int:
    request = requests[index].adu
    if not can_answer(request, response):
        return _IMPOSSIBLE_NS
    early_ns = request.end_ns - response.start_ns
    late_ns = -_IMPOSSIBLE_NS
    if index + 1 < len(requests):
        late_ns = response.end_ns - requests[index + 1].adu.start_ns
    if max(early_ns, late_ns) > SKEW_NS or -early_ns > BUS_TIMEOUT_NS:
        return _IMPOSSIBLE_NS
    mismatch_ns = 0 if is_response_to(requests[index].pdu, response.pdu) else _MISMATCH_NS
    return max(early_ns - ahead_ns, 0) + max(late_ns + ahead_ns, 0) + mismatch_ns


def _unanswered_cost(requests: Sequence[TapRequest], index: int) -> int:
    request = requests[index].adu
    if request.unit == 0 or index + 1 == len(requests):
        return 0  # A broadcast has no response; the last request's may still come.
    waited_ns = requests[index + 1].adu.start_ns - request.end_ns
    return _IMPATIENCE * max(SKEW_NS - waited_ns, 0)


def _unsolicited_cost(response: Adu, until_ns: int, is_first: bool) -> int:
    before_end_ns = until_ns - response.start_ns
    if before_end_ns <= SKEW_NS:
        return max(before_end_ns, 0)  # The request may begin after `until_ns`.
    return _FIRST_UNSOLICITED_NS if is_first else _UNSOLICITED_NS
