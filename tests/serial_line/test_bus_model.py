"""Requests told from responses by the bus state."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.modbus.adu import DirectionBy, rtu_adu
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import (
    SURE,
    BusModel,
    Classification,
    roles_of,
)
from mbtool.serial_line.bus_state import MAX_PENDING_NS, BusState
from mbtool.serial_line.line_history import MAX_REQUESTS
from mbtool.serial_line.line_statistics import LatencyStatistics

MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
WRITE = bytes.fromhex("06 0001 0003")
READ = bytes.fromhex("03 006B 0003")
ANSWER = bytes.fromhex("03 06 022B 0000 0064")


class TappedLine:
    """A bus model that hears frames, a millisecond apart, and classifies each."""

    def __init__(self, *, timed: bool = True) -> None:
        self.bus_model = BusModel(timed=timed)
        self.now_ns = 0

    def hear(self, unit: int, pdu: bytes, after_ns: int = MS) -> Classification:
        self.now_ns += after_ns
        classification = self.bus_model.classify(unit, pdu, self.now_ns)
        self.bus_model.hear(classification, unit, pdu, self.now_ns, self.now_ns)
        return classification

    def learn_latency(self, latency_ns: int = 5 * MS) -> TappedLine:
        """Hear some reads with their responses."""
        for _ in range(LatencyStatistics.ENOUGH_RESPONSES + 4):
            self.hear(1, READ, 30 * MS)
            self.hear(1, ANSWER, latency_ns)
        return self


def says(classification: Classification) -> tuple[Direction, DirectionBy, bool]:
    """The direction, what decided it, and True if it is sure."""
    return classification.direction, classification.by, classification.confidence >= SURE


def test_response_that_fits_the_pending_request_is_a_response() -> None:
    line = TappedLine()
    assert line.hear(1, READ) == Classification(REQUEST, DirectionBy.FORM, 1.0)
    assert line.hear(1, ANSWER) == Classification(RESPONSE, DirectionBy.PENDING, 1.0)


def test_bus_state_decides_a_form_that_fits_both_directions() -> None:
    line = TappedLine()
    assert says(line.hear(1, WRITE)) == (REQUEST, DirectionBy.IDLE, True)
    assert says(line.hear(1, WRITE)) == (RESPONSE, DirectionBy.PENDING, True)
    assert says(line.hear(1, WRITE)) == (REQUEST, DirectionBy.IDLE, True)


def test_request_is_pending_for_a_limited_time() -> None:
    line = TappedLine()
    line.hear(1, WRITE)
    assert line.hear(1, WRITE, after_ns=MAX_PENDING_NS + 1).direction is REQUEST
    assert line.hear(1, WRITE).direction is RESPONSE


def test_retry_is_told_from_an_echo_by_its_time() -> None:
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, WRITE)
    assert says(line.hear(1, WRITE, after_ns=300 * MS)) == (REQUEST, DirectionBy.TIMING, True)
    assert says(line.hear(1, WRITE, after_ns=5 * MS)) == (RESPONSE, DirectionBy.PENDING, True)


def test_slow_line_allows_longer_response_times() -> None:
    line = TappedLine().learn_latency(300 * MS)
    line.hear(1, WRITE)
    assert says(line.hear(1, WRITE, 300 * MS)) == (RESPONSE, DirectionBy.PENDING, True)


def test_echo_can_at_most_double_the_longest_response_time() -> None:
    """In many devices writes take longer than reads. But an echo may have been a retry."""
    line = TappedLine()
    for number in range(8 * LatencyStatistics.ENOUGH_RESPONSES):
        line.hear(1, bytes((0x03, 0, number % 2, 0, 3)), 50 * MS)
        line.hear(1, ANSWER, 5 * MS)
    heard = []
    for value in range(20):
        write = bytes((0x06, 0, 1, 0, value))
        line.hear(1, write, 50 * MS)
        heard.append(line.hear(1, write, 30 * MS))
    assert {one.direction for one in heard} == {RESPONSE}
    assert [one.confidence >= SURE for one in heard[2:]] == [True] * 18
    line.hear(1, WRITE, 50 * MS)
    assert line.hear(1, WRITE, 300 * MS).direction is REQUEST


def test_silences_do_not_count_if_times_are_made_up() -> None:
    line = TappedLine(timed=False)
    for _ in range(LatencyStatistics.ENOUGH_RESPONSES + 4):
        line.hear(1, READ)
        line.hear(1, ANSWER)
    line.hear(1, WRITE)
    assert line.hear(1, WRITE, after_ns=300 * MS).direction is RESPONSE


def test_write_that_differs_from_the_pending_one_is_a_request() -> None:
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, WRITE)
    other = bytes.fromhex("06 0002 0003")
    assert line.hear(1, other, 300 * MS).direction is REQUEST
    assert line.hear(1, other).direction is RESPONSE


def test_other_write_on_a_line_of_echoes_is_a_request_or_ambiguous() -> None:
    """Without a known response time 200 ms are assumed, and many masters wait less."""
    line = TappedLine()
    line.hear(1, WRITE)
    classification = line.hear(1, bytes.fromhex("06 0002 0003"), 100 * MS)
    assert classification.direction is REQUEST or classification.confidence < SURE


def test_response_of_another_unit_leaves_the_request_pending() -> None:
    line = TappedLine()
    line.hear(1, WRITE)
    assert line.hear(2, ANSWER) == Classification(RESPONSE, DirectionBy.FORM, 1.0)
    assert line.hear(1, WRITE).direction is RESPONSE


def test_wrong_response_of_the_same_unit_ends_the_pending_request() -> None:
    line = TappedLine()
    line.hear(1, READ)
    assert line.hear(1, bytes.fromhex("03 02 022B")).direction is RESPONSE
    assert line.bus_model.state.pending is None


def test_broadcast_is_never_pending() -> None:
    line = TappedLine()
    line.hear(0, WRITE)
    assert line.bus_model.state.pending is None
    assert line.hear(0, WRITE).direction is REQUEST


def test_force_listen_only_is_never_pending() -> None:
    line = TappedLine()
    listen_only = bytes.fromhex("08 0004 0000")
    line.hear(1, listen_only)
    assert line.bus_model.state.pending is None
    assert line.hear(1, listen_only).direction is REQUEST


def test_longer_echo_of_diagnostics_is_a_response() -> None:
    line = TappedLine()
    loopback = bytes.fromhex("08 0000 A537 0001 0002")
    assert line.hear(1, loopback).direction is REQUEST
    assert line.hear(1, loopback).direction is RESPONSE


def test_diagnostics_frame_with_a_count_is_a_response() -> None:
    """The request for a count has 0000 as data. The request for this one was not heard."""
    line = TappedLine()
    line.hear(1, READ)
    line.hear(1, ANSWER)
    assert line.hear(1, bytes.fromhex("08 000B 0000")).direction is REQUEST
    assert line.hear(1, bytes.fromhex("08 000B 0108")).direction is RESPONSE


def test_bus_state_decides_a_form_without_a_length() -> None:
    line = TappedLine()
    assert line.hear(1, b"\x2b\x0d\x00").direction is REQUEST
    assert line.hear(1, b"\x2b\x0d\x00\x01").direction is RESPONSE


def test_late_response_after_a_retry_is_a_response() -> None:
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, WRITE)
    assert line.hear(1, WRITE, 300 * MS).direction is REQUEST
    assert line.hear(1, WRITE, 3 * MS).direction is RESPONSE
    assert line.bus_model.state.overdue is not None
    assert line.hear(1, ANSWER, 3 * MS).direction is RESPONSE


def test_late_echo_behind_a_request_to_another_unit_is_a_response() -> None:
    line = TappedLine().learn_latency(5 * MS)
    line.hear(2, WRITE, 30 * MS)
    line.hear(1, READ, 300 * MS)
    assert says(line.hear(2, WRITE, 3 * MS)) == (RESPONSE, DirectionBy.PENDING, True)
    assert line.hear(1, ANSWER, 3 * MS) == Classification(RESPONSE, DirectionBy.PENDING, 1.0)


def test_second_response_is_timed_from_the_retry() -> None:
    """The master retried just before the request stopped being pending."""
    line = TappedLine().learn_latency(5 * MS)
    asked, answer = b"\x45\x01", b"\x45\x02\x03"
    line.hear(1, asked, 30 * MS)
    assert line.hear(1, asked, MAX_PENDING_NS - 2 * MS).direction is REQUEST
    assert line.hear(1, answer, 5 * MS).direction is RESPONSE
    assert line.hear(1, answer, 5 * MS).direction is RESPONSE


def test_third_equal_frame_is_a_response_if_the_master_never_repeats() -> None:
    """Without times: a request, its retry and the response."""
    line = TappedLine(timed=False)
    for number in range(300):
        line.hear(1, bytes((0x03, 0, number % 2, 0, 3)))
        line.hear(1, ANSWER)
    bus_model, state, costs = line.bus_model, line.bus_model.state, []
    for roles in ((REQUEST, REQUEST, RESPONSE), (REQUEST, RESPONSE, REQUEST)):
        supposed, cost = state, 0.0
        for role in roles:
            cost += bus_model.cost(supposed, 1, WRITE, role, 0)
            supposed = bus_model.next_state(supposed, 1, WRITE, role, 0, 0)
        costs.append(cost)
    assert costs[0] + 2 < costs[1]


def test_response_after_damage_to_a_function_never_requested_is_less_likely() -> None:
    line = TappedLine().learn_latency()
    line.bus_model.hear_damage()
    at_ns = line.now_ns + MS
    polled, odd, unheard = (
        line.bus_model.cost(line.bus_model.state, 1, bytes.fromhex(pdu), RESPONSE, at_ns)
        for pdu in ("83 02", "83 93", "92 02")
    )
    assert polled < unheard
    assert polled < odd


# Where frames are glued, the silences stand between the reads.


def glued() -> TappedLine:
    """A line that delivers four frames at once, every 60 ms."""
    line = TappedLine()
    line.bus_model.history.trusts_silences = False
    for _ in range(2 * LatencyStatistics.ENOUGH_RESPONSES):
        line.hear(1, READ, 60 * MS)
        line.hear(1, ANSWER, 0)
        line.hear(2, READ, 0)
        line.hear(2, ANSWER, 0)
    return line


@pytest.mark.parametrize(("pause_ns", "called"), [(60 * MS, RESPONSE), (600 * MS, REQUEST)])
def test_unusually_long_silence_among_glued_frames_is_a_missing_response(
    pause_ns: int, called: Direction
) -> None:
    bus_model = (line := glued()).bus_model
    costs = []
    for role in (RESPONSE, REQUEST):
        at_ns = line.now_ns + pause_ns
        asked = bus_model.next_state(bus_model.state, 1, WRITE, REQUEST, at_ns, at_ns)
        cost = bus_model.cost(asked, 1, WRITE, role, at_ns)
        costs.append(
            cost + bus_model.silence_cost(bus_model.next_state(asked, 1, WRITE, role, at_ns, at_ns))
        )
    assert (costs[1] < costs[0]) is (called is REQUEST)


def test_pause_usual_for_the_master_is_no_missing_response() -> None:
    bus_model = (line := glued()).bus_model
    for _ in range(8):
        line.hear(1, READ, 600 * MS)
        line.hear(1, ANSWER, 0)
    assert bus_model.silence_cost(bus_model.state) == 0


def test_unexplained_silences_are_not_kept_where_silences_are_trusted() -> None:
    assert TappedLine().learn_latency().bus_model.state.unexplained_silence_ns == 0


def test_echo_of_an_ambiguous_frame_is_ambiguous() -> None:
    line = TappedLine()
    line.hear(1, WRITE)
    doubtful = line.hear(1, WRITE, 300 * MS)
    assert doubtful.confidence < SURE
    assert line.hear(1, WRITE, 3 * MS).confidence < SURE
    line.hear(1, READ)
    assert line.hear(1, ANSWER).confidence == 1


def test_retry_of_a_read_of_bits_is_no_response_to_itself() -> None:
    line = TappedLine()
    contacts = bytes.fromhex("01 03E8 0011")
    assert line.hear(1, contacts).direction is REQUEST
    assert line.hear(1, contacts, 300 * MS).direction is REQUEST
    assert line.hear(1, bytes.fromhex("01 03 1234 01")).direction is RESPONSE


# Responses as long as a request. Late is what takes longer than any response before it.

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
def test_frame_that_is_an_improbable_request_may_be_a_late_response(
    asked: str, answer: str, late_ns: int
) -> None:
    line = TappedLine().learn_latency(5 * MS)
    assert line.hear(1, bytes.fromhex(asked), 30 * MS).direction is REQUEST
    late = line.hear(1, bytes.fromhex(answer), late_ns)
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
def test_request_after_an_unanswered_one_is_a_request(unit: int, pdu: str, late_ns: int) -> None:
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, bytes.fromhex(CONTACTS), 30 * MS)
    assert line.hear(unit, bytes.fromhex(pdu), late_ns).direction is REQUEST


def test_time_decides_a_frame_that_is_also_a_usual_request() -> None:
    """It fits the pending request, and it is the next request of the master's list as well."""
    asked, other = bytes.fromhex(CONTACTS), bytes.fromhex("01 0320 0010")
    for after_ns, called in ((6 * MS, RESPONSE), (600 * MS, REQUEST)):
        line = TappedLine().learn_latency(5 * MS)
        for _ in range(3):
            line.hear(1, other, 30 * MS)
            line.hear(1, bytes.fromhex("01 02 0000"), 5 * MS)
        line.hear(1, asked, 30 * MS)
        assert says(line.hear(1, other, after_ns))[::2] == (called, True)


