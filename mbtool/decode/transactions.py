"""Builds the record of a transaction from its request and its response."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgspec

from mbtool.core import Direction, LinkAddresses, Origin
from mbtool.framing.mbap import PARTS_NS
from mbtool.modbus.adu import MAX_PDU, Adu, Transport, Verdict
from mbtool.modbus.expected_response import mismatch
from mbtool.modbus.functions import (
    READ_BITS,
    READ_REGISTERS,
    WRITE_ONE,
    exception_name,
    function_name,
)
from mbtool.modbus.layouts import COIL_VALUES, words
from mbtool.modbus.pdu import Pdu, parse_pdu
from mbtool.modbus.transaction import Outcome, Transaction

SURE = 0.8
"""A transaction is called ambiguous if its confidence (0.5 to 1) is less than this."""
MAX_CACHED_REQUESTS = 256
"""The number of parsed requests kept; beyond that the least recently used one is dropped."""


@dataclass(frozen=True, slots=True)
class Ends:
    """The link of a transaction, and on a network the two ends of its connection.

    An end is a host and port as text; None on a serial line.
    """

    link: str
    master: str | None = None
    slave: str | None = None
    timed: bool = True
    """False if the bytes of the link have no known times; its transactions then have no latency."""


def with_response(
    ends: Ends,
    request: Adu,
    response: Adu,
    retries: int,
    verdicts: tuple[Verdict, ...],
    confidence: float = 1.0,
) -> Transaction:
    """Make the transaction of a request and its response.

    `verdicts` and `confidence` (0 to 1) tell how surely the two belong together; the transaction
    also gets the verdicts of both ADUs, and the lowest of the three confidences. `retries` is the
    number of unanswered requests before `request` with the same unit and PDU.
    """
    noticed = [*request.verdicts, *response.verdicts, *verdicts]
    if Verdict.SPLIT in request.verdicts and Verdict.SPLIT not in response.verdicts:
        noticed.append(Verdict.ONLY_REQUEST_SPLIT)
    if request.missing or response.missing:
        return _truncated_transaction(ends, request, response, noticed, confidence)
    facts, pdu = _request_facts(request.pdu), response.pdu
    exception, outcome = None, Outcome.OK
    values: list[int] | None
    if facts.head and len(pdu) == 2 + facts.head[1] and pdu.startswith(facts.head):
        values = [*words(pdu[2:])]  # The usual case is tested first, since it is quick.
    else:
        exception, outcome, values = _read_response(facts, pdu, noticed)
    return _record(
        ends,
        request,
        response,
        facts,
        exception,
        outcome=outcome,
        request_values=None if facts.values is None else list(facts.values),
        response_values=values,
        request_ns=request.end_ns,
        response_ns=response.end_ns,
        latency_ns=_latency_ns(request, response) if ends.timed else None,
        retries=retries,
        request_raw=request.raw,
        response_raw=response.raw,
        verdicts=list(dict.fromkeys(noticed)) if noticed else noticed,
        confidence=min(request.confidence, response.confidence, confidence),
        pair_confidence=confidence if confidence < 1.0 else None,
    )


def _read_response(
    facts: _RequestFacts, pdu: bytes, noticed: list[Verdict]
) -> tuple[int | None, Outcome, list[int] | None]:
    """Parse the PDU of a response; return its exception code, the outcome, and the values.

    Adds to `noticed` if the request or the response is malformed.
    """
    response = parse_pdu(pdu, Direction.RESPONSE)
    if facts.is_malformed:
        noticed.append(Verdict.MALFORMED_REQUEST)
    malformed = response.problem or (not facts.is_malformed and mismatch(facts.pdu, response))
    if malformed:
        noticed.append(Verdict.MALFORMED_RESPONSE)
    exception = response.exception_code
    if exception is not None:
        outcome = Outcome.EXCEPTION
    else:
        outcome = Outcome.MALFORMED if malformed else Outcome.OK
    return exception, outcome, _response_values(facts.pdu, response)


def _truncated_transaction(
    ends: Ends, request: Adu, response: Adu, verdicts: list[Verdict], confidence: float
) -> Transaction:
    """Make the transaction of a request and its response, of which one was not captured whole."""
    facts = _facts(request)
    whole = None if response.missing else parse_pdu(response.pdu, Direction.RESPONSE)
    return _record(
        ends,
        request,
        response,
        facts,
        whole.exception_code if whole is not None else None,
        outcome=Outcome.NOT_CAPTURED,
        request_values=_value_list(facts.values),
        response_values=_response_values(facts.pdu, whole) if whole is not None else None,
        request_ns=request.end_ns,
        response_ns=response.end_ns,
        latency_ns=_latency_ns(request, response) if ends.timed else None,
        retries=0,
        request_raw=request.raw,
        response_raw=response.raw,
        verdicts=list(dict.fromkeys(verdicts)),
        confidence=min(request.confidence, response.confidence, confidence),
        pair_confidence=confidence if confidence < 1.0 else None,
    )


def _latency_ns(request: Adu, response: Adu) -> int | None:
    """Return the nanoseconds from the end of the request to the start of the response.

    0 if the response seems to start before the request ends, as when an adapter merges the two in
    one read. None if the response seems to end before the request ends: the capture's clock was set
    back.
    """
    if response.end_ns < request.end_ns:
        return None
    return max(response.start_ns - request.end_ns, 0)


def late(answered: Transaction) -> Transaction:
    """Return the transaction of a response that came after the master had given the request up."""
    if answered.outcome not in (Outcome.OK, Outcome.EXCEPTION):
        return answered
    return msgspec.structs.replace(answered, outcome=Outcome.LATE)


def no_answer(ends: Ends, request: Adu, retries: int, confidence: float = 1.0) -> Transaction:
    """Make the transaction of a request without a response.

    `retries` is the number of unanswered requests before it with the same unit and PDU.
    `confidence` (0 to 1) tells how surely the capture has no response to it.
    """
    return with_pair_confidence(_alone(ends, request, Outcome.NO_ANSWER, retries), confidence)


def with_pair_confidence(transaction: Transaction, confidence: float) -> Transaction:
    """Return the transaction with a pair confidence; it is ambiguous if that is below SURE."""
    if confidence >= 1.0:
        return transaction
    verdicts = [*transaction.verdicts, *([Verdict.AMBIGUOUS] if confidence < SURE else ())]
    return msgspec.structs.replace(
        transaction,
        verdicts=list(dict.fromkeys(verdicts)),
        confidence=min(transaction.confidence, confidence),
        pair_confidence=confidence,
    )


def response_not_captured(
    ends: Ends, request: Adu, verdicts: tuple[Verdict, ...] = ()
) -> Transaction:
    """Make the transaction of a request whose response the capture lacks."""
    return _alone(ends, request, Outcome.NOT_CAPTURED, 0, verdicts)


def capture_ended(ends: Ends, request: Adu) -> Transaction:
    """Make the transaction of a request whose response may have come after the capture's end."""
    return response_not_captured(ends, request, (Verdict.CAPTURE_END,))


