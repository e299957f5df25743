"""Whose turn it is on a bus."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.modbus.adu import DirectionBy
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import (
    SURE,
    BusModel,
    Classification,
    roles_of,
)
from mbtool.serial_line.bus_state import MAX_PENDING_NS
from mbtool.serial_line.line_history import MAX_REQUESTS
from mbtool.serial_line.line_statistics import LatencyStatistics

MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
WRITE = bytes.fromhex("06 0001 0003")
READ = bytes.fromhex("03 006B 0003")
ANSWER = bytes.fromhex("03 06 022B 0000 0064")


class Spoken:
    """Turns after some frames, each judged and noted, a millisecond apart."""

    def __init__(self, *, timed: bool = True) -> None:
        self.bus_model = BusModel(timed=timed)
        self.now_ns = 0

    def hear(self, unit: int, pdu: bytes, after_ns: int = MS) -> Classification:
        self.now_ns += after_ns
        classification = self.bus_model.classify(unit, pdu, self.now_ns)
        self.bus_model.hear(classification, unit, pdu, self.now_ns, self.now_ns)
        return classification

    def learn_latency(self, latency_ns: int = 5 * MS) -> Spoken:
        """A line that polls and is answered."""
        for _ in range(LatencyStatistics.ENOUGH_RESPONSES + 4):
            self.hear(1, READ, 30 * MS)
            self.hear(1, ANSWER, latency_ns)
        return self


def says(classification: Classification) -> tuple[Direction, DirectionBy, bool]:
    """What it says, and whether it is sure."""
    return classification.direction, classification.by, classification.confidence >= SURE


def test_answer_to_the_request_that_waits_is_a_response() -> None:
    spoken = Spoken()
    assert spoken.hear(1, READ) == Classification(REQUEST, DirectionBy.FORM, 1.0)
    assert spoken.hear(1, ANSWER) == Classification(RESPONSE, DirectionBy.PENDING, 1.0)


def test_form_that_fits_both_is_decided_by_the_turn() -> None:
    spoken = Spoken()
    assert says(spoken.hear(1, WRITE)) == (REQUEST, DirectionBy.IDLE, True)
    assert says(spoken.hear(1, WRITE)) == (RESPONSE, DirectionBy.PENDING, True)
    assert says(spoken.hear(1, WRITE)) == (REQUEST, DirectionBy.IDLE, True)


def test_turn_goes_back_to_the_master_after_a_while() -> None:
    spoken = Spoken()
    spoken.hear(1, WRITE)
    assert spoken.hear(1, WRITE, after_ns=MAX_PENDING_NS + 1).direction is REQUEST
    assert spoken.hear(1, WRITE).direction is RESPONSE


def test_request_that_comes_again_too_late_for_an_answer_is_one_by_timing() -> None:
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(1, WRITE)
    assert says(spoken.hear(1, WRITE, after_ns=300 * MS)) == (REQUEST, DirectionBy.TIMING, True)
    assert says(spoken.hear(1, WRITE, after_ns=5 * MS)) == (RESPONSE, DirectionBy.PENDING, True)


def test_slow_line_waits_longer_for_an_answer() -> None:
    spoken = Spoken().learn_latency(300 * MS)
    spoken.hear(1, WRITE)
    assert says(spoken.hear(1, WRITE, 300 * MS)) == (RESPONSE, DirectionBy.PENDING, True)


def test_echoes_teach_the_latency_warily() -> None:
    """Writes take longer than reads in many devices; but one of two may have been a retry."""
    spoken = Spoken()
    for number in range(8 * LatencyStatistics.ENOUGH_RESPONSES):
        spoken.hear(1, bytes((0x03, 0, number % 2, 0, 3)), 50 * MS)
        spoken.hear(1, ANSWER, 5 * MS)
    heard = []
    for value in range(20):
        write = bytes((0x06, 0, 1, 0, value))
        spoken.hear(1, write, 50 * MS)
        heard.append(spoken.hear(1, write, 30 * MS))
    assert {one.direction for one in heard} == {RESPONSE}
    assert [one.confidence >= SURE for one in heard[2:]] == [True] * 18
    spoken.hear(1, WRITE, 50 * MS)
    assert spoken.hear(1, WRITE, 300 * MS).direction is REQUEST


def test_silences_say_nothing_where_times_are_made_up() -> None:
    spoken = Spoken(timed=False)
    for _ in range(LatencyStatistics.ENOUGH_RESPONSES + 4):
        spoken.hear(1, READ)
        spoken.hear(1, ANSWER)
    spoken.hear(1, WRITE)
    assert spoken.hear(1, WRITE, after_ns=300 * MS).direction is RESPONSE


def test_write_that_is_not_the_echo_of_the_one_that_waits_is_a_request() -> None:
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(1, WRITE)
    other = bytes.fromhex("06 0002 0003")
    assert spoken.hear(1, other, 300 * MS).direction is REQUEST
    assert spoken.hear(1, other).direction is RESPONSE


def test_other_write_on_a_line_of_echoes_is_a_request_or_ambiguous() -> None:
    """No echo teaches a latency, and 200 ms are supposed; many masters wait less."""
    spoken = Spoken()
    spoken.hear(1, WRITE)
    classification = spoken.hear(1, bytes.fromhex("06 0002 0003"), 100 * MS)
    assert classification.direction is REQUEST or classification.confidence < SURE


def test_response_of_another_unit_does_not_end_the_turn() -> None:
    spoken = Spoken()
    spoken.hear(1, WRITE)
    assert spoken.hear(2, ANSWER) == Classification(RESPONSE, DirectionBy.FORM, 1.0)
    assert spoken.hear(1, WRITE).direction is RESPONSE


def test_wrong_response_of_the_same_unit_ends_the_turn() -> None:
    spoken = Spoken()
    spoken.hear(1, READ)
    assert spoken.hear(1, bytes.fromhex("03 02 022B")).direction is RESPONSE
    assert spoken.bus_model.state.pending is None


def test_nobody_answers_a_broadcast() -> None:
    spoken = Spoken()
    spoken.hear(0, WRITE)
    assert spoken.bus_model.state.pending is None
    assert spoken.hear(0, WRITE).direction is REQUEST


def test_nobody_answers_force_listen_only() -> None:
    spoken = Spoken()
    listen_only = bytes.fromhex("08 0004 0000")
    spoken.hear(1, listen_only)
    assert spoken.bus_model.state.pending is None
    assert spoken.hear(1, listen_only).direction is REQUEST


def test_longer_echo_of_diagnostics_is_a_response() -> None:
    spoken = Spoken()
    loopback = bytes.fromhex("08 0000 A537 0001 0002")
    assert spoken.hear(1, loopback).direction is REQUEST
    assert spoken.hear(1, loopback).direction is RESPONSE


def test_count_that_diagnostics_tell_is_a_response() -> None:
    """A request for a count has no data; this is one whose request was not heard."""
    spoken = Spoken()
    spoken.hear(1, READ)
    spoken.hear(1, ANSWER)
    assert spoken.hear(1, bytes.fromhex("08 000B 0000")).direction is REQUEST
    assert spoken.hear(1, bytes.fromhex("08 000B 0108")).direction is RESPONSE


def test_form_without_a_length_is_judged_by_the_turn() -> None:
    spoken = Spoken()
    assert spoken.hear(1, b"\x2b\x0d\x00").direction is REQUEST
    assert spoken.hear(1, b"\x2b\x0d\x00\x01").direction is RESPONSE


def test_late_answer_to_a_request_that_was_repeated_is_a_response() -> None:
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(1, WRITE)
    assert spoken.hear(1, WRITE, 300 * MS).direction is REQUEST
    assert spoken.hear(1, WRITE, 3 * MS).direction is RESPONSE
    assert spoken.bus_model.state.overdue is not None
    assert spoken.hear(1, ANSWER, 3 * MS).direction is RESPONSE


def test_late_echo_behind_a_request_to_another_unit_is_a_response() -> None:
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(2, WRITE, 30 * MS)
    spoken.hear(1, READ, 300 * MS)
    assert says(spoken.hear(2, WRITE, 3 * MS)) == (RESPONSE, DirectionBy.PENDING, True)
    assert spoken.hear(1, ANSWER, 3 * MS) == Classification(RESPONSE, DirectionBy.PENDING, 1.0)


def test_second_answer_is_waited_for_from_the_retry_on() -> None:
    """The master has waited for almost as long as a turn lasts."""
    spoken = Spoken().learn_latency(5 * MS)
    asked, answer = b"\x45\x01", b"\x45\x02\x03"
    spoken.hear(1, asked, 30 * MS)
    assert spoken.hear(1, asked, MAX_PENDING_NS - 2 * MS).direction is REQUEST
    assert spoken.hear(1, answer, 5 * MS).direction is RESPONSE
    assert spoken.hear(1, answer, 5 * MS).direction is RESPONSE


def test_master_that_never_asks_twice_makes_a_third_equal_frame_an_answer() -> None:
    """Without times: a request, its repetition and the answer."""
    spoken = Spoken(timed=False)
    for number in range(300):
        spoken.hear(1, bytes((0x03, 0, number % 2, 0, 3)))
        spoken.hear(1, ANSWER)
    bus_model, state, costs = spoken.bus_model, spoken.bus_model.state, []
    for roles in ((REQUEST, REQUEST, RESPONSE), (REQUEST, RESPONSE, REQUEST)):
        supposed, cost = state, 0.0
        for role in roles:
            cost += bus_model.cost(supposed, 1, WRITE, role, 0)
            supposed = bus_model.next_state(supposed, 1, WRITE, role, 0, 0)
        costs.append(cost)
    assert costs[0] + 2 < costs[1]


def test_answer_behind_damage_to_what_is_never_asked_is_less_likely() -> None:
    spoken = Spoken().learn_latency()
    spoken.bus_model.hear_damage()
    at_ns = spoken.now_ns + MS
    polled, odd, unheard = (
        spoken.bus_model.cost(spoken.bus_model.state, 1, bytes.fromhex(pdu), RESPONSE, at_ns)
        for pdu in ("83 02", "83 93", "92 02")
    )
    assert polled < unheard
    assert polled < odd


# Where frames are glued, silences lie at the ends of what was read together.


def glued() -> Spoken:
    """A line whose frames come four at once, 60 ms apart."""
    spoken = Spoken()
    spoken.bus_model.history.trusts_silences = False
    for _ in range(2 * LatencyStatistics.ENOUGH_RESPONSES):
        spoken.hear(1, READ, 60 * MS)
        spoken.hear(1, ANSWER, 0)
        spoken.hear(2, READ, 0)
        spoken.hear(2, ANSWER, 0)
    return spoken


@pytest.mark.parametrize(("pause_ns", "called"), [(60 * MS, RESPONSE), (600 * MS, REQUEST)])
def test_long_silence_among_glued_frames_is_a_missing_answer(
    pause_ns: int, called: Direction
) -> None:
    bus_model = (spoken := glued()).bus_model
    costs = []
    for role in (RESPONSE, REQUEST):
        at_ns = spoken.now_ns + pause_ns
        asked = bus_model.next_state(bus_model.state, 1, WRITE, REQUEST, at_ns, at_ns)
        cost = bus_model.cost(asked, 1, WRITE, role, at_ns)
        costs.append(
            cost + bus_model.silence_cost(bus_model.next_state(asked, 1, WRITE, role, at_ns, at_ns))
        )
    assert (costs[1] < costs[0]) is (called is REQUEST)


def test_silence_of_a_master_that_pauses_is_no_missing_answer() -> None:
    bus_model = (spoken := glued()).bus_model
    for _ in range(8):
        spoken.hear(1, READ, 600 * MS)
        spoken.hear(1, ANSWER, 0)
    assert bus_model.silence_cost(bus_model.state) == 0


def test_silences_are_not_kept_where_they_are_trusted() -> None:
    assert Spoken().learn_latency().bus_model.state.unexplained_silence_ns == 0


def test_echo_of_an_ambiguous_frame_is_ambiguous() -> None:
    spoken = Spoken()
    spoken.hear(1, WRITE)
    doubtful = spoken.hear(1, WRITE, 300 * MS)
    assert doubtful.confidence < SURE
    assert spoken.hear(1, WRITE, 3 * MS).confidence < SURE
    spoken.hear(1, READ)
    assert spoken.hear(1, ANSWER).confidence == 1


def test_request_for_bits_that_comes_again_is_no_answer_to_itself() -> None:
    spoken = Spoken()
    contacts = bytes.fromhex("01 03E8 0011")
    assert spoken.hear(1, contacts).direction is REQUEST
    assert spoken.hear(1, contacts, 300 * MS).direction is REQUEST
    assert spoken.hear(1, bytes.fromhex("01 03 1234 01")).direction is RESPONSE


# Answers as long as a request. Late is what takes longer than any answer before it.

CONTACTS = "01 03E8 0018"
LATE = pytest.mark.parametrize(
    "late_ns", [40 * MS, 600 * MS, MAX_PENDING_NS + MS, 3 * MAX_PENDING_NS]
)


@LATE
@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        pytest.param(CONTACTS, "01 03 000000", id="quantity-0"),
        pytest.param(CONTACTS, "01 03 FF07D1", id="quantity-over-the-limit"),
        pytest.param("02 0014 0018", "02 03 FF0018", id="never-asked"),
        pytest.param("02 03E8 0014", "02 03 010203", id="never-asked-from-the-same-block"),
        pytest.param("02 03E8 0011", "02 03 00FFFE", id="bits-that-nobody-asked-for"),
        pytest.param(
            "17 0003 0005 000E 0001 02 00FF", "17 0A 00FE 0ACD 0001 0002 000D", id="registers"
        ),
        pytest.param("14 07 06 0004 0001 0002", "14 06 05 06 0DFE 0020", id="file"),
        pytest.param("08 000B 0000", "08 000B 0108", id="count"),
    ],
)
def test_answer_that_is_no_likely_request_may_be_late(
    asked: str, answer: str, late_ns: int
) -> None:
    spoken = Spoken().learn_latency(5 * MS)
    assert spoken.hear(1, bytes.fromhex(asked), 30 * MS).direction is REQUEST
    late = spoken.hear(1, bytes.fromhex(answer), late_ns)
    assert says(late) == (RESPONSE, DirectionBy.PENDING, True)


@LATE
@pytest.mark.parametrize(
    ("unit", "pdu"),
    [
        pytest.param(1, "01 0320 0018", id="next-of-the-same-quantity"),
        pytest.param(1, "02 0320 0010", id="other-function"),
        pytest.param(2, "01 0320 0010", id="other-unit"),
        pytest.param(1, "01 0420 0010", id="other-byte-count"),
        pytest.param(1, CONTACTS, id="retry"),
    ],
)
def test_request_behind_one_that_is_not_answered_is_one(unit: int, pdu: str, late_ns: int) -> None:
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(1, bytes.fromhex(CONTACTS), 30 * MS)
    assert spoken.hear(unit, bytes.fromhex(pdu), late_ns).direction is REQUEST


def test_frame_that_is_often_asked_is_judged_by_its_time() -> None:
    """It is what was asked for, and the next request of the master's list as well."""
    asked, other = bytes.fromhex(CONTACTS), bytes.fromhex("01 0320 0010")
    for after_ns, called in ((6 * MS, RESPONSE), (600 * MS, REQUEST)):
        spoken = Spoken().learn_latency(5 * MS)
        for _ in range(3):
            spoken.hear(1, other, 30 * MS)
            spoken.hear(1, bytes.fromhex("01 02 0000"), 5 * MS)
        spoken.hear(1, asked, 30 * MS)
        assert says(spoken.hear(1, other, after_ns))[::2] == (called, True)


