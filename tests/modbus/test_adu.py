"""The sizes of ADUs, and the numbers of their headers."""

from __future__ import annotations

import pytest

from mbtool.modbus.adu import (
    MAX_ASCII_ADU,
    MAX_PDU,
    MAX_RTU_ADU,
    MAX_TCP_ADU,
    MBAP_BYTES,
    RTU_EXTRA_BYTES,
    Checksum,
    Transport,
    ascii_adu,
    crc,
    crc_on,
    mbap_adu,
    mbap_size,
    rtu_adu,
)


def test_the_longest_adu_of_each_transport_is_that_of_the_standard() -> None:
    # V1.1b3, 4.1: 256 and 260 bytes; Serial Line V1.02, 2.5.2.1: 513 characters.
    pdu = bytes(253)
    sizes = [len(adu(1, pdu)) for adu in (rtu_adu, ascii_adu)] + [len(mbap_adu(1, 1, pdu))]
    assert sizes == [256, 513, 260]
    assert (len(pdu), *sizes) == (MAX_PDU, MAX_RTU_ADU, MAX_ASCII_ADU, MAX_TCP_ADU)


def test_an_adu_has_a_header_and_a_check_beside_its_pdu() -> None:
    assert len(rtu_adu(1, b"\x07")) == 1 + RTU_EXTRA_BYTES
    assert len(mbap_adu(1, 1, b"\x07")) == 1 + MBAP_BYTES


@pytest.mark.parametrize("length", [0, 1, 2, 254, 255, 256, 0x0102, 0xFFFF])
def test_the_size_of_a_modbus_tcp_adu_is_in_bytes_4_and_5(length: int) -> None:
    header = b"\xa1\xa2\xa3\xa4" + length.to_bytes(2) + b"\xb1\xb2"
    assert mbap_size(header) == mbap_size(header[:6]) == 6 + length


def test_a_crc_can_be_continued_at_any_byte() -> None:
    frame = rtu_adu(0x11, bytes.fromhex("03 006B 0003"))
    for at in range(len(frame) + 1):
        assert crc_on(crc(frame[:at]), frame[at:]) == 0


def test_a_checksum_is_right_if_both_values_are_equal() -> None:
    assert Checksum(5, 5).ok
    assert not Checksum(5, 6).ok


def test_only_rtu_and_ascii_are_on_a_serial_line() -> None:
    assert [one for one in Transport if one.is_serial] == [Transport.RTU, Transport.ASCII]