def broadcast(ends: Ends, request: Adu) -> Transaction:
    """Make the transaction of a request to all units; none answers it (Serial Line V1.02, 2.1)."""
    return _alone(ends, request, Outcome.BROADCAST, 0)


def unsolicited(ends: Ends, response: Adu, outcome: Outcome = Outcome.UNSOLICITED) -> Transaction:
    """Make the transaction of a response whose request is unknown.

    `outcome` is NOT_CAPTURED if there was a request that the capture lacks.
    """
    pdu = parse_pdu(response.pdu, Direction.RESPONSE)
    if response.missing:
        pdu = Pdu(pdu.code, {}, None)
        outcome = Outcome.NOT_CAPTURED
    malformed = [Verdict.MALFORMED_RESPONSE] if pdu.problem else []
    return _record(
        ends,
        None,
        response,
        _RequestFacts.of(Pdu(pdu.function, pdu.fields, None)),
        pdu.exception_code,
        outcome=outcome,
        response_values=_value_list(_values(pdu)),
        response_ns=response.end_ns,
        retries=0,
        response_raw=response.raw,
        verdicts=[*response.verdicts, *malformed],
        confidence=response.confidence,
    )


def _alone(
    ends: Ends, request: Adu, outcome: Outcome, retries: int, verdicts: tuple[Verdict, ...] = ()
) -> Transaction:
    facts = _facts(request)
    malformed = [Verdict.MALFORMED_REQUEST] if facts.is_malformed else []
    return _record(
        ends,
        request,
        None,
        facts,
        None,
        outcome=outcome,
        request_values=_value_list(facts.values),
        request_ns=request.end_ns,
        retries=retries,
        request_raw=request.raw,
        verdicts=[*request.verdicts, *malformed, *verdicts],
        confidence=request.confidence,
    )


class _RequestFacts(msgspec.Struct, frozen=True):
    """The fields of a transaction that follow from the request's PDU alone."""

    pdu: Pdu
    is_malformed: bool
    function: int
    function_name: str
    sub_function: int | None
    address: int | None
    quantity: int | None
    """The number of registers or bits; 1 for a write of a single value."""
    write_address: int | None
    write_quantity: int | None
    values: tuple[int, ...] | None
    head: bytes
    """The first bytes of the normal response to a read of registers: function code and byte count.
    Empty for other requests."""

    @classmethod
    def of(cls, pdu: Pdu) -> _RequestFacts:
        sub_function = pdu.number("sub_function")
        quantity = pdu.number("quantity")
        if quantity is None and pdu.code in WRITE_ONE and "address" in pdu.fields:
            quantity = 1
        is_read = pdu.code in READ_REGISTERS and pdu.problem is None
        is_read &= quantity is not None and 2 + 2 * quantity <= MAX_PDU
        return cls(
            pdu=pdu,
            is_malformed=pdu.problem is not None,
            function=pdu.code,
            function_name=function_name(pdu.code),
            sub_function=pdu.number("mei_type") if sub_function is None else sub_function,
            address=pdu.number("address"),
            quantity=quantity,
            write_address=pdu.number("write_address"),
            write_quantity=pdu.number("write_quantity"),
            values=_values(pdu),
            head=bytes((pdu.code, 2 * (quantity or 0))) if is_read else b"",
        )