@LATE
def test_other_file_behind_one_that_is_not_answered_is_asked_for(late_ns: int) -> None:
    """How long the answer will be does not follow from the request, so less speaks for one."""
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(1, bytes.fromhex("14 07 06 0004 0001 0002"), 30 * MS)
    assert spoken.hear(1, bytes.fromhex("14 07 06 0009 0001 0002"), late_ns).direction is REQUEST


@pytest.mark.parametrize(
    ("asked", "none"), [(CONTACTS, "01 0300 0000"), ("08 000B 0000", "08 000B 0108")]
)
def test_request_that_is_none_stays_an_answer_though_it_was_heard_as_one(
    asked: str, none: str
) -> None:
    """From a tester that asks for what nobody has."""
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(1, READ, 30 * MS)
    pdu = bytes.fromhex(none)
    spoken.bus_model.hear(Classification(REQUEST, DirectionBy.IDLE, 1.0), 1, pdu, 0, spoken.now_ns)
    spoken.hear(1, bytes((pdu[0] | 0x80, 3)), 5 * MS)
    spoken.hear(1, bytes.fromhex(asked), 30 * MS)
    assert says(spoken.hear(1, pdu, 900 * MS)) == (RESPONSE, DirectionBy.PENDING, True)


def test_another_request_ends_the_wait_for_a_late_answer() -> None:
    spoken = Spoken().learn_latency(5 * MS)
    spoken.hear(1, bytes.fromhex(CONTACTS), 30 * MS)
    spoken.hear(1, READ, 600 * MS)
    late = spoken.hear(1, bytes.fromhex("01 0320 0010"), MAX_PENDING_NS + MS)
    assert says(late) == (REQUEST, DirectionBy.IDLE, True)


