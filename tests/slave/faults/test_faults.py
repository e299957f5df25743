from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices import Span, load_profile
from mbtool.modbus import Response, Table
from mbtool.modbus.response import ConnectionEnding, Distortion
from mbtool.slave.device import DeviceResponder, RegisterImage
from mbtool.slave.families import make_device
from mbtool.slave.faults.faults import Fault, FaultCondition, FaultKind, FaultySlave

MS = 1_000_000
READ = bytes.fromhex("03 0000 0002")
VALUES = bytes.fromhex("03 04 0007 0008")
WRITE = bytes.fromhex("06 0000 0009")
COILS = bytes.fromhex("01 0000 0003")


def _device() -> DeviceResponder:
    profile = load_profile("idec-ft1a-touch")
    image = RegisterImage.of(profile)
    image.set(Table.HOLDING_REGISTERS, 0, [7, 8])
    image.set(Table.COILS, 0, [1, 0, 1])
    return make_device(profile, image)


def _slave(*faults: Fault, seed: int = 0) -> FaultySlave:
    return FaultySlave(_device(), faults, seed=seed)


def _pdu(answer: Response | None) -> bytes:
    assert answer is not None
    return answer.pdu


def _which(fault: Fault, requests: int = 12, seed: int = 0) -> list[int]:
    """Which of some equal requests, the first being 1, an exception is given for."""
    slave = _slave(replace(fault, kind=FaultKind.EXCEPTION), seed=seed)
    return [
        number
        for number in range(1, requests + 1)
        if _pdu(slave.respond(1, READ, number * 10 * MS))[0] == 0x83
    ]


def test_without_a_fault_the_slave_answers_as_it_does() -> None:
    assert _slave().respond(1, READ, 0) == Response(VALUES)


@pytest.mark.parametrize(
    ("match", "which"),
    [
        (FaultCondition(times=2), [1, 2]),
        (FaultCondition(nth=3), list(range(3, 13))),
        (FaultCondition(nth=3, times=1), [3]),
        (FaultCondition(nth=2, every=4), [2, 6, 10]),
        (
            FaultCondition(from_ns=30 * MS, until_ns=60 * MS),
            [4, 5, 6],
        ),  # The slave began at the first.
        (FaultCondition(units=frozenset({2})), []),
        (FaultCondition(functions=frozenset({6})), []),
        (FaultCondition(functions=frozenset({3, 6}), units=frozenset({1}), times=1), [1]),
        (FaultCondition(span=Span(Table.HOLDING_REGISTERS, 1, 5), times=1), [1]),
        (FaultCondition(span=Span(Table.HOLDING_REGISTERS, 2, 5)), []),
        (FaultCondition(span=Span(Table.INPUT_REGISTERS, 0, 5)), []),
        (FaultCondition(probability=0.0), []),
    ],
)
def test_a_fault_is_for_the_requests_that_fit(match: FaultCondition, which: list[int]) -> None:
    assert _which(Fault(kind=FaultKind.EXCEPTION, match=match)) == which


@given(st.integers(0, 2**32))
def test_chances_are_the_same_for_the_same_seed(seed: int) -> None:
    fault = Fault(kind=FaultKind.EXCEPTION, match=FaultCondition(probability=0.5))
    assert _which(fault, seed=seed) == _which(fault, seed=seed)


def test_chances_are_as_great_as_they_should_be() -> None:
    fault = Fault(kind=FaultKind.EXCEPTION, match=FaultCondition(probability=0.25))
    assert 200 < len(_which(fault, requests=1000)) < 300


def test_another_fault_does_not_change_a_faults_chances() -> None:
    chance = FaultCondition(probability=0.5)
    exception = Fault(kind=FaultKind.EXCEPTION, match=chance)
    delays = Fault(kind=FaultKind.DELAY, match=chance, delay_ns=1)
    alone, beside = _slave(exception), _slave(exception, delays)
    for number in range(50):
        one, other = (slave.respond(1, READ, number) for slave in (alone, beside))
        assert _pdu(one) == _pdu(other)


def test_a_delay_comes_on_top() -> None:
    slow = FaultySlave(
        _slave(Fault(kind=FaultKind.DELAY, delay_ns=5)), [Fault(kind=FaultKind.DELAY, delay_ns=7)]
    )
    assert slow.respond(1, READ, 0) == Response(VALUES, 12)


