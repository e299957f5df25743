"""The size of an RTU frame by its bytes."""

from __future__ import annotations

import pytest

from mbtool.core import Direction, EventKind
from mbtool.framing.rtu_lengths import crc_ends, frame_size, why_skipped
from mbtool.modbus.adu import Checksum
from mbtool.modbus.adu_bytes import crc, rtu_adu

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
    assert crc_ends(frame + b"\x01\x02", most=3) == [7]
    assert crc_ends(frame + b"\x00\x00\x01", most=3) == [7, 8, 9]
    assert crc_ends(frame + bytes(9), most=2) == [7, 8]


def test_crc_is_right_one_byte_before_the_end_of_a_frame_that_ends_in_zero() -> None:
    frame = bytes.fromhex("01 04 02 0301 7800")
    assert crc_ends(frame, most=3) == [6, 7]


@pytest.mark.parametrize("size", range(5))
def test_crc_needs_four_bytes(size: int) -> None:
    shortest = rtu_adu(1, b"\x07")
    assert crc_ends(shortest[:size], most=3) == [4] * (size == 4)


def test_the_crc_confirms_each_end() -> None:
    data = bytes(range(200)) + rtu_adu(3, bytes(range(200))) * 2
    for place in range(len(data)):
        ends = crc_ends(data[place : place + 256], most=256)
        assert ends == [
            size for size in range(4, len(data[place:][:256]) + 1)
            if crc(data[place : place + size]) == 0
        ]  # fmt: skip
