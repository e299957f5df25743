"""The manuals' worked messages: read, written, and put into the manuals' words."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.devices import (
    Assignments,
    NamedTransaction,
    Namer,
    builtin_profiles,
    describe,
    load_profile,
)
from mbtool.devices.assignment import Assignment, Who
from mbtool.modbus import Transport, ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.pdu import Pdu, encode_pdu, parse_pdu
from mbtool.views.cells import finding_texts, function_text, result_text, what_text
from tests.cases.worked_examples import WorkedExample, worked_examples
from tests.devices.transactions import transaction_of

_EXAMPLES = worked_examples()
# What is not Modbus by its protocol ID is an event of the link, and never becomes a transaction.
_NAMED = [
    (example, device) for example in _EXAMPLES if not example.foreign for device in example.devices
]


@pytest.mark.parametrize("example", _EXAMPLES, ids=str)
def test_an_example_is_parsed_and_encoded_back_and_its_adus_are_right(
    example: WorkedExample,
) -> None:
    for direction, pdu in (
        (
            Direction.REQUEST,
            example.request_pdu if example.request and example.well_formed else b"",
        ),
        (Direction.RESPONSE, example.response_pdu if example.response else b""),
    ):
        if pdu:
            parsed = parse_pdu(pdu, direction)
            assert parsed.problem is None
            assert _encode(parsed, direction) == pdu
    if example.transport == "pdu" or example.foreign:
        return
    for adu, pdu in (
        (example.request_bytes, example.request_pdu),
        (example.response_bytes, example.response_pdu),
    ):
        match Transport(example.transport):
            case _ if not adu:
                continue
            case Transport.RTU:
                assert rtu_adu(example.unit, pdu) == adu
            case Transport.ASCII:
                assert ascii_adu(example.unit, pdu) == adu
            case _:
                assert mbap_adu(0, example.unit, pdu) == adu


def test_request_with_a_wrong_byte_count_is_read_whole() -> None:
    (wrong,) = [each for each in _EXAMPLES if not each.well_formed]
    parsed = parse_pdu(wrong.request_pdu, Direction.REQUEST)
    assert parsed.number("quantity") == 1
    assert parsed.numbers() == (600, 10)


@pytest.mark.parametrize(("example", "device"), _NAMED, ids=str)
def test_example_and_its_row_read_like_the_manual(example: WorkedExample, device: str) -> None:
    named = _name(example, device)
    assert named.device == device
    assert named.reference == example.reference
    assert [f"{point.reference} | {point.name} | {point.text}" for point in named.points] == (
        example.points or []
    )
    assert named.findings == (example.findings or [])
    assert describe(named) == (example.says or example.reference or "")
    if example.function_name is not None:
        assert named.function_name == example.function_name
    profile = load_profile(device)
    what = "  ! ".join((what_text(named), *finding_texts(named, profile))).strip()
    assert [function_text(named), what, result_text(named)] == example.row


def test_every_built_in_profile_has_an_example() -> None:
    assert {device for _, device in _NAMED} == set(builtin_profiles())


def _name(example: WorkedExample, device: str) -> NamedTransaction:
    namer = Namer(Assignments([Assignment(Who(), load_profile(device))]))
    return namer.name(transaction_of(example))


def _encode(parsed: Pdu, direction: Direction) -> bytes:
    return encode_pdu(parsed.code, direction, **parsed.fields)
