from __future__ import annotations

import msgspec

from mbtool.devices.difference import Difference, DifferenceKind, Side

VALUE = Difference(
    kind=DifferenceKind.VALUE,
    unit=5,
    what="read",
    reference="HR400001",
    a=Side(text="1", values=[1]),
    b=Side(text="2", values=[2]),
)


def test_absent_fields_are_not_in_the_json() -> None:
    assert msgspec.json.decode(msgspec.json.encode(VALUE)) == {
        "kind": "value",
        "unit": 5,
        "reference": "HR400001",
        "what": "read",
        "a": {"text": "1", "values": [1]},
        "b": {"text": "2", "values": [2]},
    }


def test_a_difference_survives_json() -> None:
    assert msgspec.json.decode(msgspec.json.encode(VALUE), type=Difference) == VALUE
