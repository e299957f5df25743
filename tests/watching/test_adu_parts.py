"""The fields of an ADU by their bytes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus import Transport, ascii_adu, mbap_adu, rtu_adu
from mbtool.watching.adu_parts import adu_parts

READ = bytes.fromhex("03 006b 0003")
ANSWER = bytes.fromhex("03 06 022b 0000 0064")


def named(transport: Transport, raw: bytes, direction: Direction) -> dict[str, str]:
    return {
        one.name: raw[one.begin : one.end].hex() for one in adu_parts(transport, raw, direction)
    }


def test_a_read_over_tcp() -> None:
    assert named(Transport.TCP, mbap_adu(7, 17, READ), Direction.REQUEST) == {
        "transaction id": "0007",
        "protocol id": "0000",
        "length": "0006",
        "unit": "11",
        "function": "03",
        "address": "006b",
        "quantity": "0003",
    }


def test_an_answer_on_a_line() -> None:
    parts = named(Transport.RTU, rtu_adu(17, ANSWER), Direction.RESPONSE)
    assert list(parts) == ["unit", "function", "byte count", "data", "CRC"]
    assert (parts["byte count"], parts["data"]) == ("06", "022b00000064")


def test_a_write_of_several_coils_has_a_byte_count() -> None:
    raw = rtu_adu(1, bytes.fromhex("0f 0013 000a 02 cd01"))
    parts = named(Transport.RTU, raw, Direction.REQUEST)
    assert (parts["byte count"], parts["data"]) == ("02", "cd01")


def test_an_exception() -> None:
    parts = named(Transport.RTU, rtu_adu(1, b"\x83\x02"), Direction.RESPONSE)
    assert (parts["function"], parts["exception code"]) == ("83", "02")


def test_an_ascii_frame_has_two_digits_a_byte() -> None:
    raw = ascii_adu(17, READ)
    parts = adu_parts(Transport.ASCII, raw, Direction.REQUEST)
    texts = [(one.name, raw[one.begin : one.end]) for one in parts]
    assert texts == [
        ("start", b":"),
        ("unit", b"11"),
        ("function", b"03"),
        ("address", b"006B"),
        ("quantity", b"0003"),
        ("LRC", b"7E"),
        ("end", b"\r\n"),
    ]


@given(st.sampled_from(Transport), st.binary(max_size=40), st.sampled_from(Direction))
def test_the_parts_are_all_bytes_in_order_whatever_they_are(
    transport: Transport, raw: bytes, direction: Direction
) -> None:
    parts = adu_parts(transport, raw, direction)
    assert b"".join(raw[one.begin : one.end] for one in parts) == raw
    assert all(one.begin < one.end for one in parts)


@given(st.binary(max_size=40), st.sampled_from(Direction))
def test_the_parts_of_hexadecimal_text_are_all_its_bytes(body: bytes, direction: Direction) -> None:
    raw = b":" + body.hex().upper().encode() + b"\r\n"
    parts = adu_parts(Transport.ASCII, raw, direction)
    assert b"".join(raw[one.begin : one.end] for one in parts) == raw
