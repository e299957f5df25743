"""Which response belongs to which request, where each side has times of its own."""

# Two adapters deliver what they hear each with a delay of its own, so that a response can seem to
# begin before its request has ended. What is certain on a line:
#
#     a response follows its request              it begins SKEW_NS before its end at the earliest
#     the next request follows the response       it begins SKEW_NS before its end at the earliest
#     a request has one response, and they come in order
#     a master waits for a response before it asks again
#
# Of all ways to join requests and responses that keep to the first three, the one that strains what
# is known least is taken. Strain is time: by how much a response is too early for its request or
# too late for the next one, and for what is left alone or does not fit as much as the table below
# says. So a pair that is off by less than the skew is joined, but where a capture begins with a
# response whose request was not heard, polls that follow closely are not all shifted by one. What
# pairs have shown of the delays already is no strain.
#
# Looks at MOST requests and MOST responses; what lies beyond does not bear on the first.

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.decode.pairing import BUS_TIMEOUT_NS
from mbtool.modbus.adu import Adu
from mbtool.modbus.pdu import Pdu, parse_pdu
from mbtool.modbus.request_match import is_response_code, is_response_to

if TYPE_CHECKING:
    from collections.abc import Sequence

SKEW_NS = 50_000_000
"""Three times as long as an FTDI adapter's latency timer holds bytes back (16 ms)."""

MOST = 8

_MISFIT_NS = 4 * SKEW_NS
"""Same unit and function, but for instance another quantity: rarer than a lost answer."""
_HASTE = 8
"""What each ns counts by which a master waited less than the skew for an answer: none does that."""
_UNASKED_NS = MOST * SKEW_NS
"""Slaves do not speak unasked."""
_FIRST_UNASKED_NS = SKEW_NS
"""But a capture may begin behind a request."""
_NEVER_NS = 1 << 60


@dataclass(frozen=True, slots=True, eq=False)
class TapRequest:
    """A request, and what it asks."""

    adu: Adu
    asked: Pdu

    @classmethod
    def of(cls, adu: Adu) -> TapRequest:
        return cls(adu, parse_pdu(adu.pdu, Direction.REQUEST))


def can_answer(request: Adu, response: Adu) -> bool:
    """Whether they name the same unit and function."""
    return request.unit == response.unit and is_response_code(request.pdu[0], response.pdu[0])


def asker_of_first(
    requests: Sequence[TapRequest],
    responses: Sequence[Adu],
    until_ns: int,
    *,
    ahead_ns: int = 0,
    at_start: bool = False,
) -> int | None:
    """Which request the first response belongs to, by its place, or None.

    Both are in order, all that began until a time; the first request may be one that has been
    waiting for long. `ahead_ns` is by how much responses are known to seem early. At the start of a
    capture the first response may belong to a request that was not heard.
    """
    if len(requests) > MOST:
        until_ns = min(until_ns, requests[MOST].adu.start_ns)
    requests, responses = requests[:MOST], responses[:MOST]
    if _is_without_strain(requests, responses, ahead_ns):
        return 0  # As nearly always; no other way can be better.

    def choices(place: int, at: int) -> tuple[int, int, int]:
        """The strain from here on if the two are joined, and if either is left alone."""
        has_request, has_response = place < len(requests), at < len(responses)
        joined = unanswered = unasked = _NEVER_NS
        if has_request and has_response:
            joined = least(place + 1, at + 1) + _joined_ns(requests, place, responses[at], ahead_ns)
        if has_request:
            unanswered = least(place + 1, at) + _unanswered_ns(requests, place)
        if has_response:
            is_first = at_start and at == 0
            unasked = least(place, at + 1) + _unasked_ns(responses[at], until_ns, is_first)
        return joined, unanswered, unasked

    @cache
    def least(place: int, at: int) -> int:
        at_end = place == len(requests) and at == len(responses)
        return 0 if at_end else min(choices(place, at))

    for place in range(len(requests)):
        joined, unanswered, unasked = choices(place, 0)
        if joined <= min(unanswered, unasked):
            return place
        if unasked < unanswered:
            return None
    return None


def _is_without_strain(
    requests: Sequence[TapRequest], responses: Sequence[Adu], ahead_ns: int
) -> bool:
    """Whether each response is its request's, one by one, and their times say so too."""
    answered = len(responses)
    return (
        0 < answered <= len(requests)
        and not any(
            _joined_ns(requests, place, each, ahead_ns) for place, each in enumerate(responses)
        )
        and not any(_unanswered_ns(requests, place) for place in range(answered, len(requests)))
    )


def _joined_ns(requests: Sequence[TapRequest], place: int, response: Adu, ahead_ns: int) -> int:
    request = requests[place].adu
    if not can_answer(request, response):
        return _NEVER_NS
    early_ns = request.end_ns - response.start_ns
    late_ns = -_NEVER_NS
    if place + 1 < len(requests):
        late_ns = response.end_ns - requests[place + 1].adu.start_ns
    if max(early_ns, late_ns) > SKEW_NS or -early_ns > BUS_TIMEOUT_NS:
        return _NEVER_NS
    misfit_ns = 0 if is_response_to(requests[place].asked, response.pdu) else _MISFIT_NS
    return max(early_ns - ahead_ns, 0) + max(late_ns + ahead_ns, 0) + misfit_ns


def _unanswered_ns(requests: Sequence[TapRequest], place: int) -> int:
    request = requests[place].adu
    if request.unit == 0 or place + 1 == len(requests):
        return 0
    waited_ns = requests[place + 1].adu.start_ns - request.end_ns
    return _HASTE * max(SKEW_NS - waited_ns, 0)


def _unasked_ns(response: Adu, until_ns: int, is_first: bool) -> int:
    early_ns = until_ns - response.start_ns
    if early_ns <= SKEW_NS:
        return max(early_ns, 0)  # Its request may lie beyond what is looked at.
    return _FIRST_UNASKED_NS if is_first else _UNASKED_NS
