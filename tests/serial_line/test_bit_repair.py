"""The one wrong bit of a frame."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.modbus.adu import crc, crc_on, rtu_adu
from mbtool.serial_line.candidates import repaired

pdus = st.binary(min_size=1, max_size=253)


@given(unit=st.integers(0, 255), pdu=pdus, data=st.data())
def test_wrong_bit_is_found_wherever_it_is(unit: int, pdu: bytes, data: st.DataObject) -> None:
    frame = rtu_adu(unit, pdu)
    at, bit = data.draw(st.integers(0, len(frame) - 1)), data.draw(st.integers(0, 7))
    damaged = bytearray(frame)
    damaged[at] ^= 1 << bit
    assert repaired(bytes(damaged)) == frame


@given(frame=st.binary(min_size=4, max_size=256))
def test_repaired_frame_differs_in_one_bit_and_is_correct(frame: bytes) -> None:
    whole = repaired(frame)
    if whole is not None:
        assert repaired(whole) is None
        differing = int.from_bytes(frame) ^ int.from_bytes(whole)
        assert differing.bit_count() == 1


def test_two_wrong_bits_of_a_short_frame_are_not_repaired() -> None:
    frame = bytearray(rtu_adu(1, bytes.fromhex("03 0000 0001")))
    frame[2] ^= 0x41
    assert repaired(bytes(frame)) is None


def test_wrong_bit_before_the_first_byte_repairs_nothing() -> None:
    """Its remainder is that of no bit of the frame."""
    frame = rtu_adu(1, bytes.fromhex("03 0000 0002"))
    before = {crc_on(0, bytes([1 << bit]) + bytes(len(frame))) for bit in range(8)}
    damaged = [
        whole for last in range(0x10000) if crc(whole := frame[:-2] + last.to_bytes(2)) in before
    ]
    assert len(damaged) == 8
    assert [repaired(one) for one in damaged] == [None] * 8
