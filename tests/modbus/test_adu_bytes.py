"""The ADUs of each transport, and their checks."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.modbus.adu import ascii_adu, crc, lrc, mbap_adu, rtu_adu
from tests.strategies import UNIT

READ = bytes.fromhex("03 006B 0003")


def test_check_values_are_the_published_ones() -> None:
    assert crc(b"123456789") == 0x4B37
    assert lrc(bytes.fromhex("02 01 0064 0001")) == 0x98


def test_the_lrc_makes_the_sum_of_all_bytes_0() -> None:
    for byte in range(256):
        for data in (bytes([byte]), bytes([byte, 0xFF, 0x80]), b"\xff" * byte):
            assert 0 <= lrc(data) <= 0xFF
            assert (sum(data) + lrc(data)) % 256 == 0


def test_each_transport_makes_its_own_adu() -> None:
    assert rtu_adu(0x11, READ) == bytes.fromhex("11 03 006B 0003 7687")
    assert ascii_adu(0x11, READ) == b":1103006B00037E\r\n"
    assert mbap_adu(0x1234, 0x11, READ) == bytes.fromhex("1234 0000 0006 11 03 006B 0003")


@given(UNIT, st.binary(min_size=1, max_size=253))
def test_crc_over_a_frame_with_its_crc_is_0(unit: int, pdu: bytes) -> None:
    assert crc(rtu_adu(unit, pdu)) == 0


@given(UNIT, st.binary(min_size=1, max_size=253), st.integers(1, 3))
def test_zeros_behind_a_frame_keep_its_crc_valid(unit: int, pdu: bytes, zeros: int) -> None:
    assert crc(rtu_adu(unit, pdu) + bytes(zeros)) == 0


def test_unit_that_is_no_byte_is_refused() -> None:
    for frame in (rtu_adu, ascii_adu):
        with pytest.raises(ValueError, match="256"):
            frame(256, READ)
