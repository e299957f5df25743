"""Answers of a recording that were damaged on their way, and what brings them about again."""

# A master that got an answer with a wrong CRC, or half of one, got no answer; so a recording has
# the request unanswered, and behind it bytes that could not be read. Those are taken for its answer
# that begin as an answer of that unit to that function would, and come before the next request on
# the same line and within ANSWER_NS. Bytes that begin like the request itself, addresses included,
# are taken for a damaged repetition of it.
#
# On a line of the same kind the very bytes are sent again. ASCII in place of RTU, or the other way:
# an answer with a wrong check has another wrong check; of a piece of one there is no equal, so
# silence. Modbus/TCP has no check at all: silence.
#
# Only of serial lines and RTU over TCP: what a capture has of a Modbus/TCP answer in part may be
# the capture's own loss.

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Outcome, Response, Transport, whole_pdu
from mbtool.modbus.distortion import Distortion
from mbtool.modbus.functions import EXCEPTION_BIT, READS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.modbus import Transaction

ANSWER_NS = 5_000_000_000
DAMAGED_KINDS = frozenset((EventKind.BAD_CHECK, EventKind.SKIPPED))

_WHOLE_ADU = 1024
"""More bytes than an ADU has."""
_RTU = frozenset((Transport.RTU, Transport.RTU_TCP))


@dataclass(frozen=True, slots=True)
class DamagedAnswer:
    """What stands in the recording for an answer."""

    raw: bytes
    """As captured."""
    transport: Transport
    has_wrong_check: bool
    """It is whole but for its check; else only a part of it, or worse."""
    latency_ns: int

    def again(self, transport: Transport, delay_ns: int) -> Response | None:
        """An answer that arrives on a link in the same way; None where it cannot."""
        if transport is self.transport or {transport, self.transport} <= _RTU:
            return Response(b"\0", delay_ns, Distortion(cut=_WHOLE_ADU, extra=self.raw))
        pdu = whole_pdu(self.transport, self.raw) if self.has_wrong_check else None
        if transport is Transport.TCP or pdu is None:
            return None
        return Response(pdu, delay_ns, Distortion(wrong_check=True))


def damaged_answers(
    asked: Sequence[Transaction], events: Iterable[WireEvent]
) -> dict[int, DamagedAnswer]:
    """By place in `asked`, which is in order of time, the damaged answers of those unanswered."""
    unread: dict[str, list[WireEvent]] = defaultdict(list)
    for event in events:
        if event.kind in DAMAGED_KINDS and event.raw:
            unread[event.link].append(event)
    for each in unread.values():
        each.sort(key=_time)
    found: dict[int, DamagedAnswer] = {}
    next_ns: dict[str, int] = {}
    for place in range(len(asked) - 1, -1, -1):
        one = asked[place]
        request_ns = one.start_ns
        until_ns = min(next_ns.get(one.link, request_ns + ANSWER_NS), request_ns + ANSWER_NS)
        next_ns[one.link] = request_ns
        if one.outcome is not Outcome.NO_ANSWER or one.transport is Transport.TCP:
            continue
        of_link = unread.get(one.link, ())
        for event in of_link[bisect_left(of_link, request_ns, key=_time) :]:
            if event.ts_ns >= until_ns:
                break
            if _is_answer(one, event.raw):
                found[place] = DamagedAnswer(
                    event.raw,
                    one.transport,
                    event.kind is EventKind.BAD_CHECK,
                    event.ts_ns - request_ns,
                )
                break
    return found


def _time(event: WireEvent) -> int:
    return event.ts_ns


def _is_answer(asked: Transaction, raw: bytes) -> bool:
    """Whether bytes begin as an answer to a request would."""
    body, request = _body(asked.transport, raw), _body(asked.transport, asked.request_raw or b"")
    if len(body) < 2 or body[0] != asked.unit or body[1] & ~EXCEPTION_BIT != asked.function:
        return False
    return asked.function not in READS or body[:5] != request[:5]


def _body(transport: Transport, raw: bytes) -> bytes:
    """The unit and what follows, as far as it can be read."""
    if transport is not Transport.ASCII:
        return raw
    digits = raw.lstrip(b":")[: len(raw) // 2 * 2]
    try:
        return bytes.fromhex(digits.split(b"\r")[0].decode("ascii"))
    except ValueError:
        return b""
