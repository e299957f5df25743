"""The size of an RTU frame by its bytes."""

from __future__ import annotations

import pytest

from mbtool.core import Direction, EventKind
from mbtool.framing.rtu_lengths import (
    MAX_SUMMED,
    CrcSums,
    begins_with_frame,
    frame_size,
    has_frame,
    why_skipped,
)
from mbtool.modbus.adu import Checksum, crc, rtu_adu
from mbtool.modbus.pdu import pdu_length

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@pytest.mark.parametrize(
    ("head", "direction", "size"),
    [
        ("11 03", REQUEST, 8),
        ("11 03 06", RESPONSE, 11),
        ("11 83", RESPONSE, 5),
        ("11 10 0001 0002 04", REQUEST, 13),
        ("11", REQUEST, None),
        ("11 03", RESPONSE, None),
        ("11 41 00", REQUEST, 0),
        ("05 08 0000 A537", REQUEST, 8),
        ("05 08 0000 A537", RESPONSE, 8),
        ("05 18 0006", RESPONSE, 12),
        ("05 07", REQUEST, 4),
        ("05 07", RESPONSE, 5),
    ],
)
def test_size_follows_from_the_first_bytes(
    head: str, direction: Direction, size: int | None
) -> None:
    assert frame_size(bytes.fromhex(head), direction) == size


def test_frame_with_a_wrong_crc_is_reported_with_both_values() -> None:
    frame = bytes.fromhex("11 03 006B 0003 7688")
    assert why_skipped(frame, [REQUEST]) == (
        EventKind.BAD_CHECK,
        "a frame with CRC 8876H, where 8776H would be right",
        Checksum(received=0x8876, computed=0x8776),
    )


def test_frame_with_a_wrong_crc_may_be_either_ones() -> None:
    damaged = bytes.fromhex("11 03 06 022B 0000 0064 C8BB")
    assert why_skipped(damaged, [REQUEST, RESPONSE])[0] is EventKind.BAD_CHECK
    assert why_skipped(damaged, [RESPONSE])[0] is EventKind.BAD_CHECK
    assert why_skipped(damaged, [REQUEST])[0] is EventKind.SKIPPED


def test_other_bytes_are_no_frame() -> None:
    good = rtu_adu(0x11, bytes.fromhex("03 006B 0003"))
    for data in (b"\x11\x03\x00", b"\xff" * 8, good + b"\x00", good):
        assert why_skipped(data, [REQUEST]) == (
            EventKind.SKIPPED,
            "no frame with a correct CRC begins here",
            None,
        )


def test_crc_is_right_at_the_end_of_a_frame_and_at_each_zero_behind_it() -> None:
    frame = bytes.fromhex("01 41 0102 03 1D5D")
    assert CrcSums(frame + b"\x01\x02").sizes(0, most=3) == [7]
    assert CrcSums(frame + b"\x00\x00\x01").sizes(0, most=3) == [7, 8, 9]
    assert CrcSums(frame + bytes(9)).sizes(0, most=2) == [7, 8]


def test_crc_is_right_one_byte_before_the_end_of_a_frame_that_ends_in_zero() -> None:
    frame = bytes.fromhex("01 04 02 0301 7800")
    assert CrcSums(frame).sizes(0, most=3) == [6, 7]


@pytest.mark.parametrize("size", range(5))
def test_crc_needs_four_bytes(size: int) -> None:
    shortest = rtu_adu(1, b"\x07")
    assert CrcSums(shortest[:size]).sizes(0, most=3) == [4] * (size == 4)


def test_the_crc_confirms_each_end() -> None:
    data = bytes(range(100)) + rtu_adu(3, bytes(range(200))) * 2
    assert len(data) <= MAX_SUMMED
    crcs = CrcSums(data)
    for place in range(len(data)):
        ends = crcs.sizes(place, most=256)
        assert ends == [
            size for size in range(4, len(data[place:][:256]) + 1)
            if crc(data[place : place + size]) == 0
        ]  # fmt: skip


