"""One frame of an ASCII line, and what is unusual or wrong about it."""

from __future__ import annotations

import pytest

from mbtool.modbus.adu import (
    CR,
    LF,
    SEVEN_BITS,
    AsciiFrame,
    Checksum,
    ascii_adu,
    read_frame,
    why_unreadable,
)
from tests.modbus.reading import with_parity

FRAME = b":02010064000198\r\n"  # CHINO LT830, INE-350, 6.5.1: unit 2 reads digital parameter 101.
BODY = bytes.fromhex("02 01 0064 0001")


def read(raw: bytes, *, eight_bits: bool = True) -> AsciiFrame:
    frame = read_frame(raw, eight_bits=eight_bits)
    assert frame is not None
    return frame


def test_frame_has_digits_an_end_a_body_and_a_checksum() -> None:
    assert read(FRAME) == AsciiFrame(b"02010064000198", b"\r\n", BODY, Checksum(0x98, 0x98), False)


@pytest.mark.parametrize("end", [b"\r\n", b"\r", b"\n", b"\r.", b"\r\x00", b"\r\r", b"\r0"])
def test_frame_may_end_in_many_ways(end: bytes) -> None:
    frame = read(b":02010064000198" + end)
    assert (frame.body, frame.end, frame.checksum.ok) == (BODY, end, True)


@pytest.mark.parametrize("end", [b"", b"\n\n", b"\r\n\n", b"\r:", b"\n\r", b"."])
def test_frame_does_not_end_in_every_way(end: bytes) -> None:
    assert read_frame(b":02010064000198" + end) is None


def test_digits_may_be_lower_case() -> None:
    frame = read(b":02010100fc\r\n")
    assert (frame.is_lower_case, frame.checksum.ok) == (True, True)
    assert not read(b":02010100FC\r\n").is_lower_case
    assert not read(FRAME).is_lower_case


@pytest.mark.parametrize("parity", ["even", "odd", "mark"])
def test_parity_in_bit_7_is_removed_if_the_port_has_8_bits(parity: str) -> None:
    heard = with_parity(FRAME, parity)
    frame = read(heard)
    assert (frame.body, frame.end, frame.checksum.ok) == (BODY, b"\r\n", True)
    assert frame.parity_in_data
    assert read_frame(heard, eight_bits=False) is None


def test_bit_7_that_is_no_parity_is_damage() -> None:
    damaged = bytearray(with_parity(FRAME, "even"))
    damaged[5] ^= 0x80
    assert read_frame(bytes(damaged)) is None
    damaged = bytearray(FRAME)
    damaged[5] |= 0x80
    assert read_frame(bytes(damaged)) is None
    assert not read(FRAME).parity_in_data


def test_delimiter_of_8_bits_is_no_parity() -> None:
    assert not read(b":02010064000198\r\xff").parity_in_data


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b":020G0064000198\r\n", "'G' (47H) as its character 5, where a hexadecimal digit"),
        (b":02 10064000198\r\n", "20H as its character 4, where a hexadecimal digit"),
        (b":02\xb110064000198\r\n", "B1H as its character 4, where"),
        (b":0201\r0064000198\r\n", "0DH as its character 6, where"),
        (b":0201006400019\r\n", "13 hexadecimal digits, where two make a byte"),
        (b":0201006400019\n", "13 hexadecimal digits, where two make a byte"),
        (b":0201006400019\r.", "13 hexadecimal digits, where two make a byte"),
        (b":0201\r\n", "2 bytes, where unit, function and LRC are 3 at least"),
        (b":\n", "0 bytes, where unit, function and LRC are 3 at least"),
    ],
)
def test_the_reason_names_the_error_and_its_place(raw: bytes, reason: str) -> None:
    assert read_frame(raw) is None
    assert why_unreadable(raw).startswith(f"a frame with {reason}")


def test_the_reason_names_characters_without_their_parity() -> None:
    heard = with_parity(b":020G0064000198\r\n", "even")
    assert why_unreadable(heard).startswith("a frame with 'G' (47H) as its character 5, ")
    assert why_unreadable(heard, eight_bits=False).startswith("a frame with B2H as its character 3")


@pytest.mark.parametrize(
    ("character", "shown"),
    [(0x1F, "1FH"), (0x20, "20H"), (0x21, "'!' (21H)"), (0x7E, "'~' (7EH)"), (0x7F, "7FH")],
)
def test_only_a_visible_character_is_shown_as_itself(character: int, shown: str) -> None:
    reason = why_unreadable(b":02" + bytes([character]) + b"064000198\r\n")
    assert reason.startswith(f"a frame with {shown} as its character 4, ")


def test_the_shortest_frame_has_a_unit_a_function_and_an_lrc() -> None:
    assert read(b":0107F8\r\n").body == b"\x01\x07"
    assert read_frame(b":01FF\r\n") is None


@pytest.mark.parametrize("delimiter", [0x00, 0x01, 0x7F])
def test_a_bit_that_is_always_set_is_a_stop_bit_at_any_character(delimiter: int) -> None:
    heard = with_parity(FRAME[:-1] + bytes([delimiter]), "mark")
    frame = read(heard)
    assert (frame.end, frame.parity_in_data) == (bytes([0x0D, delimiter]), True)
    # One character without the bit, and with another parity than others.
    for clear in (0x7F, 0x00):
        assert read_frame(heard[:-1] + bytes([clear])) is None


def test_the_characters_of_a_frame_have_the_codes_of_ascii() -> None:
    assert ascii_adu(1, b"\x07")[-2:] == bytes((CR, LF))
    assert bytes(range(256)).translate(SEVEN_BITS) == bytes(range(128)) * 2
