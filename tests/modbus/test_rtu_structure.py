"""What an RTU frame's bytes say about its size."""

from __future__ import annotations

import pytest

from mbtool.core import Direction, EventKind
from mbtool.modbus import rtu_adu
from mbtool.modbus.rtu_structure import frame_size, why_skipped

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
    ],
)
def test_size_follows_from_the_first_bytes(
    head: str, direction: Direction, size: int | None
) -> None:
    assert frame_size(bytes.fromhex(head), direction) == size


def test_frame_with_a_wrong_crc_is_told_with_both_values() -> None:
    frame = bytes.fromhex("11 03 006B 0003 7688")
    assert why_skipped(frame, [REQUEST]) == (
        EventKind.BAD_CHECK,
        "a frame with CRC 8876H, where 8776H would be right",
    )


def test_other_bytes_are_no_frame() -> None:
    good = rtu_adu(0x11, bytes.fromhex("03 006B 0003"))
    for data in (b"\x11\x03\x00", b"\xff" * 8, good + b"\x00", good):
        assert why_skipped(data, [REQUEST]) == (
            EventKind.SKIPPED,
            "no frame with a correct CRC begins here",
        )
