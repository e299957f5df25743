"""Makes the record of a transaction from its request and its response."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgspec

from mbtool.core import Direction
from mbtool.modbus.adu import Adu, Verdict
from mbtool.modbus.functions import READ_BITS, WRITE_ONE, exception_name, function_name
from mbtool.modbus.layouts import COIL_VALUES
from mbtool.modbus.pdu import Pdu, parse_pdu
from mbtool.modbus.request_match import mismatch
from mbtool.modbus.transaction import Outcome, Transaction

MAX_KNOWN = 256
"""Requests whose meaning is remembered; beyond that the one unasked longest is forgotten."""


@dataclass(frozen=True, slots=True)
class Ends:
    """Where a transaction happens: the link, and on a network the ends of its connection."""

    link: str
    master: str | None = None
    slave: str | None = None
    timed: bool = True
    """Whether the times of its bytes are known."""


def together(
    ends: Ends, request: Adu, response: Adu, retries: int, verdicts: tuple[Verdict, ...]
) -> Transaction:
    """A request with its response."""
    asked = _asked(request.pdu)
    answered = parse_pdu(response.pdu, Direction.RESPONSE)
    noticed = [*request.verdicts, *response.verdicts, *verdicts]
    if asked.is_malformed:
        noticed.append(Verdict.MALFORMED_REQUEST)
    malformed = answered.problem or (not asked.is_malformed and mismatch(asked.pdu, answered))
    if malformed:
        noticed.append(Verdict.MALFORMED_RESPONSE)
    exception = answered.exception_code
    if exception is not None:
        outcome = Outcome.EXCEPTION
    else:
        outcome = Outcome.MALFORMED if malformed else Outcome.OK
    return _record(
        ends,
        request,
        asked,
        exception,
        outcome=outcome,
        request_values=_listed(asked.values),
        response_values=_response_values(asked.pdu, answered),
        request_ns=request.end_ns,
        response_ns=response.end_ns,
        latency_ns=_latency_ns(request, response) if ends.timed else None,
        retries=retries,
        request_raw=request.raw,
        response_raw=response.raw,
        verdicts=list(dict.fromkeys(noticed)) if noticed else noticed,
        confidence=min(request.confidence, response.confidence),
    )


def _latency_ns(request: Adu, response: Adu) -> int | None:
    """From the end of the request to the start of the response.

    Where an adapter glued the two, the response's start is only known to lie behind; that is 0. A
    capture whose clock ran backwards has no latency to tell.
    """
    if response.end_ns < request.end_ns:
        return None
    return max(response.start_ns - request.end_ns, 0)


def no_answer(ends: Ends, request: Adu, retries: int) -> Transaction:
    """A request that nobody answered."""
    return _alone(ends, request, Outcome.NO_ANSWER, retries)


def broadcast(ends: Ends, request: Adu) -> Transaction:
    """A request to all units, which none of them answers (Serial Line V1.02, 2.1)."""
    return _alone(ends, request, Outcome.BROADCAST, 0)


def unsolicited(ends: Ends, response: Adu) -> Transaction:
    """A response that no request asked for."""
    answered = parse_pdu(response.pdu, Direction.RESPONSE)
    malformed = [Verdict.MALFORMED_RESPONSE] if answered.problem else []
    return _record(
        ends,
        response,
        _Asked.of(Pdu(answered.function, answered.fields, None)),
        answered.exception_code,
        outcome=Outcome.UNSOLICITED,
        response_values=_listed(_values(answered)),
        response_ns=response.end_ns,
        retries=0,
        response_raw=response.raw,
        verdicts=[*response.verdicts, *malformed],
        confidence=response.confidence,
    )


def _alone(ends: Ends, request: Adu, outcome: Outcome, retries: int) -> Transaction:
    asked = _asked(request.pdu)
    malformed = [Verdict.MALFORMED_REQUEST] if asked.is_malformed else []
    return _record(
        ends,
        request,
        asked,
        None,
        outcome=outcome,
        request_values=_listed(asked.values),
        request_ns=request.end_ns,
        retries=retries,
        request_raw=request.raw,
        verdicts=[*request.verdicts, *malformed],
        confidence=request.confidence,
    )


class _Asked(msgspec.Struct, frozen=True):
    """What a request asks."""

    pdu: Pdu
    is_malformed: bool
    function: int
    function_name: str
    sub_function: int | None
    address: int | None
    quantity: int | None
    """How many; a write of one value is of one."""
    write_address: int | None
    values: tuple[int, ...] | None

    @classmethod
    def of(cls, pdu: Pdu) -> _Asked:
        sub_function = pdu.number("sub_function")
        quantity = pdu.number("quantity")
        if quantity is None and pdu.code in WRITE_ONE and "address" in pdu.fields:
            quantity = 1
        return cls(
            pdu=pdu,
            is_malformed=pdu.problem is not None,
            function=pdu.code,
            function_name=function_name(pdu.code),
            sub_function=pdu.number("mei_type") if sub_function is None else sub_function,
            address=pdu.number("address"),
            quantity=quantity,
            write_address=pdu.number("write_address"),
            values=_values(pdu),
        )


@lru_cache(maxsize=MAX_KNOWN)
def _asked(request: bytes) -> _Asked:
    """Read a request's PDU, once: masters ask the same few over and over."""
    return _Asked.of(parse_pdu(request, Direction.REQUEST))


def _record(
    ends: Ends, adu: Adu, asked: _Asked, exception: int | None, **facts: Any
) -> Transaction:
    return Transaction(
        link=ends.link,
        transport=adu.transport,
        source=ends.master,
        destination=ends.slave,
        unit=adu.unit,
        transaction_id=adu.transaction_id,
        function=asked.function,
        function_name=asked.function_name,
        sub_function=asked.sub_function,
        address=asked.address,
        quantity=asked.quantity,
        write_address=asked.write_address,
        exception=exception,
        exception_name=None if exception is None else exception_name(exception),
        direction_by=adu.direction_by,
        **facts,
    )


def _values(pdu: Pdu) -> tuple[int, ...] | None:
    """The registers or bits that a PDU carries."""
    values = pdu.numbers("values")
    if values is not None:
        return values
    values = pdu.numbers("fifo")
    if values is not None:
        return values[1:]
    value = pdu.number("value")
    if value is not None:
        if pdu.function == 0x05:
            return (COIL_VALUES[value],) if value in COIL_VALUES else None
        return (value,)
    for names in (("and_mask", "or_mask"), ("status", "event_count"), ("status",)):
        numbers = [pdu.number(name) for name in names]
        if None not in numbers:
            return tuple(number for number in numbers if number is not None)
    return None


def _response_values(asked: Pdu, answered: Pdu) -> list[int] | None:
    """What a response tells; an echo tells nothing that the request did not."""
    if asked.code in WRITE_ONE:
        return None
    values = _values(answered)
    if values is not None and asked.code in READ_BITS:
        values = values[: asked.number("quantity")]  # The rest of the last byte is padding.
    return _listed(values)


def _listed(values: tuple[int, ...] | None) -> list[int] | None:
    return None if values is None else list(values)