@lru_cache(maxsize=MAX_CACHED_REQUESTS)
def _request_facts(request: bytes) -> _RequestFacts:
    """Parse the PDU of a request. Results are cached, as masters repeat the same few requests."""
    return _RequestFacts.of(parse_pdu(request, Direction.REQUEST))


def _facts(request: Adu) -> _RequestFacts:
    """Return the fields that follow from a request's PDU.

    If the capture lacks bytes of the request, its values are None.
    """
    facts = _request_facts(request.pdu)
    if not request.missing:
        return facts
    return msgspec.structs.replace(facts, is_malformed=False, values=None)


def _record(
    ends: Ends,
    request: Adu | None,
    response: Adu | None,
    facts: _RequestFacts,
    exception: int | None,
    **fields: Any,
) -> Transaction:
    """Make the record of a transaction that has a request, a response or both.

    `exception` is the exception code of the response, None if it has none; `fields` are further
    fields of Transaction by name.
    """
    adu = request or response
    assert adu is not None
    asked = None if request is None else request.origin
    answered = None if response is None else response.origin
    if asked is not None or answered is not None:
        add_origins(fields, asked, answered)
    if (
        request is not None
        and request.transport is Transport.TCP
        and request.end_ns - request.start_ns > PARTS_NS
    ):
        fields["request_parts_ns"] = request.end_ns - request.start_ns
    return Transaction(
        link=ends.link,
        transport=adu.transport,
        source=ends.master,
        destination=ends.slave,
        unit=adu.unit,
        transaction_id=adu.transaction_id,
        function=facts.function,
        function_name=facts.function_name,
        sub_function=facts.sub_function,
        address=facts.address,
        quantity=facts.quantity,
        write_address=facts.write_address,
        write_quantity=facts.write_quantity,
        exception=exception,
        exception_name=None if exception is None else exception_name(exception),
        direction_by=adu.direction_by,
        **fields,
    )


def add_origins(fields: dict[str, Any], request: Origin | None, response: Origin | None) -> None:
    """Add the origins of the request's and the response's ADU to `fields`, fields of Transaction by
    name.

    These are the files, packets, offsets, MAC addresses and VLAN; an origin is None if unknown.
    """
    addresses: LinkAddresses | None = None
    if request is not None:
        fields["file"] = request.file or None
        fields["request_packet"] = request.packet or None
        fields["request_offset"] = request.offset
        addresses = request.addresses
        if addresses is not None:
            fields["source_mac"] = addresses.source_mac
            fields["destination_mac"] = addresses.destination_mac
            fields["vlan"] = addresses.vlan
    if response is not None:
        if request is None:
            fields["file"] = response.file or None
        elif response.file != request.file:
            fields["response_file"] = response.file or None
        fields["response_packet"] = response.packet or None
        fields["response_offset"] = response.offset
        own = response.addresses
        if own is not None and (addresses is None or addresses.destination_mac is None):
            fields["source_mac"] = own.destination_mac or fields.get("source_mac")
            fields["destination_mac"] = own.source_mac
            fields["vlan"] = own.vlan
        elif (
            own is not None
            and addresses is not None
            and own.source_mac not in (None, addresses.destination_mac)
        ):
            fields["response_mac"] = own.source_mac


def _values(pdu: Pdu) -> tuple[int, ...] | None:
    """Return the registers (0..65535) or bits (0 or 1) that a PDU carries; None if it has none."""
    values = pdu.numbers("values")
    if values is not None:
        return values
    values = pdu.numbers("fifo")
    if values is not None:
        return values[1:]  # The first number is the FIFO count.
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


def _response_values(request: Pdu, response: Pdu) -> list[int] | None:
    """Return the registers or bits that a response brings.

    None if it brings none, or only repeats the values of the request.
    """
    if request.code in WRITE_ONE:
        return None
    values = _values(response)
    if values is not None and request.code in READ_BITS:
        values = values[: request.number("quantity")]  # The rest of the last byte is padding.
    return None if values is None else list(values)


def _value_list(values: tuple[int, ...] | None) -> list[int] | None:
    return None if values is None else list(values)
