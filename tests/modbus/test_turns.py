"""Whose turn it is on a bus."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.modbus import DirectionBy, parse_pdu
from mbtool.modbus.turns import DEFAULT_TURN_NS, Judgement, Turns, answers, is_answer_to, mismatch

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
WRITE = bytes.fromhex("06 0001 0003")
READ = bytes.fromhex("03 006B 0003")
ANSWER = bytes.fromhex("03 06 022B 0000 0064")


class Spoken:
    """Turns after some frames, each judged and noted, a millisecond apart."""

    def __init__(self) -> None:
        self.turns = Turns()
        self.now_ns = 0

    def hear(self, unit: int, pdu: bytes, after_ns: int = 1_000_000) -> Judgement:
        self.now_ns += after_ns
        judgement = self.turns.judge(unit, pdu, self.now_ns)
        self.turns.spoke(judgement, unit, pdu, self.now_ns)
        return judgement


def test_answer_to_the_request_that_waits_is_a_response() -> None:
    spoken = Spoken()
    assert spoken.hear(1, READ) == Judgement(REQUEST, DirectionBy.FORM, 1.0)
    assert spoken.hear(1, ANSWER) == Judgement(RESPONSE, DirectionBy.PENDING, 0.99)


def test_form_that_fits_both_is_decided_by_the_turn() -> None:
    spoken = Spoken()
    assert spoken.hear(1, WRITE) == Judgement(REQUEST, DirectionBy.IDLE, 0.9)
    assert spoken.hear(1, WRITE) == Judgement(RESPONSE, DirectionBy.PENDING, 0.99)
    assert spoken.hear(1, WRITE) == Judgement(REQUEST, DirectionBy.IDLE, 0.9)


def test_turn_goes_back_to_the_master_after_a_while() -> None:
    spoken = Spoken()
    spoken.hear(1, WRITE)
    assert spoken.hear(1, WRITE, after_ns=DEFAULT_TURN_NS + 1).direction is REQUEST
    assert spoken.hear(1, WRITE, after_ns=DEFAULT_TURN_NS).direction is RESPONSE


def test_write_that_is_not_the_echo_of_the_one_that_waits_is_a_request() -> None:
    spoken = Spoken()
    spoken.hear(1, WRITE)
    other = bytes.fromhex("06 0002 0003")
    assert spoken.hear(1, other) == Judgement(REQUEST, DirectionBy.IDLE, 0.7)
    assert spoken.hear(1, other).direction is RESPONSE


def test_response_of_another_unit_does_not_end_the_turn() -> None:
    spoken = Spoken()
    spoken.hear(1, WRITE)
    assert spoken.hear(2, ANSWER) == Judgement(RESPONSE, DirectionBy.FORM, 1.0)
    assert spoken.hear(1, WRITE).direction is RESPONSE


def test_wrong_response_of_the_same_unit_ends_the_turn() -> None:
    spoken = Spoken()
    spoken.hear(1, READ)
    assert spoken.hear(1, bytes.fromhex("03 02 022B")).direction is RESPONSE
    assert spoken.turns.order(1, 3, spoken.now_ns)[0] is REQUEST


def test_nobody_answers_a_broadcast() -> None:
    spoken = Spoken()
    spoken.hear(0, WRITE)
    assert spoken.hear(0, WRITE).direction is REQUEST


def test_longer_echo_of_diagnostics_is_a_response() -> None:
    spoken = Spoken()
    loopback = bytes.fromhex("08 0000 A537 0001 0002")
    assert spoken.hear(1, loopback).direction is REQUEST
    assert spoken.hear(1, loopback).direction is RESPONSE


def test_form_without_a_length_is_judged_by_the_turn() -> None:
    spoken = Spoken()
    assert spoken.hear(1, b"\x2b\x0d\x00") == Judgement(REQUEST, DirectionBy.IDLE, 0.5)
    assert spoken.hear(1, b"\x2b\x0d\x00\x01").direction is RESPONSE


def test_likelier_role_is_tried_first() -> None:
    spoken = Spoken()
    assert spoken.turns.order(1, 3, 0) == (REQUEST, RESPONSE)
    spoken.hear(1, READ)
    assert spoken.turns.order(1, 3, spoken.now_ns) == (RESPONSE, REQUEST)
    assert spoken.turns.order(1, 0x83, spoken.now_ns) == (RESPONSE, REQUEST)
    assert spoken.turns.order(2, 3, spoken.now_ns) == (REQUEST, RESPONSE)
    assert spoken.turns.order(1, 4, spoken.now_ns) == (REQUEST, RESPONSE)


@pytest.mark.parametrize(
    ("request_", "response", "problem"),
    [
        ("03 006B 0003", "03 06 022B 0000 0064", None),
        ("03 006B 0003", "03 04 022B 0000", "2 registers for a quantity of 3"),
        ("01 0000 0011", "01 03 000000", None),
        ("01 0000 0010", "01 03 000000", "3 bytes of bits for a quantity of 16"),
        ("05 0001 FF00", "05 0001 FF00", None),
        ("05 0001 FF00", "05 0002 FF00", "address 2 for 1"),
        ("05 0001 FF00", "05 0001 0000", "value 0 for 65280"),
        ("08 0001 0000", "08 0002 0000", "sub function 2 for 1"),
        ("0F 0000 0008 01 FF", "0F 0000 0009", "quantity 9 for 8"),
        ("10 0001 0001 02 0000", "10 0001 0001", None),
        ("10 0001 0001 02 0000", "10 0002 0001", "address 2 for 1"),
        ("16 0001 00F2 0025", "16 0001 00F3 0025", "and mask 243 for 242"),
        ("16 0001 00F2 0025", "16 0001 00F2 0026", "or mask 38 for 37"),
        ("17 0000 0001 0009 0001 02 0000", "17 02 1234", None),
        (
            "17 0000 0001 0009 0001 02 0000",
            "17 04 1234 0000",
            "2 registers for a quantity of 1",
        ),
        ("2B 0E 01 00", "2B 0D", "mei type 13 for 14"),
        ("07", "07 6D", None),
    ],
)
def test_response_belongs_to_its_request(request_: str, response: str, problem: str | None) -> None:
    asked = parse_pdu(bytes.fromhex(request_), REQUEST)
    answer = bytes.fromhex(response)
    assert mismatch(asked, parse_pdu(answer, RESPONSE)) == problem
    assert is_answer_to(asked, answer) == (problem is None)


@pytest.mark.parametrize(
    ("response", "fits"),
    [("83 02", True), ("83", False), ("83 02 00", False), ("84 02", False), ("", False)],
)
def test_exception_response_belongs_to_a_request_of_its_function(response: str, fits: bool) -> None:
    assert is_answer_to(parse_pdu(READ, REQUEST), bytes.fromhex(response)) is fits


def test_function_code_above_127_is_answered_by_itself_only() -> None:
    assert answers(0x83, 0x83)
    assert not answers(0x83, 0x03)
    assert answers(0x03, 0x83)