@LATE
def test_request_for_another_file_after_an_unanswered_one_is_a_request(late_ns: int) -> None:
    """The request does not tell the length of the response, so fitting it is weak evidence."""
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, bytes.fromhex("14 07 06 0004 0001 0002"), 30 * MS)
    assert line.hear(1, bytes.fromhex("14 07 06 0009 0001 0002"), late_ns).direction is REQUEST


@pytest.mark.parametrize(
    ("asked", "none"), [(CONTACTS, "01 0300 0000"), ("08 000B 0000", "08 000B 0108")]
)
def test_improbable_request_stays_a_late_response_though_heard_as_a_request_before(
    asked: str, none: str
) -> None:
    """A test tool sends requests that no master sends."""
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, READ, 30 * MS)
    pdu = bytes.fromhex(none)
    line.bus_model.hear(Classification(REQUEST, DirectionBy.IDLE, 1.0), 1, pdu, 0, line.now_ns)
    line.hear(1, bytes((pdu[0] | 0x80, 3)), 5 * MS)
    line.hear(1, bytes.fromhex(asked), 30 * MS)
    assert says(line.hear(1, pdu, 900 * MS)) == (RESPONSE, DirectionBy.PENDING, True)


def test_another_request_ends_the_time_for_a_late_response() -> None:
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, bytes.fromhex(CONTACTS), 30 * MS)
    line.hear(1, READ, 600 * MS)
    late = line.hear(1, bytes.fromhex("01 0320 0010"), MAX_PENDING_NS + MS)
    assert says(late) == (REQUEST, DirectionBy.IDLE, True)


