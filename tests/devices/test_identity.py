"""What a device says about itself, as values."""

from __future__ import annotations

from mbtool.devices import PointValue
from mbtool.devices.identity import identity_points
from mbtool.modbus import rtu_adu
from tests.devices.transactions import transaction


def test_an_object_is_referred_to_by_its_id() -> None:
    pdu = bytes.fromhex("2b 0e 01 01 00 00 01 00 05") + b"Maker"
    assert identity_points(transaction(0x2B, response_raw=rtu_adu(1, pdu))) == [
        PointValue(name="vendor", reference="object 00H", text="Maker")
    ]


def test_a_server_id_is_referred_to_by_its_function() -> None:
    points = identity_points(transaction(0x11, response_raw=rtu_adu(1, b"\x11\x02\x1a\xff")))
    assert [(one.name, one.reference, one.text) for one in points] == [
        ("server id", "11H", "1a"),
        ("run indicator", "11H", "on"),
    ]


def test_other_answers_give_no_values() -> None:
    assert identity_points(transaction(3, 0, response_raw=rtu_adu(1, b"\x03\x02\x00\x01"))) == []
