"""Makes the record of a transaction from its request and its response."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbtool.core import Direction
from mbtool.modbus.adu import Adu, Verdict
from mbtool.modbus.functions import exception_name, function_name
from mbtool.modbus.pdu import Pdu, parse_pdu
from mbtool.modbus.transaction import Outcome, Transaction
from mbtool.modbus.turns import mismatch

COIL_VALUES = {0x0000: 0, 0xFF00: 1}  # V1.1b3, 6.5


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
    asked = parse_pdu(request.pdu, Direction.REQUEST)
    answered = parse_pdu(response.pdu, Direction.RESPONSE)
    noticed = [*request.verdicts, *response.verdicts, *verdicts]
    if asked.problem is not None:
        noticed.append(Verdict.MALFORMED_REQUEST)
    malformed = answered.problem or (asked.problem is None and mismatch(asked, answered))
    if malformed:
        noticed.append(Verdict.MALFORMED_RESPONSE)
    if answered.exception_code is not None:
        outcome = Outcome.EXCEPTION
    else:
        outcome = Outcome.MALFORMED if malformed else Outcome.OK
    return _record(
        ends,
        request,
        asked,
        answered,
        outcome=outcome,
        response_values=_response_values(asked, answered),
        request_ns=request.end_ns,
        response_ns=response.end_ns,
        latency_ns=_latency_ns(request, response) if ends.timed else None,
        retries=retries,
        request_raw=request.raw,
        response_raw=response.raw,
        verdicts=list(dict.fromkeys(noticed)),
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
        Pdu(answered.function, answered.fields, None),
        answered,
        outcome=Outcome.UNSOLICITED,
        response_values=_values(answered),
        response_ns=response.end_ns,
        retries=0,
        response_raw=response.raw,
        verdicts=[*response.verdicts, *malformed],
        confidence=response.confidence,
    )


def _alone(ends: Ends, request: Adu, outcome: Outcome, retries: int) -> Transaction:
    asked = parse_pdu(request.pdu, Direction.REQUEST)
    malformed = [Verdict.MALFORMED_REQUEST] if asked.problem else []
    return _record(
        ends,
        request,
        asked,
        None,
        outcome=outcome,
        request_ns=request.end_ns,
        retries=retries,
        request_raw=request.raw,
        verdicts=[*request.verdicts, *malformed],
        confidence=request.confidence,
    )


def _record(ends: Ends, adu: Adu, asked: Pdu, answered: Pdu | None, **facts: Any) -> Transaction:
    exception = answered.exception_code if answered is not None else None
    sub_function = asked.number("sub_function")
    return Transaction(
        link=ends.link,
        transport=adu.transport,
        source=ends.master,
        destination=ends.slave,
        unit=adu.unit,
        transaction_id=adu.transaction_id,
        function=asked.code,
        function_name=function_name(asked.code),
        sub_function=asked.number("mei_type") if sub_function is None else sub_function,
        address=asked.number("address"),
        quantity=_quantity(asked),
        write_address=asked.number("write_address"),
        request_values=None if "request_raw" not in facts else _values(asked),
        exception=exception,
        exception_name=None if exception is None else exception_name(exception),
        direction_by=adu.direction_by,
        **facts,
    )


def _quantity(asked: Pdu) -> int | None:
    """How many; a write of one value is of one."""
    quantity = asked.number("quantity")
    if quantity is None and asked.code in (0x05, 0x06, 0x16) and "address" in asked.fields:
        return 1
    return quantity


def _values(pdu: Pdu) -> list[int] | None:
    """The registers or bits that a PDU carries."""
    values = pdu.numbers("values")
    if values is None:
        values = pdu.numbers("fifo")
        values = values[1:] if values is not None else None
    if values is not None:
        return list(values)
    value = pdu.number("value")
    if value is not None:
        if pdu.function == 0x05:
            return [COIL_VALUES[value]] if value in COIL_VALUES else None
        return [value]
    for names in (("and_mask", "or_mask"), ("status", "event_count"), ("status",)):
        numbers = [pdu.number(name) for name in names]
        if None not in numbers:
            return [number for number in numbers if number is not None]
    return None


def _response_values(asked: Pdu, answered: Pdu) -> list[int] | None:
    """What a response tells; an echo tells nothing that the request did not."""
    if asked.code in (0x05, 0x06, 0x16):
        return None
    values = _values(answered)
    quantity = asked.number("quantity")
    if values is not None and quantity is not None and asked.code in (0x01, 0x02):
        return values[:quantity]  # The rest of the last byte is padding.
    return values