def test_retry_of_a_read_of_bits_is_no_late_response_to_itself() -> None:
    line = TappedLine(timed=False)
    contacts = bytes.fromhex("01 0300 0011")
    heard = [contacts, contacts, bytes.fromhex("01 03 000000"), contacts]
    assert [line.hear(1, pdu).direction for pdu in heard] == [
        REQUEST, REQUEST, RESPONSE, REQUEST,
    ]  # fmt: skip


def test_damage_makes_the_pending_request_overdue() -> None:
    line = TappedLine()
    line.hear(1, READ)
    line.bus_model.hear_damage()
    state = line.bus_model.state
    assert (state.pending, state.follows_damage) == (None, True)
    assert state.overdue is not None
    assert state.overdue.pdu == READ
    assert line.hear(1, ANSWER).direction is RESPONSE
    assert not line.bus_model.state.follows_damage


def test_expected_frame_is_the_response_to_the_pending_request() -> None:
    line = TappedLine()
    bus_model = line.bus_model
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(ANSWER), RESPONSE)
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(READ), REQUEST)
    line.hear(1, READ)
    assert bus_model.expects(bus_model.state, 1, 0x03, len(ANSWER), RESPONSE)
    assert bus_model.expects(bus_model.state, 1, 0x03, 0, RESPONSE)
    assert bus_model.expects(bus_model.state, 1, 0x83, 2, RESPONSE)
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(ANSWER) + 2, RESPONSE)
    assert not bus_model.expects(bus_model.state, 2, 0x03, len(ANSWER), RESPONSE)
    assert not bus_model.expects(bus_model.state, 1, 0x03, len(READ), REQUEST)
    line.hear(1, ANSWER)
    assert bus_model.expects(bus_model.state, 1, 0x03, len(READ), REQUEST)


