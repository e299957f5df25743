"""The record of a transaction, as JSON."""

from __future__ import annotations

import msgspec

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