def test_read_of_bits_that_comes_again_is_no_second_answer_to_itself() -> None:
    spoken = Spoken(timed=False)
    contacts = bytes.fromhex("01 0300 0011")
    heard = [contacts, contacts, bytes.fromhex("01 03 000000"), contacts]
    assert [spoken.hear(1, pdu).direction for pdu in heard] == [
        REQUEST, REQUEST, RESPONSE, REQUEST,
    ]  # fmt: skip


def test_damage_leaves_the_turn_in_doubt() -> None:
    spoken = Spoken()
    spoken.hear(1, READ)
    spoken.bus_model.hear_damage()
    state = spoken.bus_model.state
    assert (state.pending, state.follows_damage) == (None, True)
    assert state.overdue is not None
    assert state.overdue.pdu == READ
    assert spoken.hear(1, ANSWER).direction is RESPONSE
    assert not spoken.bus_model.state.follows_damage


def test_frame_is_expected_that_the_waiting_request_asks_for() -> None:
    spoken = Spoken()
    bus_model = spoken.bus_model
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(ANSWER), RESPONSE)
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(READ), REQUEST)
    spoken.hear(1, READ)
    assert bus_model.expects(bus_model.state, 1, 0x03, len(ANSWER), RESPONSE)
    assert bus_model.expects(bus_model.state, 1, 0x03, 0, RESPONSE)
    assert bus_model.expects(bus_model.state, 1, 0x83, 2, RESPONSE)
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(ANSWER) + 2, RESPONSE)
    assert not bus_model.expects(bus_model.state, 2, 0x03, len(ANSWER), RESPONSE)
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(READ), REQUEST)
    spoken.hear(1, ANSWER)
    assert bus_model.expects(bus_model.state, 1, 0x03, len(READ), REQUEST)


