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


def test_what_does_not_apply_is_absent_in_json() -> None:
    assert msgspec.json.decode(msgspec.json.encode(VALUE)) == {
        "kind": "value",
        "unit": 5,
        "reference": "HR400001",
        "what": "read",
        "a": {"text": "1", "values": [1]},
        "b": {"text": "2", "values": [2]},
    }


def test_json_gives_it_back() -> None:
    assert msgspec.json.decode(msgspec.json.encode(VALUE), type=Difference) == VALUE