def test_next_state_does_not_change_the_model() -> None:
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


def test_number_of_known_requests_is_bounded() -> None:
    bus_model = BusModel()
    for number in range(3 * MAX_REQUESTS):
        pdu = bytes((0x06, *number.to_bytes(2), 0, 0))
        bus_model.hear(Classification(REQUEST, DirectionBy.IDLE, 1.0), 1, pdu, number, number)
    assert len(bus_model.history.requests) <= MAX_REQUESTS


def test_doubt_about_a_retry_ends_with_its_echo() -> None:
    """A master that always writes the same, and retries once."""
    line = TappedLine().learn_latency(5 * MS)
    for _ in range(4):
        line.hear(1, WRITE, 30 * MS)
        line.hear(1, WRITE, 5 * MS)
    line.hear(1, WRITE, 30 * MS)
    line.hear(1, WRITE, 300 * MS)
    heard = [line.hear(1, WRITE, after_ns) for after_ns in (5 * MS, 30 * MS) * 20]
    assert [one.confidence >= SURE for one in heard[4:]] == [True] * 36


def test_master_that_never_repeats_a_read_hardly_repeats_a_write() -> None:
    """Retries are learned from reads, where only a retry looks like one, and used for writes."""
    repeating, other = TappedLine(timed=False), TappedLine(timed=False)
    for number in range(60):
        read = bytes((0x03, 0, number % 2, 0, 3))
        for line in (repeating, other):
            line.hear(1, read)
        repeating.hear(1, read)
        for line in (repeating, other):
            line.hear(1, ANSWER)
    costs = []
    for line in (repeating, other):
        line.hear(1, WRITE)
        costs.append(line.bus_model.cost(line.bus_model.state, 1, WRITE, REQUEST, 0))
    assert costs[0] < costs[1]


