"""Frames found at the front of a line without a search."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.modbus.adu import DirectionBy, rtu_adu
from mbtool.serial_line.bus_model import BusModel, Classification
from mbtool.serial_line.fast_path import FastPath

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
READ = rtu_adu(1, bytes.fromhex("03 0000 0002"))
ANSWER = rtu_adu(1, bytes.fromhex("03 04 0001 0002"))
REFUSAL = rtu_adu(1, bytes.fromhex("83 02"))
OTHER = rtu_adu(2, bytes.fromhex("04 0000 0001"))
MOST = 512


def front(*heard: bytes, speaker: Direction | None = None) -> FastPath:
    """The fast path of a line on which these frames were heard, requests and responses in turn."""
    bus_model = BusModel()
    for place, raw in enumerate(heard):
        role = (REQUEST, RESPONSE)[place % 2]
        bus_model.hear(Classification(role, DirectionBy.FORM, 1.0), raw[0], raw[1:-2], 0, 1)
    return FastPath(bus_model, speaker, MOST)


def taken(
    looking: FastPath, data: bytes, *, burst_over: bool = True
) -> tuple[int, Direction] | None:
    told = looking.frame(data, 2, burst_over)
    return None if told is None else (told[0], told[1].direction)


def test_frame_is_found_when_a_silence_or_a_byte_follows() -> None:
    looking = front()
    assert taken(looking, READ, burst_over=False) is None
    assert looking.needed == len(READ) + 1
    assert taken(looking, READ + OTHER[:1], burst_over=False) == (len(READ), REQUEST)
    assert taken(front(READ), ANSWER) == (len(ANSWER), RESPONSE)
    assert taken(front(READ), REFUSAL) == (len(REFUSAL), RESPONSE)


def test_after_a_restart_the_size_is_measured_again() -> None:
    looking = front()
    assert taken(looking, READ[:4]) is None
    looking.restart(0, behind_noise=False)
    assert taken(looking, OTHER) == (len(OTHER), REQUEST)


def test_response_that_nobody_requested_needs_a_search() -> None:
    assert taken(front(), ANSWER) is None
    assert taken(front(OTHER), ANSWER) is None


def test_known_request_needs_no_search_though_another_is_pending() -> None:
    assert taken(front(READ, ANSWER, OTHER), READ) == (len(READ), REQUEST)
    behind_noise = front(READ, ANSWER, OTHER)
    behind_noise.restart(0, behind_noise=True)
    assert taken(behind_noise, READ) is None


def test_request_that_may_begin_the_response_that_is_due_needs_a_search() -> None:
    assert taken(front(READ, ANSWER, READ), READ) is None


def test_request_whose_crc_ends_in_zero_is_not_the_shorter_response_in_it() -> None:
    """Its CRC is correct after seven bytes and after eight."""
    raw = next(
        raw
        for quantity in range(1, 256)
        if (raw := rtu_adu(1, bytes((1, 2, 7, 0, quantity))))[-1] == 0
    )
    pair = raw, rtu_adu(1, bytes.fromhex("01 02 FFFF"))
    assert taken(front(*pair), raw) == (len(raw), REQUEST)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_beginning_of_the_frame_that_is_due_is_incomplete(size: int) -> None:
    assert front(READ).is_incomplete(ANSWER[:size], ())
    assert front(READ, ANSWER).is_incomplete(READ[:size], ())


def test_bytes_that_are_not_due_need_a_search() -> None:
    assert not front().is_incomplete(READ[:5], ())
    assert not front(READ).is_incomplete(OTHER[:5], ())
    assert not front(READ, speaker=RESPONSE).is_incomplete(ANSWER[:5], ())
    assert not front(READ).is_incomplete(ANSWER, ())


def test_complete_frame_after_a_silence_ends_the_wait_for_an_incomplete_one() -> None:
    data = ANSWER[:3] + OTHER
    long_read = rtu_adu(1, bytes.fromhex("03 0000 0014"))
    head = rtu_adu(1, bytes.fromhex("03 28") + bytes(40))[:3]
    assert front(long_read).is_incomplete(head + b"\x01\x02", (3,))
    assert not front(long_read).is_incomplete(head + OTHER, (3,))
    assert not front(READ).is_incomplete(data, (3,))


def test_known_speaker_decides_the_direction() -> None:
    told = front(speaker=RESPONSE).frame(ANSWER, 2, True)
    assert told is not None
    assert (told[1].direction, told[1].by, told[1].confidence) == (RESPONSE, DirectionBy.PORT, 1.0)


# How many bytes are needed.


def needed(data: bytes, *heard: bytes) -> int:
    looking = front(*heard)
    looking.frame(data, 2, False)
    return looking.needed


def test_one_byte_more_than_the_longest_frame_is_needed() -> None:
    assert FastPath(BusModel(), None, MOST).needed == 4
    assert needed(READ[:4]) == len(READ) + 1
    longer = rtu_adu(1, bytes.fromhex("03 08 0001 0002 0003 0004"))
    assert needed(longer[:4]) == len(longer) + 1
    assert needed(REFUSAL[:4]) == len(REFUSAL) + 1


def test_one_byte_more_is_needed_as_long_as_no_byte_tells_the_size() -> None:
    write = rtu_adu(1, bytes.fromhex("10 0000 0002 04 0001 0002"))
    assert [needed(write[:size]) for size in (4, 5, 6, 7)] == [5, 6, 7, len(write) + 1]


def test_search_decides_about_a_function_without_a_size() -> None:
    assert needed(b"\x01\x41\x00\x00") == MOST
    looking = front()
    assert taken(looking, b"\x01\x41\x00\x00") is None
    looking.restart(0, behind_noise=False)
    assert looking.needed == 4


def test_frame_of_256_bytes_is_found_and_one_of_257_needs_a_search() -> None:
    for count, size in ((250, 255), (251, None), (252, None)):
        asked = rtu_adu(1, bytes((3, 0, 0, 0, count // 2)))
        answer = rtu_adu(1, bytes((3, count)) + bytes(range(count)))
        told = taken(front(asked), answer)
        assert (told and told[0]) == size
    custom = rtu_adu(1, bytes((0x01, 251)) + bytes(251))
    assert needed(custom) == len(custom) + 1
    assert needed(rtu_adu(1, bytes((0x01, 252)) + bytes(252))) == len(READ) + 1


def test_frame_with_a_wrong_crc_needs_a_search() -> None:
    assert taken(front(), READ[:-1] + b"\x00") is None
    assert taken(front(READ), ANSWER[:-1]) is None


def test_new_request_costs_no_more_than_the_fast_path_takes() -> None:
    assert taken(front(READ, ANSWER), OTHER) == (len(OTHER), REQUEST)
    odd = rtu_adu(2, bytes.fromhex("04 0000 0000"))
    assert taken(front(READ, ANSWER), odd) is None
    assert taken(front(READ), odd) is None


def test_request_by_its_form_needs_no_search_behind_one_without_a_response() -> None:
    """A scan of units that are not there."""
    assert taken(front(READ), OTHER) == (len(OTHER), REQUEST)
    same_unit = rtu_adu(READ[0], bytes((READ[1],)) + bytes.fromhex("0064 0001"))
    assert taken(front(READ), same_unit) is None


def test_without_silences_a_response_needs_another_frame_after_it() -> None:
    """Two equal frames may be a request and its retry."""
    write = rtu_adu(5, bytes.fromhex("06 0001 0003"))
    for following, is_taken in ((READ, True), (write, False), (write[:2], False), (b"\x05", False)):
        bus_model = BusModel()
        bus_model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), 5, write[1:-2], 0, 1)
        bus_model.history.trusts_silences = False
        told = taken(FastPath(bus_model, None, MOST), write + following)
        assert (told is not None) is is_taken, following


def test_bytes_with_a_wrong_crc_after_a_silence_do_not_end_the_wait() -> None:
    asked = rtu_adu(1, bytes.fromhex("03 0000 0014"))
    head = b"\x01\x03\x28"
    assert front(asked).is_incomplete(head + OTHER[:-1] + b"\x00", (3,))
    assert front(asked).is_incomplete(head + OTHER[:-1], (3,))
    assert not front(asked).is_incomplete(head + OTHER, (1, 3))
    assert front(asked).is_incomplete(head + OTHER, (2, 4))