def test_turn_can_be_supposed_without_being_taken() -> None:
    bus_model = BusModel()
    before = bus_model.state
    asked = bus_model.next_state(before, 1, READ, REQUEST, 0, 1)
    assert asked.pending is not None
    assert asked.pending.fits(1, ANSWER)
    assert bus_model.cost(asked, 1, ANSWER, RESPONSE, 2) == costs.RESPONSE
    assert bus_model.next_state(asked, 1, ANSWER, RESPONSE, 2, 3).pending is None
    assert bus_model.state is before


def test_roles_are_those_whose_form_fits() -> None:
    assert roles_of(READ) == (REQUEST,)
    assert roles_of(ANSWER) == (RESPONSE,)
    assert roles_of(WRITE) == (REQUEST, RESPONSE)
    assert roles_of(b"\x41\x00") == (REQUEST, RESPONSE)


def test_what_is_known_of_a_line_is_bounded() -> None:
    bus_model = BusModel()
    for number in range(3 * MAX_REQUESTS):
        pdu = bytes((0x06, *number.to_bytes(2), 0, 0))
        bus_model.hear(Classification(REQUEST, DirectionBy.IDLE, 1.0), 1, pdu, number, number)
    assert len(bus_model.history.requests) <= MAX_REQUESTS


def test_doubt_ends_with_the_echo_of_what_was_doubted() -> None:
    """A master that writes the same for ever, and repeats it once."""
    spoken = Spoken().learn_latency(5 * MS)
    for _ in range(4):
        spoken.hear(1, WRITE, 30 * MS)
        spoken.hear(1, WRITE, 5 * MS)
    spoken.hear(1, WRITE, 30 * MS)
    spoken.hear(1, WRITE, 300 * MS)
    heard = [spoken.hear(1, WRITE, after_ns) for after_ns in (5 * MS, 30 * MS) * 20]
    assert [one.confidence >= SURE for one in heard[4:]] == [True] * 36