def test_an_exception_has_its_code_and_the_write_is_done() -> None:
    slave = _slave(Fault(kind=FaultKind.EXCEPTION, code=6, match=FaultCondition(times=1)))
    assert _pdu(slave.respond(1, WRITE, 0)) == bytes.fromhex("86 06")
    assert _pdu(slave.respond(1, READ, 0)) == bytes.fromhex("03 04 0009 0008")


@pytest.mark.parametrize(
    ("fault", "spoiling"),
    [
        (Fault(kind=FaultKind.NO_ANSWER), Distortion(silent=True)),
        (Fault(kind=FaultKind.WRONG_UNIT, by=2), Distortion(unit_by=2)),
        (Fault(kind=FaultKind.WRONG_ID), Distortion(id_by=1)),
        (Fault(kind=FaultKind.TRUNCATED, count=3), Distortion(cut=3)),
        (Fault(kind=FaultKind.BAD_CRC), Distortion(wrong_check=True)),
        (Fault(kind=FaultKind.EXTRA_BYTES, extra=b"\0"), Distortion(extra=b"\0")),
        (Fault(kind=FaultKind.SPLIT, count=2, delay_ns=9), Distortion(pieces=2, gap_ns=9)),
        (Fault(kind=FaultKind.CLOSE), Distortion(ending=ConnectionEnding.CLOSE)),
        (Fault(kind=FaultKind.RESET), Distortion(ending=ConnectionEnding.RESET)),
    ],
)
def test_an_answer_is_spoilt_on_its_way(fault: Fault, spoiling: Distortion) -> None:
    assert _slave(fault).respond(1, READ, 0) == Response(VALUES, distortion=spoiling)


def test_faults_add_up() -> None:
    answer = _slave(Fault(kind=FaultKind.NO_ANSWER), Fault(kind=FaultKind.RESET)).respond(
        1, READ, 0
    )
    assert answer == Response(
        VALUES, distortion=Distortion(silent=True, ending=ConnectionEnding.RESET)
    )


class _Silent:
    def respond(self, unit: int, pdu: bytes, now_ns: int) -> None:
        return None


def test_a_connection_also_ends_where_the_slave_says_nothing() -> None:
    closing = FaultySlave(_Silent(), [Fault(kind=FaultKind.CLOSE)])
    assert closing.respond(1, READ, 0) == Response(
        b"", distortion=Distortion(silent=True, ending=ConnectionEnding.CLOSE)
    )
    assert FaultySlave(_Silent(), [Fault(kind=FaultKind.DELAY)]).respond(1, READ, 0) is None


def test_stuck_registers_stay_what_they_were_first() -> None:
    slave = _slave(
        Fault(kind=FaultKind.STUCK, match=FaultCondition(span=Span(Table.HOLDING_REGISTERS, 0, 0)))
    )
    assert _pdu(slave.respond(1, READ, 0)) == VALUES
    slave.respond(1, bytes.fromhex("10 0000 0002 04 0063 0064"), 0)
    assert _pdu(slave.respond(1, READ, 0)) == bytes.fromhex("03 04 0007 0064")


def test_an_offset_is_added_to_registers_and_wraps() -> None:
    slave = _slave(Fault(kind=FaultKind.OFFSET, by=-8))
    assert _pdu(slave.respond(1, READ, 0)) == bytes.fromhex("03 04 FFFF 0000")


def test_an_offset_turns_bits_over() -> None:
    assert _pdu(_slave(Fault(kind=FaultKind.OFFSET)).respond(1, COILS, 0)) == bytes.fromhex(
        "01 01 02"
    )


def test_values_of_writes_and_exceptions_stay() -> None:
    slave = _slave(Fault(kind=FaultKind.OFFSET))
    assert _pdu(slave.respond(1, WRITE, 0)) == WRITE
    assert _pdu(slave.respond(1, bytes.fromhex("03 9000 0001"), 0)) == bytes.fromhex("83 02")


@given(st.binary(max_size=253), st.sampled_from(FaultKind))
def test_no_request_raises(pdu: bytes, kind: FaultKind) -> None:
    answer = _slave(Fault(kind=kind, extra=b"\0")).respond(1, pdu, 0)
    assert answer is None or len(answer.pdu) <= 253