def test_doubt_about_a_response_does_not_make_it_a_request() -> None:
    """The doubt may be about where it ends, not about who sent it."""
    bus_model = BusModel()
    bus_model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), 1, READ, 0, 1)
    bus_model.hear(Classification(RESPONSE, DirectionBy.PENDING, 0.5), 1, ANSWER, 2, 3)
    assert len(bus_model.states) == 1
    assert bus_model.state.pending is None


def test_damaged_request_is_pending_or_not() -> None:
    """The damage may have reached the slave, or this tap only."""
    bus_model = BusModel()
    bus_model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), 1, READ, 0, 1)
    bus_model.hear(Classification(RESPONSE, DirectionBy.PENDING, 1.0), 1, ANSWER, 2, 3)
    bus_model.hear_damaged_frame(b"\x01" + WRITE + b"\x00\x00", REQUEST, 4, 5)
    assert {state.pending is not None for _, state in bus_model.states} == {True, False}


def test_echo_of_an_unknown_function_at_the_start_is_its_answer() -> None:
    """A response at the start of a capture would not also fit as the echo of a request."""
    line = TappedLine()
    assert line.hear(1, b"\x41").direction is REQUEST
    assert line.hear(1, b"\x41", 7 * MS).direction is RESPONSE


def test_unknown_function_that_is_echoed_and_asked_again_is_answered_each_time() -> None:
    line = TappedLine()
    heard = [line.hear(1, b"\x41", after_ns).direction for after_ns in (2000 * MS, 7 * MS) * 3]
    assert heard == [REQUEST, RESPONSE] * 3


