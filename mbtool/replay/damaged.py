"""Finds damaged responses in a recording, and makes responses with the same damage."""

# If a response was incomplete or had a wrong CRC, the recording has a request without an answer,
# followed by bytes that could not be decoded. These bytes count as the damaged response if they
# begin with the unit and the function of the request, and come before the next request on the same
# line and within RESPONSE_NS. If the bytes also have the address of a read request, they count as a
# damaged repetition of the request.
#
# If the recording is played on the same kind of line, the same bytes are sent. Between RTU and
# ASCII, a response with a wrong checksum is sent with a wrong checksum, and an incomplete response
# is left out. On Modbus/TCP, which has no checksum, both kinds are left out.
#
# Only serial lines and RTU over TCP are examined: if part of a Modbus/TCP response is missing, the
# capture itself may have lost it.

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Outcome, Response, Transaction, Transport, whole_pdu
from mbtool.modbus.functions import EXCEPTION_BIT, READS
from mbtool.modbus.response import Distortion

RESPONSE_NS = 5_000_000_000
DAMAGED_KINDS = frozenset((EventKind.BAD_CHECK, EventKind.SKIPPED))

_WHOLE_ADU = 1024
"""More bytes than any ADU has. Cutting this many off a made response leaves nothing of it, so that
only the recorded bytes are sent."""
_RTU = frozenset((Transport.RTU, Transport.RTU_TCP, Transport.RTU_UDP))


@dataclass(frozen=True, slots=True)
class DamagedAnswer:
    """A damaged response in a recording."""

    raw: bytes
    """The bytes of the response with unit and checksum, as they were captured."""
    transport: Transport
    has_wrong_check: bool
    """True if only the checksum of the response is wrong; False if the response is incomplete."""
    latency_ns: int

    def with_same_damage(self, transport: Transport, delay_ns: int) -> Response | None:
        """Return a response with the same damage, to be sent `delay_ns` after the request on a link
        with this transport.

        None if no response is to be sent, because such a link cannot carry the damage.
        """
        if transport is self.transport or {transport, self.transport} <= _RTU:
            return Response(b"\0", delay_ns, Distortion(cut=_WHOLE_ADU, extra=self.raw))
        pdu = whole_pdu(self.transport, self.raw) if self.has_wrong_check else None
        if transport.has_mbap or pdu is None:
            return None
        return Response(pdu, delay_ns, Distortion(wrong_check=True))


def damaged_answers(
    asked: Sequence[Transaction], events: Iterable[WireEvent]
) -> dict[int, DamagedAnswer]:
    """Find the damaged responses to requests for which the recording has no intact one.

    `asked` holds the transactions in order of time. `events` are the events of the same recording;
    those that hold undecoded bytes are searched. The keys of the result are indices in `asked`.
    """
    undecoded: dict[str, list[WireEvent]] = defaultdict(list)
    for event in events:
        if event.kind in DAMAGED_KINDS and event.raw:
            undecoded[event.link].append(event)
    for each in undecoded.values():
        each.sort(key=_time)
    found: dict[int, DamagedAnswer] = {}
    next_ns: dict[str, int] = {}
    """By link, the time (UTC ns) of the request that follows the present one. The loop below goes
    from the last request to the first."""
    for index in range(len(asked) - 1, -1, -1):
        one = asked[index]
        request_ns = one.start_ns
        until_ns = min(next_ns.get(one.link, request_ns + RESPONSE_NS), request_ns + RESPONSE_NS)
        next_ns[one.link] = request_ns
        if one.outcome is not Outcome.NO_ANSWER or one.transport.has_mbap:
            continue
        of_link = undecoded.get(one.link, ())
        for event in of_link[bisect_left(of_link, request_ns, key=_time) :]:
            if event.ts_ns >= until_ns:
                break
            if _begins_like_response(one, event.raw):
                found[index] = DamagedAnswer(
                    event.raw,
                    one.transport,
                    event.kind is EventKind.BAD_CHECK,
                    event.ts_ns - request_ns,
                )
                break
    return found


def _time(event: WireEvent) -> int:
    return event.ts_ns


def _begins_like_response(asked: Transaction, raw: bytes) -> bool:
    """True if `raw`, which could not be decoded, begins with the unit and function of the request
    of `asked`, as a response does.

    False if it also has the address of a read request: then it is a repetition of the request.
    """
    body, request = _body(asked.transport, raw), _body(asked.transport, asked.request_raw or b"")
    if len(body) < 2 or body[0] != asked.unit or body[1] & ~EXCEPTION_BIT != asked.function:
        return False
    return asked.function not in READS or body[:5] != request[:5]


def _body(transport: Transport, raw: bytes) -> bytes:
    """Return the bytes of a serial ADU, given as captured, from the unit on, with the checksum.

    An ASCII frame is converted from hexadecimal digits up to the first carriage return; the result
    is empty if it contains other characters.
    """
    if transport is not Transport.ASCII:
        return raw
    digits = raw.lstrip(b":")[: len(raw) // 2 * 2]
    try:
        return bytes.fromhex(digits.split(b"\r")[0].decode("ascii"))
    except ValueError:
        return b""