def test_master_that_never_repeats_a_read_hardly_repeats_a_write() -> None:
    """What is learned where nothing but a repetition looks like one holds for writes, too."""
    repeating, other = Spoken(timed=False), Spoken(timed=False)
    for number in range(60):
        read = bytes((0x03, 0, number % 2, 0, 3))
        for spoken in (repeating, other):
            spoken.hear(1, read)
        repeating.hear(1, read)
        for spoken in (repeating, other):
            spoken.hear(1, ANSWER)
    costs = []
    for spoken in (repeating, other):
        spoken.hear(1, WRITE)
        costs.append(spoken.bus_model.cost(spoken.bus_model.state, 1, WRITE, REQUEST, 0))
    assert costs[0] < costs[1]


def test_doubt_about_a_response_does_not_make_it_a_request() -> None:
    """Where it is in doubt is another question than who sent it."""
    bus_model = BusModel()
    bus_model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), 1, READ, 0, 1)
    bus_model.hear(Classification(RESPONSE, DirectionBy.PENDING, 0.5), 1, ANSWER, 2, 3)
    assert len(bus_model.states) == 1
    assert bus_model.state.pending is None


def test_request_that_was_damaged_may_wait_or_not() -> None:
    """The slave may have heard the damage, or this adapter alone."""
    bus_model = BusModel()
    bus_model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), 1, READ, 0, 1)
    bus_model.hear(Classification(RESPONSE, DirectionBy.PENDING, 1.0), 1, ANSWER, 2, 3)
    bus_model.hear_damaged_frame(b"\x01" + WRITE + b"\x00\x00", REQUEST, 4, 5)
    assert {state.pending is not None for _, state in bus_model.states} == {True, False}


def test_echo_of_an_unknown_function_at_the_start_is_its_answer() -> None:
    """Had the capture begun with an answer, it would not be a request's likeness."""
    spoken = Spoken()
    assert spoken.hear(1, b"\x41").direction is REQUEST
    assert spoken.hear(1, b"\x41", 7 * MS).direction is RESPONSE


def test_unknown_function_that_is_echoed_and_asked_again_is_answered_each_time() -> None:
    spoken = Spoken()
    heard = [spoken.hear(1, b"\x41", after_ns).direction for after_ns in (2000 * MS, 7 * MS) * 3]
    assert heard == [REQUEST, RESPONSE] * 3
