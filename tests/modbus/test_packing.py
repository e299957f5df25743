"""Registers and bits, packed and unpacked."""

from __future__ import annotations

import pytest
from hypothesis import given

from mbtool.modbus.layouts import bit_bytes, pack_bits, pack_words, unpack_bits, words
from tests.strategies import bits, registers


def test_registers_are_big_endian() -> None:
    assert words(bytes.fromhex("1234 00FF")) == (0x1234, 0x00FF)
    assert pack_words([0x1234, 0x00FF]) == bytes.fromhex("1234 00FF")


def test_odd_last_byte_is_no_register() -> None:
    assert words(bytes.fromhex("1234 56")) == (0x1234,)


def test_first_bit_is_bit_0_of_the_first_byte() -> None:
    assert unpack_bits(b"\x01\x80") == (1, *(0,) * 7, *(0,) * 7, 1)
    # V1.1b3, 6.1: coils 27 to 20 are CD, coils 35 to 28 are 6B.
    assert pack_bits([1, 0, 1, 1, 0, 0, 1, 1, 1, 1, 0, 1, 0, 1, 1, 0]) == b"\xcd\x6b"


@given(bits(0, 100))
def test_unpacked_bits_are_the_packed_ones_and_zeros_to_the_end_of_the_byte(
    values: tuple[int, ...],
) -> None:
    packed = pack_bits(values)
    assert len(packed) == bit_bytes(len(values))
    assert unpack_bits(packed) == values + (0,) * (-len(values) % 8)


@given(registers(0, 125))
def test_unpacked_registers_are_the_packed_ones(values: tuple[int, ...]) -> None:
    assert words(pack_words(values)) == values


def test_values_that_are_no_register_or_bit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"0\.\.65535"):
        pack_words([65536])
    with pytest.raises(ValueError, match=r"0\.\.65535"):
        pack_words([-1])
    with pytest.raises(ValueError, match="bits are 0 or 1"):
        pack_bits([0, 2])