# What is due.


def asked_for(pdu: bytes, *, unit: int = 1) -> BusModel:
    """After a request that ended at 0."""
    model = BusModel()
    model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), unit, pdu, 0, 0)
    return model


def test_response_is_due_with_the_unit_function_and_size_of_its_request() -> None:
    model = asked_for(READ)
    state = model.state
    for unit, code, size, is_due in (
        (1, 0x03, 8, True),
        (1, 0x03, 0, True),
        (1, 0x03, 7, False),
        (1, 0x83, 2, True),
        (1, 0x04, 8, False),
        (2, 0x03, 8, False),
    ):
        assert model.expects(state, unit, code, size, RESPONSE) is is_due
    assert model.expects(state, 1, 0x03, 5, REQUEST) is False
    assert BusModel().expects(BusModel().state, 1, 0x03, 8, RESPONSE) is False


def test_request_is_due_if_its_function_was_requested_and_none_is_pending() -> None:
    model = asked_for(READ)
    state = BusModel().state
    assert model.expects(state, 1, 0x03, 5, REQUEST) is True
    assert model.expects(state, 1, 0x04, 5, REQUEST) is False
    assert model.expects(state, 2, 0x03, 5, REQUEST) is False


@pytest.mark.parametrize(
    ("head", "size", "is_due"),
    [
        ("01", 0, True),
        ("02", 0, False),
        ("01 03", 0, True),
        ("01 04", 0, False),
        ("01 03 06", 0, True),
        ("01 03 06", 11, True),
        ("01 03 06 00", 11, True),
        ("01 03 06 00", 10, False),
        ("01 03 06 00", 0, False),
        ("01 03 06 00 00 00 00 00 00 00", 11, True),
        ("01 03 06 00 00 00 00 00 00 00 00", 11, False),
    ],
)
def test_bytes_are_the_beginning_of_the_response_that_is_due(
    head: str, size: int, is_due: bool
) -> None:
    model = asked_for(READ)
    sizes = {RESPONSE: size} if size else {}
    assert bool(model.expects_incomplete(bytes.fromhex(head), sizes)) is is_due


def test_one_byte_is_the_beginning_of_a_request_to_a_known_unit() -> None:
    model = asked_for(READ)
    model.reset_state()
    assert model.expects_incomplete(b"\x01", {})
    assert not model.expects_incomplete(b"\x02", {})
    assert model.expects_incomplete(b"\x01\x03\x00", {REQUEST: 8})
    assert not model.expects_incomplete(b"\x01\x04\x00", {REQUEST: 8})


# Silences between merged frames.


def merging(longest_ns: int = 20 * MS) -> BusModel:
    """A line whose adapter merges frames, and the silences between them."""
    model = BusModel()
    model.history.trusts_silences = False
    for _ in range(16):
        model.history.unexplained_silences.learn(longest_ns)
    return model


@pytest.mark.parametrize(
    ("silence_ns", "is_last", "bits"),
    [
        (0, False, 0.0),
        (20 * MS, False, 0.0),
        (23 * MS, False, 0.0),
        (40 * MS, False, costs.LATE + costs.LATE_PER_DOUBLING),
        (40 * MS, True, (costs.LATE + costs.LATE_PER_DOUBLING) / 2),
        (160 * MS, False, costs.MAX_LATENESS),
        (255 * MS, True, costs.MAX_LATENESS / 2),
        (255 * MS + 1, True, costs.MAX_LATENESS),
    ],
)
def test_long_silence_that_no_missing_response_explains_costs_by_its_doublings(
    silence_ns: int, is_last: bool, bits: float
) -> None:
    state = BusState(unexplained_silence_ns=silence_ns)
    assert merging().silence_cost(state, is_last=is_last) == pytest.approx(bits)


