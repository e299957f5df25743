"""The identity that a device reports."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.modbus.adu import Transport, mbap_adu, rtu_adu
from mbtool.modbus.identification import Identity, identities, text_of
from tests.devices.transactions import transaction

# MODBUS Application Protocol V1.1b3, 6.21: the first response of the example.
OBJECTS = bytes.fromhex(
    "2b 0e 01 01 00 00 03"  # read code 1, conformity 1, no more follows, next 0, three objects
    "00 16"
) + b"Company identification" + bytes.fromhex("01 0d") + b"Product code " + bytes.fromhex(
    "02 05"
) + b"V2.11"  # fmt: skip


def said(pdu: bytes, transport: Transport = Transport.RTU) -> list[Identity]:
    raw = mbap_adu(1, 5, pdu) if transport is Transport.TCP else rtu_adu(5, pdu)
    return identities(transaction(pdu[0] & 0x7F, transport=transport, response_raw=raw))


@pytest.mark.parametrize("transport", [Transport.RTU, Transport.TCP])
def test_objects_of_2b_have_the_names_of_the_standard(transport: Transport) -> None:
    assert said(OBJECTS, transport) == [
        Identity("vendor", "Company identification", 0),
        Identity("product code", "Product code", 1),
        Identity("revision", "V2.11", 2),
    ]


def test_an_object_of_the_makers_own_is_called_by_its_id() -> None:
    pdu = bytes.fromhex("2b 0e 03 83 00 00 01 80 02 41 01")
    assert said(pdu) == [Identity("object 80H", "A\\x01", 0x80)]


def test_only_whole_objects_of_a_cut_response_count() -> None:
    assert said(OBJECTS[:-2]) == [
        Identity("vendor", "Company identification", 0),
        Identity("product code", "Product code", 1),
    ]


def test_a_server_id_has_its_run_indicator_and_text() -> None:
    assert said(bytes.fromhex("11 09 1a ff") + b"Touch 1") == [
        Identity("server id", "1a"),
        Identity("run indicator", "on"),
        Identity("additional data", "Touch 1"),
    ]


def test_a_server_id_may_be_a_text_before_the_run_indicator() -> None:
    assert said(bytes.fromhex("11 06") + b"PLC-1\x00") == [
        Identity("server id", "PLC-1"),
        Identity("run indicator", "off"),
    ]


def test_a_server_id_without_run_indicator_is_one_property() -> None:
    assert said(bytes.fromhex("11 02 01 02")) == [Identity("server id", "01 02")]


@pytest.mark.parametrize("pdu", ["91 01", "11 00", "2b 0d 01 02", "ab 01", "03 02 00 01"])
def test_other_responses_have_no_identity(pdu: str) -> None:
    assert said(bytes.fromhex(pdu)) == []


def test_an_exception_and_a_missing_response_have_no_identity() -> None:
    assert identities(transaction(0x2B)) == []
    raw = rtu_adu(5, b"\xab\x01")
    assert identities(transaction(0x2B, exception=1, response_raw=raw)) == []


@given(st.sampled_from([0x11, 0x2B]), st.sampled_from(list(Transport)), st.binary(max_size=300))
def test_no_response_raises(function: int, transport: Transport, raw: bytes) -> None:
    for one in identities(transaction(function, transport=transport, response_raw=raw)):
        assert one.text.isascii()
        assert one.text.isprintable()


def test_a_text_has_printable_ascii_only() -> None:
    assert text_of(b"Caf\xe9 \x1b[0m \x00\x00") == "Caf\\xe9 \\x1b[0m"


def test_the_objects_of_the_standard_have_names() -> None:
    # MODBUS Application Protocol V1.1b3, 6.21.
    objects = b"".join(bytes((number, 1, 0x41 + number)) for number in range(8))
    assert said(bytes.fromhex("2b 0e 02 82 00 00 08") + objects) == [
        Identity(name, chr(0x41 + number), number)
        for number, name in enumerate((
            "vendor", "product code", "revision", "vendor URL", "product", "model",
            "application", "object 07H",
        ))
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"AB", "41 42"),
        (b"AB  ", "41 42 20 20"),
        (b"ABC", "ABC"),
        (b"A ~", "A ~"),
        (b"A\x7fC", "41 7f 43"),
        (b"A\x1fC", "41 1f 43"),
    ],
)
def test_three_printable_characters_are_a_text(data: bytes, text: str) -> None:
    assert said(bytes((0x11, len(data))) + data)[0].text == text


def test_the_first_byte_of_a_server_id_is_no_run_indicator() -> None:
    assert said(bytes.fromhex("11 03 00 01 ff")) == [
        Identity("server id", "00 01"),
        Identity("run indicator", "on"),
    ]
    assert said(bytes.fromhex("11 02 ff 00")) == [
        Identity("server id", "ff"),
        Identity("run indicator", "off"),
    ]
    assert said(bytes.fromhex("11 01 ff")) == [Identity("server id", "ff")]


def test_printable_ascii_reaches_from_space_to_tilde() -> None:
    kept = [byte for byte in range(256) if text_of(bytes((0x41, byte, 0x41)))[1:2] == chr(byte)]
    assert kept == [*range(0x20, 0x7F)]
