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
