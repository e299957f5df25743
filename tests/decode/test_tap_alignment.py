"""Alignment of the requests of one tap with the responses of another."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.decode.pairing import BUS_TIMEOUT_NS, has_code
from mbtool.decode.tap_pair import (
    MAX_ALIGNED,
    SKEW_NS,
    TapRequest,
    request_of_first,
)
from mbtool.modbus.adu import Adu, DirectionBy, Transport

MS = 1_000_000
LENGTH_MS = 4
END_NS = 10_000 * MS
READ = bytes.fromhex("03 0000 0001")  # read holding registers, address 0, quantity 1
ANSWER = bytes.fromhex("03 02 0007")
TOO_LONG = bytes.fromhex("03 04 0007 0008")
REFUSED = bytes.fromhex("83 02")


def _adu(direction: Direction, pdu: bytes, at_ms: float, unit: int) -> Adu:
    start_ns = int(at_ms * MS)
    return Adu(
        start_ns=start_ns,
        end_ns=start_ns + LENGTH_MS * MS,
        transport=Transport.RTU,
        direction=direction,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=unit,
        pdu=pdu,
        raw=pdu,
    )


def asked(at_ms: float, pdu: bytes = READ, unit: int = 1) -> TapRequest:
    return TapRequest.of(_adu(Direction.REQUEST, pdu, at_ms, unit))


def answered(at_ms: float, pdu: bytes = ANSWER, unit: int = 1) -> Adu:
    return _adu(Direction.RESPONSE, pdu, at_ms, unit)


@pytest.mark.parametrize(
    ("request_at_ms", "responses_at_ms", "asker"),
    [
        ([0], [10], 0),
        ([0, 200], [10, 210], 0),
        ([0, 200], [210], 1),  # Nobody answered the first, and the master asked again.
        ([0, 200], [190], 0),  # A slow slave.
        ([0], [0], 0),  # Read before the request was.
        ([50], [5], 0),
        ([0, 20], [25, 45], 0),  # Read behind the next request.
        ([0, 200], [], None),
        ([], [10], None),
    ],
)
def test_the_first_response_belongs_to(
    request_at_ms: list[float], responses_at_ms: list[float], asker: int | None
) -> None:
    requests = [asked(at_ms) for at_ms in request_at_ms]
    responses = [answered(at_ms) for at_ms in responses_at_ms]
    assert request_of_first(requests, responses, END_NS) == asker


@pytest.mark.parametrize(("pause_ms", "asker"), [(26, 0), (27, 1)])
def test_a_response_of_another_size_weighs_as_much_as_200_ms(pause_ms: int, asker: int) -> None:
    """To the second request it is 8 ms early, and 24 ms of too little patience weigh 192 ms."""
    first = asked(0, bytes.fromhex("03 0000 0002"))
    second = asked(LENGTH_MS + pause_ms)
    assert request_of_first([first, second], [answered(pause_ms)], END_NS) == asker


def test_only_the_same_unit_and_function_can_be_aligned() -> None:
    request = asked(0).adu
    assert has_code(request, answered(10))
    assert has_code(request, answered(10, REFUSED))
    assert not has_code(request, answered(10, unit=2))
    assert not has_code(request, answered(10, bytes.fromhex("04 02 0007")))
    assert request_of_first([asked(0), asked(20, unit=2)], [answered(10, unit=2)], END_NS) == 1


def test_a_response_of_the_right_size_goes_before_one_of_another() -> None:
    longer = asked(200, bytes.fromhex("03 0000 0002"))
    assert request_of_first([asked(0), longer], [answered(195, TOO_LONG)], END_NS) == 1
    assert request_of_first([asked(0), asked(200, unit=2)], [answered(10, TOO_LONG)], END_NS) == 0


def test_a_response_earlier_than_the_skew_is_not_aligned() -> None:
    skew_ms = SKEW_NS / MS
    assert request_of_first([asked(skew_ms)], [answered(LENGTH_MS)], END_NS) == 0
    assert request_of_first([asked(skew_ms)], [answered(LENGTH_MS - 1)], END_NS) is None


def test_a_request_times_out_as_on_a_bus() -> None:
    after_ms = LENGTH_MS + BUS_TIMEOUT_NS / MS
    assert request_of_first([asked(0)], [answered(after_ms)], END_NS) == 0
    assert request_of_first([asked(0)], [answered(after_ms + 1)], END_NS) is None


def test_a_response_without_request_shifts_later_polls_unless_at_the_start() -> None:
    requests = [asked(10 + 20 * number) for number in range(6)]
    responses = [answered(20 * number) for number in range(6)]
    assert request_of_first(requests, responses, END_NS, at_start=True) is None
    assert request_of_first(requests, responses, END_NS) == 0


def test_a_known_delay_costs_nothing() -> None:
    # A request, 300 ms of silence, then polls whose responses seem 7 ms early.
    requests = [asked(0), asked(300), asked(320)]
    responses = [answered(297), answered(317)]
    assert request_of_first(requests, responses, END_NS) == 0
    assert request_of_first(requests, responses, END_NS, ahead_ns=7 * MS) == 1


def test_the_request_of_a_late_response_may_be_missing_yet() -> None:
    # Nobody knows what the master says behind 120 ms; the slave may have been quicker to be read.
    requests, responses = [asked(0), asked(60)], [answered(10), answered(105), answered(110)]
    assert request_of_first(requests, responses, 120 * MS) == 0
    assert request_of_first([], [answered(110)], 120 * MS) is None


SKEW_MS = SKEW_NS / MS


@pytest.mark.parametrize(("early_ms", "asker"), [(0, 0), (1, None)])
def test_a_response_may_be_behind_the_next_request_by_the_skew(
    early_ms: float, asker: int | None
) -> None:
    # It ends so long behind the start of the next request, which is of another unit.
    requests = [asked(0), asked(200, unit=2)]
    responses = [answered(200 - LENGTH_MS + SKEW_MS + early_ms)]
    assert request_of_first(requests, responses, END_NS) == asker


@pytest.mark.parametrize(
    ("pause_ms", "late_ms", "asker"),
    [(49, 8, 0), (49, 9, 1), (48, 16, 0), (48, 17, 1), (50, 5, 1), (60, 5, 1), (0, SKEW_MS, 0)],
)
def test_each_ms_of_too_little_patience_weighs_eight_of_a_response_too_late(
    pause_ms: float, late_ms: float, asker: int
) -> None:
    # The response ends that late behind the start of the second request, which may be its own.
    second_ms = LENGTH_MS + pause_ms
    requests = [asked(0), asked(second_ms)]
    assert request_of_first(requests, [answered(second_ms + late_ms - LENGTH_MS)], END_NS) == asker


def test_a_request_that_got_the_skew_of_time_may_have_no_response() -> None:
    second_ms = LENGTH_MS + SKEW_MS
    requests = [asked(0), asked(second_ms)]
    behind = [answered(second_ms + LENGTH_MS + 1)]
    assert request_of_first(requests, behind, END_NS) == 1
    assert request_of_first([asked(0, unit=0), asked(5)], [answered(10)], END_NS) == 1


@pytest.mark.parametrize(
    ("behind_ms", "at_start", "asker"),
    [(SKEW_MS, False, None), (SKEW_MS + 1, False, 0), (SKEW_MS + 1, True, None)],
)
def test_a_response_of_another_size_is_rather_alone_at_the_edges_of_what_is_known(
    behind_ms: float, at_start: bool, asker: int | None
) -> None:
    until_ns = int((10 + behind_ms) * MS)
    found = request_of_first([asked(0)], [answered(10, TOO_LONG)], until_ns, at_start=at_start)
    assert found == asker


def test_more_requests_than_are_aligned_end_what_is_known() -> None:
    requests = [asked(100 * number) for number in range(9)]
    late = [answered(795)]
    assert request_of_first(requests, late, END_NS) == 7
    assert request_of_first(requests[:8], late, END_NS) == 7
    assert request_of_first(requests[:1], [answered(10)] * (MAX_ALIGNED + 1), END_NS) == 0


def test_the_number_of_aligned_requests_is_limited() -> None:
    requests = [asked(number) for number in range(100 * MAX_ALIGNED)]
    responses = [answered(number) for number in range(100 * MAX_ALIGNED)]
    assert request_of_first(requests, responses, END_NS) is not None
