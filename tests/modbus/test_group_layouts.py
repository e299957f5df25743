"""File records and the objects of an identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction
from mbtool.modbus.pdu import encode_pdu, parse_pdu, pdu_length

if TYPE_CHECKING:
    from mbtool.modbus.layouts import Value

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@pytest.mark.parametrize(
    ("pdu", "direction", "groups", "problem"),
    [
        ("14 00", REQUEST, (), None),
        ("14 07 06 0004 0001 0002", REQUEST, ((4, 1, 2),), None),
        ("14 07 05 0004 0001 0002", REQUEST, ((4, 1, 2),), "reference type 5"),
        ("14 08 06 0004 0001 0002 06", REQUEST, ((4, 1, 2),), "does not end with a group"),
        ("15 09 06 0004 0007 0001 06AF", REQUEST, ((4, 7, (0x06AF,)),), None),
        ("15 09 06 0004 0007 0002 06AF", REQUEST, ((4, 7, (0x06AF,)),), "not end with a group"),
        ("14 06 05 06 0DFE 0020", RESPONSE, ((((0x0DFE, 0x0020)),),), None),
        ("14 06 05 07 0DFE 0020", RESPONSE, ((((0x0DFE, 0x0020)),),), "reference type 7"),
        ("14 05 04 06 0DFE 00", RESPONSE, (((0x0DFE,),),), "an odd number of bytes"),
        ("14 02 05 06", RESPONSE, (((),),), "does not end with a group"),
        ("14 02 00 00", RESPONSE, (), "does not end with a group"),
        ("14 05 03 06 0DFE 03", RESPONSE, (((0x0DFE,),),), "does not end with a group"),
    ],
)
def test_file_groups_are_kept_and_their_faults_named(
    pdu: str, direction: Direction, groups: Value, problem: str | None
) -> None:
    parsed = parse_pdu(bytes.fromhex(pdu), direction)
    assert parsed.fields["groups"] == groups
    if problem is None:
        assert parsed.problem is None
    else:
        assert problem in str(parsed.problem)


@pytest.mark.parametrize(
    ("objects", "held", "problem"),
    [
        ("00", (), None),
        ("01 00 02 4142", ((0, b"AB"),), None),
        ("01 00", (), "its objects do not fill it"),
        ("01 00 00", ((0, b""),), None),
        ("01 00 02 41", (), "its objects do not fill it"),
        ("02 00 02 4142", ((0, b"AB"),), "its objects do not fill it"),
        ("01 00 02 4142 00", ((0, b"AB"),), "its objects do not fill it"),
        ("", (), "its objects do not fill it"),
    ],
)
def test_objects_are_kept_and_their_faults_named(
    objects: str, held: Value, problem: str | None
) -> None:
    parsed = parse_pdu(bytes.fromhex("2B 0E 01 01 00 00" + objects), RESPONSE)
    assert parsed.fields["objects"] == held
    assert parsed.problem == problem


def test_length_of_an_identification_is_known_with_its_last_length_byte() -> None:
    pdu = bytes.fromhex(
        "2B 0E 01 01 00 00"  # read device identification, basic, nothing more
        "02"                 # two objects
        "00 03 414243"       # the first
        "01 02 5859"         # the second
    )  # fmt: skip
    assert [pdu_length(pdu[:size], RESPONSE) for size in (6, 7, 8, 9, 13)] == [None] * 5
    assert pdu_length(pdu[:14], RESPONSE) == len(pdu)


@pytest.mark.parametrize(
    ("code", "direction", "fields"),
    [
        (0x14, REQUEST, {"groups": ((1, 2, 70000),)}),
        (0x14, REQUEST, {"groups": ((1, 2),)}),
        (0x14, REQUEST, {"groups": ((1, 2, (3,)),)}),
        (0x15, REQUEST, {"groups": ((1, 2, 3),)}),
        (0x15, REQUEST, {"groups": ((1, b"2", (3,)),)}),
        (0x15, REQUEST, {"groups": ((1, 2, (0,) * 200),)}),
        (0x14, RESPONSE, {"groups": ((1, 2),)}),
        (0x14, RESPONSE, {"groups": (((0,) * 130,),)}),
        (0x14, RESPONSE, {"groups": 5}),
        (0x14, RESPONSE, {}),
    ],
)
def test_groups_that_cannot_be_sent_are_refused(
    code: int, direction: Direction, fields: dict[str, Value]
) -> None:
    with pytest.raises(ValueError, match=r"group|registers|byte count"):
        encode_pdu(code, direction, **fields)


@pytest.mark.parametrize("objects", [((0, 5),), ((0, b"x" * 256),), ((256, b""),), 5])
def test_objects_that_cannot_be_sent_are_refused(objects: Value) -> None:
    with pytest.raises(ValueError, match=r"object|byte count|256"):
        encode_pdu(
            0x2B, RESPONSE, mei_type=0x0E, read_code=1, conformity=1, more_follows=0,
            next_object_id=0, objects=objects,
        )  # fmt: skip
