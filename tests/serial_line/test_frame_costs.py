"""The cost of a frame as a request or a response, in a bus state."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import SURE, BusModel
from mbtool.serial_line.bus_state import MAX_PENDING_NS, BusState, PendingRequest
from mbtool.serial_line.frame_costs import frame_cost
from mbtool.serial_line.line_history import LineHistory
from tests.serial_line.test_bus_model import ANSWER, MS, READ, WRITE, TappedLine

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@pytest.mark.parametrize(("pdu", "role"), [(READ, REQUEST), (ANSWER, RESPONSE)])
def test_units_from_248_on_cost_more(pdu: bytes, role: Direction) -> None:
    model = BusModel()
    first, last, reserved = (model.cost(model.state, unit, pdu, role, 0) for unit in (1, 247, 248))
    assert first == last < reserved


def test_master_that_waited_long_before_a_retry_does_not_repeat_it_soon() -> None:
    """No write on this line takes more than 20 ms. The third frame comes 25 ms after the retry."""
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, WRITE, 30 * MS)
    assert line.hear(1, WRITE, 300 * MS).direction is REQUEST
    third = line.hear(1, WRITE, 25 * MS)
    assert third.direction is RESPONSE
    assert third.confidence >= SURE


def test_second_response_has_the_length_of_the_first() -> None:
    """The slave responds to the request and to its retry. A longer frame is a new request."""
    for last, direction in ((b"\x45\x02\x03", RESPONSE), (b"\x45\x02\x03\x04", REQUEST)):
        line = TappedLine().learn_latency(5 * MS)
        line.hear(1, b"\x45\x01", 30 * MS)
        assert line.hear(1, b"\x45\x01", 300 * MS).direction is REQUEST
        assert line.hear(1, b"\x45\x09\x08", 5 * MS).direction is RESPONSE
        assert line.hear(1, last, 5 * MS).direction is direction


# Each cost, in bits.

OTHER = bytes.fromhex("04 0008 0001")
VENDOR = bytes.fromhex("41 0102")
BITS = bytes.fromhex("01 0000 000A")  # Ten bits, so that two are used of the second byte.
NEW = costs.REQUEST + costs.NEW_REQUEST
SECOND = 1_000_000_000


def asked(pdu: bytes, before_ns: int | None = None, unit: int = 1) -> PendingRequest:
    """A request that ended at 0."""
    expected = ExpectedResponse.of(pdu)
    assert expected is not None
    return PendingRequest(unit, pdu, expected, 0, before_ns)


def cost(
    state: BusState,
    pdu: bytes,
    role: Direction,
    at_ns: int = MS,
    *,
    unit: int = 1,
    heard: tuple[bytes, ...] = (),
    timed: bool = True,
) -> tuple[float, float]:
    """Bits by the bus state, and by the silence before the frame."""
    history = LineHistory(timed=timed)
    for one in heard:
        history.learn_request(BusState(), 1, one, by_form=False, start_ns=0)
    return frame_cost(history, state, unit, pdu, role, at_ns)


@pytest.mark.parametrize(
    ("state", "pdu", "expected"),
    [
        (BusState(), READ, costs.REQUEST),
        (BusState(), OTHER, NEW),
        (BusState(), bytes.fromhex("03 0000 0000"), NEW + costs.MALFORMED),
        (BusState(), bytes.fromhex("08 000B 0001"), NEW + costs.IMPLAUSIBLE_REQUEST),
        (BusState(pending=asked(OTHER)), READ, costs.REQUEST + costs.PREVIOUS_UNANSWERED),
        (BusState(pending=asked(OTHER)), WRITE, NEW + costs.PREVIOUS_UNANSWERED),
        (BusState(pending=asked(READ)), READ, costs.REQUEST + costs.RETRY),
        (BusState(pending=asked(OTHER)), OTHER, costs.REQUEST + costs.RETRY),
        (
            BusState(pending=asked(READ), overdue=asked(READ)),
            READ,
            costs.REQUEST + costs.SECOND_RETRY,
        ),
        (BusState(pending=asked(READ), overdue=asked(OTHER)), READ, costs.REQUEST + costs.RETRY),
        (BusState(answered=asked(READ)), READ, costs.REQUEST),
        (BusState(answered=asked(OTHER)), OTHER, costs.REQUEST),
        (
            BusState(answered=asked(READ), overdue=asked(READ)),
            READ,
            costs.REQUEST + costs.REPEAT_AFTER_RESPONSE,
        ),
        (
            BusState(answered=asked(READ), last_response=OTHER),
            OTHER,
            NEW + costs.REQUEST_EQUALS_RESPONSE,
        ),
        (BusState(answered=asked(READ, unit=2), last_response=OTHER), OTHER, NEW),
        (BusState(last_response=OTHER), OTHER, NEW + costs.REQUEST_EQUALS_RESPONSE),
        (BusState(last_response=WRITE), WRITE, NEW),
    ],
)
def test_cost_of_a_request_by_the_bus_state(state: BusState, pdu: bytes, expected: float) -> None:
    assert cost(state, pdu, REQUEST, heard=(READ,)) == (expected, 0.0)


@pytest.mark.parametrize(
    ("state", "pdu", "expected"),
    [
        (BusState(pending=asked(READ)), ANSWER, costs.RESPONSE),
        (BusState(pending=asked(READ)), bytes.fromhex("83 02"), costs.RESPONSE),
        (BusState(pending=asked(READ)), ANSWER[:-2], costs.MISMATCHED_RESPONSE),
        (BusState(pending=asked(READ)), ANSWER[:-1], costs.MISMATCHED_RESPONSE + costs.MALFORMED),
        (BusState(pending=asked(OTHER), last_ns=0), ANSWER, costs.UNREQUESTED_RESPONSE),
        (BusState(last_ns=0), ANSWER, costs.UNREQUESTED_RESPONSE),
        (BusState(last_ns=0), ANSWER[:-1], costs.UNREQUESTED_RESPONSE + costs.MALFORMED),
        (BusState(), ANSWER, costs.RESPONSE_AT_START),
        (BusState(last_ns=0, follows_damage=True), ANSWER, costs.RESPONSE_AFTER_DAMAGE),
        (
            BusState(last_ns=0, follows_damage=True),
            bytes.fromhex("83 02"),
            costs.RESPONSE_AFTER_DAMAGE,
        ),
        (
            BusState(last_ns=0, follows_damage=True),
            bytes.fromhex("84 02"),
            costs.RESPONSE_AFTER_DAMAGE + costs.UNREQUESTED_EXCEPTION,
        ),
        (BusState(overdue=asked(READ), last_ns=0), ANSWER, costs.LATE_RESPONSE),
        (
            BusState(overdue=asked(READ), pending=asked(READ), last_ns=0),
            bytes.fromhex("83 02"),
            costs.RESPONSE,
        ),
        (
            BusState(overdue=asked(READ), pending=asked(OTHER), last_ns=0),
            ANSWER,
            costs.LATE_RESPONSE_TO_OTHER,
        ),
        (
            BusState(overdue=asked(READ), answered=asked(READ), last_response=ANSWER, last_ns=0),
            ANSWER,
            costs.LATE_RESPONSE,
        ),
        (
            BusState(overdue=asked(READ), answered=asked(READ), last_response=b"\x83\x02"),
            ANSWER,
            costs.LATE_RESPONSE + costs.UNLIKE_FIRST_RESPONSE,
        ),
        (BusState(pending=asked(BITS)), bytes.fromhex("01 02 FF03"), costs.RESPONSE),
        (BusState(pending=asked(BITS)), bytes.fromhex("01 02 FF07"), costs.MALFORMED),
        (BusState(pending=asked(WRITE)), WRITE, costs.RESPONSE),
        (
            BusState(pending=asked(VENDOR)),
            VENDOR,
            costs.ECHO_OF_UNKNOWN_FUNCTION + costs.ECHO_IN_TIME,
        ),
    ],
)
def test_cost_of_a_response_by_the_bus_state(state: BusState, pdu: bytes, expected: float) -> None:
    assert sum(cost(state, pdu, RESPONSE, heard=(READ,))) == expected


def test_nobody_responds_to_a_broadcast() -> None:
    told = cost(BusState(last_ns=0), WRITE, RESPONSE, unit=0)
    assert told == (costs.UNREQUESTED_RESPONSE + costs.MALFORMED, 0.0)


def test_late_response_comes_within_a_second() -> None:
    state = BusState(overdue=asked(READ), last_ns=0)
    for at_ns, bits in (
        (MAX_PENDING_NS, costs.LATE_RESPONSE),
        (MAX_PENDING_NS + 1, costs.UNREQUESTED_RESPONSE),
    ):
        assert cost(state, ANSWER, RESPONSE, at_ns) == (bits, 0.0)


@pytest.mark.parametrize(
    ("silence_ns", "bits"),
    [
        (200 * MS, 0.0),
        (237 * MS, 0.0),  # A fifth longer than the longest time, 200 ms.
        (400 * MS, costs.LATE + costs.LATE_PER_DOUBLING),
        (800 * MS, costs.MAX_LATENESS),
    ],
)
def test_lateness_costs_by_its_doublings_up_to_a_limit(silence_ns: int, bits: float) -> None:
    state = BusState(pending=asked(READ))
    assert cost(state, ANSWER, RESPONSE, silence_ns) == pytest.approx((costs.RESPONSE, bits))
    assert cost(state, ANSWER, RESPONSE, silence_ns, timed=False) == (costs.RESPONSE, 0.0)


def test_late_echo_costs_more_than_another_late_response() -> None:
    state = BusState(pending=asked(WRITE), direction_known=True)
    bits = costs.LATE + 3 * costs.LATE_PER_DOUBLING
    assert cost(state, WRITE, RESPONSE, 1600 * MS) == pytest.approx((costs.RESPONSE, bits))
    assert cost(state, WRITE, RESPONSE, 20 * SECOND) == (costs.RESPONSE, costs.MAX_ECHO_LATENESS)


def test_late_echo_of_an_unknown_function_costs_its_lateness_instead() -> None:
    told = cost(BusState(pending=asked(VENDOR)), VENDOR, RESPONSE, 400 * MS)
    late = costs.LATE + costs.LATE_PER_DOUBLING
    assert told == pytest.approx((costs.ECHO_OF_UNKNOWN_FUNCTION, late))


@pytest.mark.parametrize(
    ("before_ns", "silence_ns", "known", "bits"),
    [
        (10 * MS, 20 * MS, False, 0.0),
        (10 * MS, 20 * MS + 1, False, costs.REVERSED_PAIR),
        (10 * MS, 20 * MS + 1, True, 0.0),
        (None, 20 * MS + 1, False, 0.0),
        (0, 20 * MS + 1, False, 0.0),
    ],
)
def test_echo_after_twice_the_silence_before_its_request_is_reversed(
    before_ns: int | None, silence_ns: int, known: bool, bits: float
) -> None:
    state = BusState(pending=asked(WRITE, before_ns), direction_known=known)
    assert cost(state, WRITE, RESPONSE, silence_ns) == (costs.RESPONSE, bits)


def test_request_before_the_longest_response_time_is_early() -> None:
    history = LineHistory(timed=True)
    for _ in range(16):
        history.latency.learn(100 * MS)
    state = BusState(pending=asked(READ))
    for at_ns, bits in ((100 * MS - 1, costs.EARLY_REQUEST), (100 * MS, 0.0)):
        by_state, by_time = frame_cost(history, state, 1, READ, REQUEST, at_ns)
        assert (by_state, by_time) == (costs.REQUEST + costs.RETRY, bits)


BITS_20 = bytes.fromhex("01 0000 0014")


@pytest.mark.parametrize(
    ("pdu", "heard", "extra"),
    [
        ("01 03 01 02 03", False, costs.REQUEST_FITS_PENDING),
        ("01 03 01 02 03", True, 0.0 - costs.NEW_REQUEST),
        ("01 03 01 02 13", False, 0.0),  # Its last byte is not filled with 0.
        ("01 03 00 00 00", True, costs.REQUEST_FITS_PENDING - costs.NEW_REQUEST),
    ],
)
def test_request_as_long_as_the_response_that_is_due_is_improbable(
    pdu: str, heard: bool, extra: float
) -> None:
    raw = bytes.fromhex(pdu)
    told = cost(BusState(pending=asked(BITS_20)), raw, REQUEST, heard=(raw,) if heard else ())
    assert told == (NEW + costs.PREVIOUS_UNANSWERED + extra, 0.0)