@pytest.mark.parametrize(
    ("role", "answered", "start_ns", "inside_ns", "silence_ns"),
    [
        (RESPONSE, False, 130, 0, 30),
        (RESPONSE, False, 100, 0, 9),
        (RESPONSE, False, 130, 40, 40),
        (REQUEST, True, 130, 0, 30),
        (REQUEST, True, 100, 0, 9),
        (REQUEST, False, 130, 0, 0),
        (REQUEST, False, 130, 40, 40),
    ],
)
def test_last_silence_is_the_one_inside_a_frame_or_before_it(
    role: Direction, answered: bool, start_ns: int, inside_ns: int, silence_ns: int
) -> None:
    pending = asked_for(READ).state.pending if answered else None
    state = BusState(answered=pending, last_ns=100, unexplained_silence_ns=9)
    for model, expected in ((merging(), silence_ns), (BusModel(), 0), (BusModel(timed=False), 0)):
        after = model.next_state(state, 1, READ, role, start_ns, 200, inside_ns)
        assert after.unexplained_silence_ns == expected
        assert after.last_ns == 200


def test_silence_costs_in_full_unless_it_is_the_last() -> None:
    model, state = merging(), BusState(unexplained_silence_ns=40 * MS)
    assert model.silence_cost(state) == model.silence_cost(state, is_last=False)


def test_first_frame_has_no_silence_before_it() -> None:
    after = merging().next_state(BusState(), 1, ANSWER, RESPONSE, 130, 200)
    assert after.unexplained_silence_ns == 0


def test_request_remembers_the_silence_before_it_and_the_request_that_it_follows() -> None:
    model = BusModel()
    first = model.next_state(BusState(), 1, READ, REQUEST, 50, 100)
    assert first.pending is not None
    assert (first.pending.silence_before_ns, first.pending.awaited_from_ns) == (None, 100)
    second = model.next_state(first, 2, WRITE, REQUEST, 130, 200)
    assert second.pending is not None
    assert second.overdue is not None
    assert (second.pending.unit, second.pending.silence_before_ns) == (2, 30)
    assert (second.overdue.unit, second.overdue.awaited_from_ns) == (1, 200)
    assert second.last_response == b""
    broadcast = model.next_state(second, 0, WRITE, REQUEST, 230, 300)
    assert broadcast.pending is broadcast.overdue is None


def test_response_answers_the_pending_request_and_keeps_the_overdue_one() -> None:
    model = BusModel()
    first = model.next_state(BusState(), 1, READ, REQUEST, 50, 100)
    second = model.next_state(first, 1, READ, REQUEST, 130, 200)
    after = model.next_state(second, 1, ANSWER, RESPONSE, 230, 300)
    assert (after.pending, after.answered, after.overdue) == (None, second.pending, second.overdue)
    assert after.last_response == ANSWER
    late = model.next_state(after, 1, ANSWER, RESPONSE, 330, 400)
    assert (late.pending, late.answered, late.overdue) == (None, second.overdue, None)
    other = model.next_state(second, 2, ANSWER, RESPONSE, 230, 300)
    assert (other.pending, other.answered, other.overdue) == (
        second.pending, None, second.overdue,
    )  # fmt: skip
    assert not after.direction_known
    assert model.next_state(BusState(), 1, READ, REQUEST, 50, 100, 0, True).direction_known


def test_damage_that_a_wrong_bit_explains_leaves_two_bus_states() -> None:
    model = BusModel()
    frame = rtu_adu(1, READ)
    model.hear_damaged_frame(frame, REQUEST, 50, 100)
    assert [bits for bits, _ in model.states] == [0.0, costs.NOT_UNDERSTOOD]
    understood, ignored = (state for _, state in model.states)
    assert understood.pending is not None
    assert (understood.pending.unit, understood.pending.pdu) == (1, READ)
    assert (understood.last_ns, understood.direction_known) == (100, False)
    assert (ignored.pending, ignored.follows_damage) == (None, True)
