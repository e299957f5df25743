"""Transactions for tests of naming, made from bytes without the pairing under test elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.modbus.adu import DirectionBy, Transport
from mbtool.modbus.functions import function_name
from mbtool.modbus.transaction import Outcome, Transaction

if TYPE_CHECKING:
    from tests.cases.worked_examples import WorkedExample


def transaction(function: int, address: int | None = None, **fields: Any) -> Transaction:
    """A transaction that went well, with only the fields that a test speaks of."""
    defaults: dict[str, Any] = {
        "link": "line",
        "transport": Transport.RTU,
        "unit": 1,
        "function_name": f"function {function:02X}H",
        "outcome": Outcome.OK,
        "retries": 0,
        "direction_by": DirectionBy.PORT,
        "confidence": 1.0,
    }
    return Transaction(**{**defaults, "function": function, "address": address, **fields})


def transaction_of(example: WorkedExample) -> Transaction:
    """A worked example as a transaction, its bytes read by hand."""
    request, response = example.request_pdu, example.response_pdu
    function = (request or response)[0] & 0x7F
    transport = Transport.RTU if example.transport == "pdu" else Transport(example.transport)
    fields: dict[str, Any] = {"unit": example.unit, "transport": transport}
    fields["function_name"] = function_name(function)
    if request and function in (1, 2, 3, 4, 5, 6, 15, 16, 22, 23):
        fields["address"] = _words(request[1:3])[0]
        fields["quantity"] = 1 if function in (5, 6, 22) else _words(request[3:5])[0]
        fields["write_address"] = _words(request[5:7])[0] if function == 23 else None
        fields["request_values"] = _written(function, request) if example.well_formed else None
    if response and response[0] & 0x80:
        fields |= {"exception": response[1], "outcome": Outcome.EXCEPTION}
    elif not response:
        is_line = transport in (Transport.RTU, Transport.ASCII)
        fields["outcome"] = Outcome.BROADCAST if is_line and not example.unit else Outcome.NO_ANSWER
    elif function in (1, 2):
        fields["response_values"] = _bits(response[2:])[: fields["quantity"]]
    elif function == 11:
        fields["response_values"] = _words(response[1:])
    elif function in (3, 4, 23):
        fields["response_values"] = _words(response[2:])
    if example.transport != "pdu":
        fields["request_raw"] = example.request_bytes or None
        fields["response_raw"] = example.response_bytes or None
    return transaction(function, **{"address": None, **fields})


def _written(function: int, request: bytes) -> list[int] | None:
    match function:
        case 5:
            return [int(request[3:5] == b"\xff\x00")]
        case 6:
            return _words(request[3:5])
        case 15:
            return _bits(request[6:])[: _words(request[3:5])[0]]
        case 16:
            return _words(request[6:])
        case 23:
            return _words(request[10:])
        case 22:
            return _words(request[3:])
    return None


def _words(data: bytes) -> list[int]:
    return [data[i] << 8 | data[i + 1] for i in range(0, len(data), 2)]


def _bits(data: bytes) -> list[int]:
    return [byte >> bit & 1 for byte in data for bit in range(8)]
