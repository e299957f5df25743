"""The record of a transaction, as JSON."""

from __future__ import annotations

import msgspec
import pytest

from mbtool.modbus.adu import DirectionBy, Transport
from mbtool.modbus.transaction import Outcome, Transaction


def test_field_that_does_not_apply_is_absent_in_json() -> None:
    transaction = Transaction(
        link="rs485", transport=Transport.RTU, unit=1, function=7,
        function_name="read exception status", outcome=Outcome.NO_ANSWER, request_ns=5, retries=0,
        direction_by=DirectionBy.FORM, confidence=1.0,
    )  # fmt: skip
    assert msgspec.json.decode(msgspec.json.encode(transaction)) == {
        "link": "rs485", "transport": "rtu", "unit": 1, "function": 7,
        "function_name": "read exception status", "outcome": "no-answer", "request_ns": 5,
        "retries": 0, "direction_by": "form", "confidence": 1.0,
    }  # fmt: skip
    assert transaction.start_ns == 5


def test_written_quantity_is_the_field_or_else_the_number_of_values() -> None:
    """Function 17H has a field for it, which may contradict the byte count behind it."""
    transaction = Transaction(
        link="rs485", transport=Transport.RTU, unit=1, function=0x17,
        function_name="read/write multiple registers", outcome=Outcome.OK, request_ns=5, retries=0,
        direction_by=DirectionBy.FORM, confidence=1.0, write_quantity=0x2112,
        request_values=[1, 2],
    )  # fmt: skip
    assert transaction.written_quantity == 0x2112
    assert msgspec.structs.replace(transaction, write_quantity=None).written_quantity == 2


_JSON = {
    "link": "rs485", "transport": "rtu", "unit": 1, "function": 7,
    "function_name": "read exception status", "outcome": "no-answer", "request_ns": 5,
    "retries": 0, "direction_by": "form", "confidence": 1.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "most"),
    [
        *((name, 0xFF) for name in ("unit", "function", "exception")),
        *((name, 0xFFFF) for name in ("transaction_id", "address", "quantity", "vlan")),
        *((name, 2**63 - 1) for name in ("request_ns", "response_ns", "latency_ns")),
        *((name, None) for name in ("retries", "request_packet", "response_offset")),
    ],
)
def test_a_number_in_json_is_in_its_range(name: str, most: int | None) -> None:
    for number in (0, 1, 2**62 if most is None else most):
        read = msgspec.convert(_JSON | {name: number}, Transaction)
        assert getattr(read, name) == number
    for number in (-1, *(() if most is None else (most + 1,))):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(_JSON | {name: number}, Transaction)


def test_values_in_json_are_registers() -> None:
    read = msgspec.convert(_JSON | {"request_values": [0, 0xFFFF]}, Transaction)
    assert read.request_values == [0, 0xFFFF]
    for number in (-1, 0x10000):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(_JSON | {"response_values": [number]}, Transaction)


def test_a_transaction_starts_with_its_request_or_else_with_its_response() -> None:
    for request_ns, response_ns, start_ns in (
        (0, 7, 0), (5, 7, 5), (None, 7, 7), (None, 0, 0), (None, None, 0),
    ):  # fmt: skip
        times = {"request_ns": request_ns, "response_ns": response_ns}
        assert msgspec.convert(_JSON | times, Transaction).start_ns == start_ns


def test_a_written_quantity_of_0_counts_as_the_field() -> None:
    one = msgspec.convert(_JSON | {"write_quantity": 0, "request_values": [1]}, Transaction)
    assert one.written_quantity == 0
    assert msgspec.convert(_JSON, Transaction).written_quantity == 0
