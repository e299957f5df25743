from __future__ import annotations

import json

import msgspec
import pytest

from mbtool.devices.named_transaction import NamedTransaction, PointValue
from mbtool.devices.naming import Namer
from mbtool.modbus.transaction import Outcome
from tests.devices.transactions import transaction


def test_absent_fields_are_not_in_a_record() -> None:
    named = Namer().name(transaction(7))
    keys = json.loads(msgspec.json.encode(named))
    assert not {"device", "reference", "points", "findings", "address"} & keys.keys()


def test_a_record_survives_json() -> None:
    named = NamedTransaction(
        **msgspec.structs.asdict(transaction(3, 0, quantity=1, response_values=[5])),
        device="pump",
        reference="holding 0",
        points=[PointValue(name="Speed", reference="holding 0", value=5, text="5 rpm", unit="rpm")],
        findings=["PUMP-Q3"],
    )
    assert msgspec.json.decode(msgspec.json.encode(named), type=NamedTransaction) == named


@pytest.mark.parametrize(
    ("outcome", "took_effect"),
    [(Outcome.OK, True), (Outcome.BROADCAST, True), (Outcome.EXCEPTION, False),
     (Outcome.NO_ANSWER, False), (Outcome.MALFORMED, False)],
)  # fmt: skip
def test_refused_request_took_no_effect(outcome: Outcome, took_effect: bool) -> None:
    assert Namer().name(transaction(6, 0, outcome=outcome)).took_effect is took_effect
