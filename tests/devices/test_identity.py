"""What a device says about itself, as values."""

from __future__ import annotations

from mbtool.devices.identity import answer_word, identity_points
from mbtool.devices.named_transaction import PointValue
from mbtool.modbus import rtu_adu
from mbtool.modbus.transaction import Outcome
from tests.devices.transactions import transaction


def test_an_object_has_its_id_as_reference() -> None:
    pdu = bytes.fromhex("2b 0e 01 01 00 00 01 00 05") + b"Maker"
    assert identity_points(transaction(0x2B, response_raw=rtu_adu(1, pdu))) == [
        PointValue(name="vendor", reference="object 00H", text="Maker")
    ]


def test_a_server_id_has_its_function_as_reference() -> None:
    points = identity_points(transaction(0x11, response_raw=rtu_adu(1, b"\x11\x02\x1a\xff")))
    assert [(one.name, one.reference, one.text) for one in points] == [
        ("server id", "11H", "1a"),
        ("run indicator", "11H", "on"),
    ]


def test_other_answers_give_no_values() -> None:
    assert identity_points(transaction(3, 0, response_raw=rtu_adu(1, b"\x03\x02\x00\x01"))) == []


def test_a_response_of_one_word_gives_the_word() -> None:
    assert answer_word(transaction(0x42, response_raw=rtu_adu(1, b"\x42\x00\x16"))) == 0x16


def test_other_responses_give_no_word() -> None:
    raw = rtu_adu(1, b"\x42\x00\x16")
    assert answer_word(transaction(0x42, response_raw=rtu_adu(1, b"\x42\x00\x16\x00"))) is None
    assert answer_word(transaction(0x42, outcome=Outcome.NO_ANSWER)) is None
    assert answer_word(transaction(0x42, response_raw=raw, exception=1)) is None
    assert answer_word(transaction(0x42, response_raw=raw[:2])) is None
