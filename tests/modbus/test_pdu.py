"""PDUs: each row of the standard's table, parsed and encoded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction
from mbtool.modbus.adu import Transport
from mbtool.modbus.pdu import encode_pdu, exception_pdu, parse_pdu, pdu_length, pdu_of, whole_pdu
from tests.modbus.reading import with_parity

if TYPE_CHECKING:
    from mbtool.modbus.layouts import Value

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE

# Examples of V1.1b3, section 6, where it has one.
ROWS: list[tuple[str, Direction, dict[str, Value]]] = [
    ("01 0013 0013", REQUEST, {"address": 0x13, "quantity": 0x13}),
    ("01 01 05", RESPONSE, {"values": (1, 0, 1, 0, 0, 0, 0, 0)}),
    ("02 00C4 0016", REQUEST, {"address": 0xC4, "quantity": 0x16}),
    ("02 01 80", RESPONSE, {"values": (0, 0, 0, 0, 0, 0, 0, 1)}),
    ("03 006B 0003", REQUEST, {"address": 0x6B, "quantity": 3}),
    ("03 06 022B 0000 0064", RESPONSE, {"values": (0x22B, 0, 0x64)}),
    ("04 0008 0001", REQUEST, {"address": 8, "quantity": 1}),
    ("04 02 000A", RESPONSE, {"values": (10,)}),
    ("05 00AC FF00", REQUEST, {"address": 0xAC, "value": 0xFF00}),
    ("05 00AC FF00", RESPONSE, {"address": 0xAC, "value": 0xFF00}),
    ("06 0001 0003", REQUEST, {"address": 1, "value": 3}),
    ("06 0001 0003", RESPONSE, {"address": 1, "value": 3}),
    ("07", REQUEST, {}),
    ("07 6D", RESPONSE, {"status": 0x6D}),
    ("08 0000 A537", REQUEST, {"sub_function": 0, "values": (0xA537,)}),
    ("08 0000 A537 0001", REQUEST, {"sub_function": 0, "values": (0xA537, 1)}),
    ("08 0000 A537", RESPONSE, {"sub_function": 0, "values": (0xA537,)}),
    ("0B", REQUEST, {}),
    ("0B FFFF 0108", RESPONSE, {"status": 0xFFFF, "event_count": 0x108}),
    ("0C", REQUEST, {}),
    ("0C 08 0000 0108 0121 2000", RESPONSE, {"data": bytes.fromhex("0000010801212000")}),
    (
        "0F 0013 000A 02 CD01",
        REQUEST,
        {"address": 0x13, "quantity": 10, "values": (1, 0, 1, 1, 0, 0, 1, 1, 1, 0)},
    ),
    ("0F 0013 000A", RESPONSE, {"address": 0x13, "quantity": 10}),
    ("10 0001 0002 04 000A 0102", REQUEST, {"address": 1, "quantity": 2, "values": (10, 0x102)}),
    ("10 0001 0002", RESPONSE, {"address": 1, "quantity": 2}),
    ("11", REQUEST, {}),
    ("11 03 01 FF 00", RESPONSE, {"data": b"\x01\xff\x00"}),
    ("14 0E 06000400010002 06000300090002", REQUEST, {"groups": ((4, 1, 2), (3, 9, 2))}),
    (
        "14 0C 05 06 0DFE0020 05 06 33CD0040",
        RESPONSE,
        {"groups": (((0x0DFE, 0x20),), ((0x33CD, 0x40),))},
    ),
    ("15 0D 06000400070003 06AF04BE100D", REQUEST, {"groups": ((4, 7, (0x6AF, 0x4BE, 0x100D)),)}),
    ("15 0D 06000400070003 06AF04BE100D", RESPONSE, {"groups": ((4, 7, (0x6AF, 0x4BE, 0x100D)),)}),
    ("16 0004 00F2 0025", REQUEST, {"address": 4, "and_mask": 0xF2, "or_mask": 0x25}),
    ("16 0004 00F2 0025", RESPONSE, {"address": 4, "and_mask": 0xF2, "or_mask": 0x25}),
    (
        "17 0003 0006 000E 0003 06 00FF 00FF 00FF",
        REQUEST,
        {
            "address": 3,
            "quantity": 6,
            "write_address": 14,
            "write_quantity": 3,
            "values": (255, 255, 255),
        },
    ),
    ("17 04 00FE 0ACD", RESPONSE, {"values": (0xFE, 0xACD)}),
    ("18 04DE", REQUEST, {"address": 0x4DE}),
    ("18 0006 0002 01B8 1284", RESPONSE, {"fifo": (2, 0x1B8, 0x1284)}),
    ("2B 0D 0102", REQUEST, {"mei_type": 0x0D, "data": b"\x01\x02"}),
    ("2B 0D 0102", RESPONSE, {"mei_type": 0x0D, "data": b"\x01\x02"}),
    ("2B 0E 01 00", REQUEST, {"mei_type": 0x0E, "read_code": 1, "object_id": 0}),
    (
        "2B 0E 01 01 00 00 02 00 03 414243 01 02 5859",
        RESPONSE,
        {
            "mei_type": 0x0E,
            "read_code": 1,
            "conformity": 1,
            "more_follows": 0,
            "next_object_id": 0,
            "objects": ((0, b"ABC"), (1, b"XY")),
        },
    ),
    ("83 02", RESPONSE, {"exception_code": 2}),
    ("C1 11", RESPONSE, {"exception_code": 0x11}),
    ("41 00", REQUEST, {"data": b"\x00"}),
    ("42 0016", RESPONSE, {"data": b"\x00\x16"}),
]


@pytest.mark.parametrize(("pdu", "direction", "fields"), ROWS, ids=str)
def test_pdu_is_parsed_and_encoded(
    pdu: str, direction: Direction, fields: dict[str, Value]
) -> None:
    raw = bytes.fromhex(pdu)
    parsed = parse_pdu(raw, direction)
    assert (parsed.code, parsed.fields, parsed.problem) == (raw[0], fields, None)
    assert encode_pdu(raw[0], direction, **fields) == raw


@pytest.mark.parametrize(
    ("pdu", "direction", "length"),
    [  # The lengths of RTU frames less unit and CRC.
        *((f"{code:02X}", REQUEST, 5) for code in (1, 2, 3, 4, 5, 6, 8)),
        *((f"{code:02X}", REQUEST, 1) for code in (0x07, 0x0B, 0x0C, 0x11)),
        *((f"{code:02X}", RESPONSE, 5) for code in (0x05, 0x06, 0x08, 0x0B, 0x0F, 0x10)),
        *((f"{code:02X} 0A", RESPONSE, 12) for code in (1, 2, 3, 4, 0x0C, 0x11, 0x14, 0x15, 0x17)),
        *((f"{code:02X} 0A", REQUEST, 12) for code in (0x14, 0x15)),
        *((f"{code:02X} 0000 0000 0A", REQUEST, 16) for code in (0x0F, 0x10)),
        ("07", RESPONSE, 2),
        ("16", REQUEST, 7),
        ("16", RESPONSE, 7),
        ("17 0000 0000 0000 0000 0A", REQUEST, 20),
        ("18", REQUEST, 3),
        ("18 0102", RESPONSE, 3 + 0x102),
        ("2B 0E", REQUEST, 4),
        ("2B 0E 01 01 00 00 02 00 03 414243 01 02", RESPONSE, 16),
        ("83", RESPONSE, 2),
        ("E4", RESPONSE, 2),
        ("83", REQUEST, 0),
        ("41 00", REQUEST, 0),
        ("2B 0D 00", REQUEST, 0),
        ("2B 99", RESPONSE, 0),
        ("", REQUEST, None),
        ("01", RESPONSE, None),
        ("0F 0000 0000", REQUEST, None),
        ("18 00", RESPONSE, None),
        ("2B", REQUEST, None),
    ],
)
def test_length_follows_from_the_first_bytes(
    pdu: str, direction: Direction, length: int | None
) -> None:
    assert pdu_length(bytes.fromhex(pdu), direction) == length


def test_quantities_follow_from_the_values_where_they_are_left_out() -> None:
    assert encode_pdu(0x0F, REQUEST, address=0, values=(1, 0, 1)).hex(" ") == "0f 00 00 00 03 01 05"
    assert encode_pdu(0x10, REQUEST, address=0, values=(7,)).hex(" ") == "10 00 00 00 01 02 00 07"
    both = encode_pdu(0x17, REQUEST, address=0, quantity=9, write_address=1, values=(7,))
    assert parse_pdu(both, REQUEST).number("write_quantity") == 1


def test_fault_of_a_write_is_reported_and_its_values_are_kept() -> None:
    # Two registers behind a quantity of one.
    parsed = parse_pdu(bytes.fromhex("10 00F2 0001 04 0258 000A"), REQUEST)
    assert parsed.problem == "2 registers for a quantity of 1"
    assert parsed.numbers() == (600, 10)


def test_pdu_that_is_empty_or_too_large_is_reported() -> None:
    assert parse_pdu(b"", REQUEST).problem == "no function code"
    assert parse_pdu(bytes([0x41]) * 253, REQUEST).problem is None
    assert parse_pdu(bytes([0x41]) * 254, REQUEST).problem == (
        "254 bytes, where a PDU has at most 253"
    )


def test_exception_response_without_its_code_is_reported() -> None:
    parsed = parse_pdu(b"\x83", RESPONSE)
    assert (parsed.function, parsed.exception_code) == (3, None)
    assert parsed.problem == "1 bytes, where its function has 2"


def test_number_is_none_for_a_field_that_is_no_number() -> None:
    parsed = parse_pdu(bytes.fromhex("03 02 1234"), RESPONSE)
    assert parsed.numbers() == (0x1234,)
    assert parsed.number("values") is None
    assert parsed.number("address") is None
    assert parsed.numbers("groups") is None


@pytest.mark.parametrize(
    ("code", "fields", "problem"),
    [
        (256, {}, r"not in 0\.\.255"),
        (3, {"address": 1}, "'quantity' is missing"),
        (6, {"address": 65536, "value": 0}, "does not fit"),
        (0x41, {"data": b"x" * 253}, "254 bytes, where a PDU has at most 253"),
        (0x10, {"address": 0, "values": (0,) * 124}, "254 bytes"),
    ],
)
def test_pdu_that_cannot_be_sent_is_refused(
    code: int, fields: dict[str, Value], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        encode_pdu(code, REQUEST, **fields)


def test_exception_response_names_function_and_code() -> None:
    assert exception_pdu(0x10, 3) == b"\x90\x03"


@pytest.mark.parametrize(
    ("transport", "raw"),
    [
        (Transport.TCP, bytes.fromhex("0001 0000 0006 11 03 006B 0003")),
        (Transport.RTU, bytes.fromhex("11 03 006B 0003 7687")),
        (Transport.RTU_TCP, bytes.fromhex("11 03 006B 0003 7687")),
        (Transport.ASCII, b":1103006B00037E\r\n"),
        (Transport.ASCII, b":1103006b00037e\r"),
        (Transport.ASCII, with_parity(b":1103006B00037E\r\n", "even")),
    ],
)
def test_adu_of_any_transport_has_a_unit_and_a_pdu(transport: Transport, raw: bytes) -> None:
    assert pdu_of(transport, raw) == (0x11, bytes.fromhex("03 006B 0003"))


@pytest.mark.parametrize("transport", Transport)
@pytest.mark.parametrize("raw", [None, b"", b"\x01", b":01"])
def test_an_adu_that_is_cut_short_has_no_pdu(transport: Transport, raw: bytes | None) -> None:
    assert whole_pdu(transport, raw) is None


@pytest.mark.parametrize("direction", [REQUEST, RESPONSE])
def test_length_is_the_same_wherever_the_pdu_begins(direction: Direction) -> None:
    for code in range(256):
        pdu = bytes([code]) + bytes.fromhex("0E 0102 0003 0405 0607 06 0809")
        for size in range(len(pdu) + 1):
            length = pdu_length(pdu[:size], direction)
            assert pdu_length(b"\xff\xff" + pdu[:size], direction, at=2) == length, code


@pytest.mark.parametrize("code", [0, 1, 255, -1, 256])
def test_a_function_code_is_a_byte(code: int) -> None:
    if 0 <= code <= 255:
        fields: dict[str, Value] = {"data": b"x"} if code != 1 else {"address": 0, "quantity": 0}
        assert encode_pdu(code, REQUEST, **fields)[0] == code
    else:
        with pytest.raises(ValueError, match=r"not in 0\.\.255"):
            encode_pdu(code, REQUEST, data=b"x")


def test_an_exception_response_is_one_of_the_function_without_its_highest_bit() -> None:
    for code in range(256):
        parsed = parse_pdu(bytes((code, 4)), RESPONSE)
        assert parsed.function == code % 128
        assert parsed.exception_code == (4 if code >= 128 else None)
        # A request has no exceptions.
        assert parse_pdu(bytes((code, 4)), REQUEST).exception_code is None


def test_an_adu_of_modbus_tcp_is_whole_if_its_length_says_so() -> None:
    adu = bytes.fromhex("0001 0000 0003 11 03 02")
    assert whole_pdu(Transport.TCP, adu) == b"\x03\x02"
    for other in (adu[:-1], adu + b"\0", adu[:7], adu[:4]):
        assert whole_pdu(Transport.TCP, other) is None
    for transport in (Transport.RTU, Transport.RTU_TCP):
        assert whole_pdu(transport, bytes.fromhex("11 07 0000")) == b"\x07"
        assert whole_pdu(transport, bytes.fromhex("11 0000")) is None
