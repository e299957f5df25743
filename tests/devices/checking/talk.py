"""Transactions for tests of rules: made from bytes by the joining of the decoder itself."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from mbtool.core import CONNECTION_JOINED, CONNECTION_OPENED, Direction, EventKind, WireEvent
from mbtool.decode.transactions import Ends, broadcast, no_answer, unsolicited, with_response
from mbtool.devices.assignment import Assignment, Assignments, Who
from mbtool.devices.loading import load_profile
from mbtool.devices.naming import Namer
from mbtool.modbus import Transport, mbap_adu, rtu_adu
from mbtool.modbus.adu import Adu, DirectionBy, Verdict

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
MASTER, SLAVE = "10.0.0.1:50000", "10.0.0.2:502"
LINK = "10.0.0.2"
LINE = "rs485"


@cache
def assigned(profile: str | None) -> Assignments:
    return Assignments([] if profile is None else [Assignment(Who(), load_profile(profile))])


def transaction(
    request: str = "03 0000 0001",
    response: str | None = "03 02 1234",
    *,
    at_ms: float = 0,
    latency_ms: float = 1,
    unit: int = 1,
    number: int = 1,
    answer_number: int | None = None,
    source: str = MASTER,
    on_a_line: bool = False,
    retries: int = 0,
    verdicts: tuple[Verdict, ...] = (),
    profile: str | None = None,
) -> NamedTransaction:
    """A transaction whose request ends at this time, counted from START_NS."""
    asked_ns = START_NS + round(at_ms * MS)
    answered_ns = asked_ns + round(latency_ms * MS)
    ends = Ends(LINE) if on_a_line else Ends(LINK, source, SLAVE)
    sides = [
        _adu(request, asked_ns, Direction.REQUEST, unit, number, on_a_line=on_a_line),
        _adu(
            response or "00",
            answered_ns,
            Direction.RESPONSE,
            unit,
            number if answer_number is None else answer_number,
            on_a_line=on_a_line,
        ),
    ]
    if not request:
        made = unsolicited(ends, sides[1])
    elif response is not None:
        made = with_response(ends, sides[0], sides[1], retries, verdicts)
    elif on_a_line and unit == 0:
        made = broadcast(ends, sides[0])
    else:
        made = no_answer(ends, sides[0], retries)
    return named_by(profile).name(made)


@cache
def named_by(profile: str | None) -> Namer:
    return Namer(assigned(profile))


def event(
    kind: EventKind,
    *,
    at_ms: float = 0,
    message: str = "",
    source: str = MASTER,
    destination: str = SLAVE,
    raw: bytes = b"",
) -> WireEvent:
    """An event of the connection."""
    return WireEvent(
        ts_ns=START_NS + round(at_ms * MS),
        link=LINK,
        kind=kind,
        message=message,
        source=source,
        destination=destination,
        raw=raw,
    )


def opened(*, at_ms: float = 0, source: str = MASTER, joined: bool = False) -> WireEvent:
    text = CONNECTION_JOINED if joined else CONNECTION_OPENED
    return event(EventKind.OPENED, at_ms=at_ms, message=text, source=source)


def line_event(kind: EventKind, *, at_ms: float = 0, message: str = "noise") -> WireEvent:
    """An event of the line."""
    at_ns = START_NS + round(at_ms * MS)
    return WireEvent(ts_ns=at_ns, link=LINE, kind=kind, message=message, raw=b"\x01\x02")


def _adu(
    pdu: str, end_ns: int, direction: Direction, unit: int, number: int, *, on_a_line: bool
) -> Adu:
    body = bytes.fromhex(pdu)
    return Adu(
        start_ns=end_ns,
        end_ns=end_ns,
        transport=Transport.RTU if on_a_line else Transport.TCP,
        direction=direction,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=unit,
        pdu=body,
        raw=rtu_adu(unit, body) if on_a_line else mbap_adu(number, unit, body),
        transaction_id=None if on_a_line else number,
    )