_OF_KNOWN_SIZE = [  # PDUs of which the first bytes tell the size, and the direction.
    ("07", REQUEST),  # the shortest frame, 4 bytes
    ("03 006B 0003", REQUEST),
    ("10 0001 0002 04 000A 0102", REQUEST),
    ("83 02", RESPONSE),
    ("03 04 1234 5678", RESPONSE),
    ("18 0006 0002 01B8 1284", RESPONSE),
    ("2B 0E 01 01 00 00 02 00 03 414243 01 02 5859", RESPONSE),
]


@pytest.mark.parametrize(("pdu", "direction"), _OF_KNOWN_SIZE)
def test_a_frame_is_found_wherever_it_begins_and_only_if_it_is_whole(
    pdu: str, direction: Direction
) -> None:
    frame = rtu_adu(0x11, bytes.fromhex(pdu))
    noise = b"\xff" * 5  # The code of an exception response, which the noise is not.
    for before in range(3):
        data = noise[:before] + frame
        assert has_frame(data, [direction])
        assert has_frame(data + noise, [direction])
        assert has_frame(data, [REQUEST, RESPONSE])
        for end in range(len(data)):
            assert not has_frame(data[:end], [direction]), end
        damaged = data[:-1] + bytes([data[-1] ^ 1])
        assert not has_frame(damaged, [direction])
        assert not has_frame(data, [])
    other = RESPONSE if direction is REQUEST else REQUEST
    assert not has_frame(frame, [other])


@pytest.mark.parametrize(("pdu", "direction"), _OF_KNOWN_SIZE)
def test_bytes_begin_with_a_frame_or_not_or_more_are_needed(pdu: str, direction: Direction) -> None:
    frame = rtu_adu(0x11, bytes.fromhex(pdu))
    for end in range(len(frame)):
        assert begins_with_frame(frame[:end], direction) is None
    for behind in (b"", b"x", bytes(300)):
        assert begins_with_frame(frame + behind, direction) is True
        for at in range(len(frame) - 2, len(frame)):
            damaged = frame[:at] + bytes([frame[at] ^ 1]) + frame[at + 1 :]
            assert begins_with_frame(damaged + behind, direction) is False
    assert begins_with_frame(b"\x11\x41\0\0", direction) is False  # no known function


def test_no_frame_is_longer_than_256_bytes() -> None:
    for count, size, is_possible in ((251, 256, True), (252, 257, False)):
        frame = rtu_adu(1, bytes((3, count, *bytes(count))))
        assert len(frame) == size
        assert begins_with_frame(frame[:100], RESPONSE) is (None if is_possible else False)
        assert begins_with_frame(frame[:3], RESPONSE) is (None if is_possible else False)
    # An identification does not tell its size before its last object begins.
    objects = bytes.fromhex("01 2B 0E 01 01 00 00 FF") + bytes(300)
    for size, answer in ((255, None), (256, None), (257, False)):
        assert begins_with_frame(objects[:size], RESPONSE) is answer


def test_a_frame_with_a_wrong_crc_has_the_size_of_its_function() -> None:
    for pdu, direction in _OF_KNOWN_SIZE:
        frame = rtu_adu(0x11, bytes.fromhex(pdu))
        damaged = frame[:-1] + bytes([frame[-1] ^ 1])
        for raw, is_one in (
            (damaged, True), (damaged[:-1], False), (damaged + b"\0", False), (frame, False),
        ):  # fmt: skip
            kind, _, check = why_skipped(raw, [direction])
            assert (kind is EventKind.BAD_CHECK) == is_one
            assert (check is not None) == is_one


def test_the_size_of_a_frame_is_that_of_its_pdu_and_three_bytes_more() -> None:
    for direction in (REQUEST, RESPONSE):
        for code in range(256):
            pdu = bytes([code]) + bytes.fromhex("0E 0102 0003 0405 0607 06 0809")
            for end in range(len(pdu) + 1):
                length = pdu_length(pdu[:end], direction)
                expected = length + 3 if length else length
                assert frame_size(b"\x11" + pdu[:end], direction) == expected
