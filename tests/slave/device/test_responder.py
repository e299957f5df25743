"""A device's answers: its areas, limits and exceptions, and the order of the checks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.devices import (
    Access,
    Area,
    Exceptions,
    FunctionRule,
    Profile,
    builtin_profiles,
    load_profile,
)
from mbtool.modbus import FUNCTIONS, Table, Transport, encode_pdu, parse_pdu
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.device.responder import MAX_KNOWN, DeviceResponder
from mbtool.slave.families import make_device
from tests.cases.worked_examples import WorkedExample, worked_examples

if TYPE_CHECKING:
    from collections.abc import Iterable

READS = (0x01, 0x02, 0x03, 0x04)


def _device(name: str) -> DeviceResponder:
    profile = load_profile(name)
    return make_device(profile, RegisterImage.of(profile))


def _own_device(
    *areas: tuple[Table, int, int, Access], functions: Iterable[str] | dict[str, FunctionRule]
) -> DeviceResponder:
    profile = Profile(
        name="own",
        title="Own",
        vendor="Own",
        transports=[Transport.TCP],
        source="none",
        areas=[
            Area(name=f"area {first}", table=table, first=first, last=last, access=access)
            for table, first, last, access in areas
        ],
        functions=functions
        if isinstance(functions, dict)
        else {function: FunctionRule() for function in functions},
        exceptions=Exceptions(function=0x11, address=0x12, value=0x13, documented=[17, 18, 19]),
    )
    return make_device(profile, RegisterImage())


def _ask(device: DeviceResponder, request: str) -> str | None:
    answer = device.respond(1, bytes.fromhex(request), 0)
    return None if answer is None else answer.pdu.hex(" ")


def _everything(image: RegisterImage) -> list[list[int]]:
    return [image.get(table, 0, 0x10000) for table in Table]


def _examples() -> list[tuple[str, WorkedExample]]:
    return [
        (name, example)
        for example in worked_examples()
        for name in example.devices
        if name in builtin_profiles()
        and example.request
        and not example.foreign
        and example.playable
        if example.response or "41" in example.request_pdu[:1].hex()
    ]


@pytest.mark.parametrize(("name", "example"), _examples(), ids=lambda value: str(value))
def test_answers_as_the_manual_prints(name: str, example: WorkedExample) -> None:
    device = _device(name)
    request, expected = example.request_pdu, example.response_pdu
    if name == "fa3-at1m8x":  # Chapter 10.5: channels 1, 2, 6 and 8 convert.
        for write in ("06 0102 005C", "05 0009 FF00", "05 0009 0000"):
            _ask(device, write)
    if request[0] in READS and not expected[0] & EXCEPTION_BIT:
        table = FUNCTIONS[request[0]].table
        asked = parse_pdu(request, Direction.REQUEST)
        values = parse_pdu(expected, Direction.RESPONSE).numbers() or ()
        address, quantity = asked.number("address"), asked.number("quantity")
        assert table is not None
        assert address is not None
        device.image.set(table, address, values[:quantity])
    answer = device.respond(1, request, 0)
    assert (b"" if answer is None else answer.pdu) == expected


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        # Functions that it lacks.
        ("0F 0000 0008 01 FF", "8f 01"),
        ("07", "87 01"),
        ("2B 0E 01 00", "ab 01"),
        ("83 0000 0001", "83 01"),
        # Beyond its areas, or an address and quantity that reach beyond.
        ("03 1000 0001", "83 02"),
        ("03 0FFF 0002", "83 02"),
        ("01 FFFF 0002", "81 02"),
        ("06 1000 0001", "86 02"),
        # Quantities, counts, values and forms that are wrong: it has no code 03.
        ("03 0000 0000", "83 02"),
        ("03 0000 007E", "83 02"),
        ("01 0000 07D1", "81 02"),
        ("10 0000 0065 CA" + 101 * "0001", "90 02"),
        ("10 0000 0002 02 0001", "90 02"),
        ("10 0000 0001 04 0001 0002", "90 02"),
        ("05 0000 FF01", "85 02"),
        ("03 0000 00", "83 02"),
        ("03 0000 0001 00", "83 02"),
        ("03", "83 02"),
    ],
)
def test_ft1a_gives_the_two_codes_that_its_manual_knows(request_: str, response: str) -> None:
    assert _ask(_device("idec-ft1a-touch"), request_) == response


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("07", "87 01"),
        # Limits, far below the standard's.
        ("01 03E8 0081", "81 03"),
        ("03 0000 0041", "83 03"),
        ("04 0000 0041", "84 03"),
        ("0F 0000 0081 11" + 17 * "00", "8f 03"),
        ("10 0000 0041 82" + 65 * "0000", "90 03"),
        # The data of a write of one bit.
        ("05 0000 0001", "85 03"),
        ("05 0000 FF00", "05 00 00 ff 00"),
        # M1320 of the manual's example is beyond M1277, and so are writes of preset values.
        ("05 0808 FF00", "85 02"),
        ("03 2328 0001", "03 02 00 00"),
        ("06 2328 0001", "86 02"),
        ("10 251C 0001 02 0001", "90 02"),
        ("03 07CF 0002", "83 02"),
    ],
)
def test_smartaxis_gives_the_code_of_each_mistake(request_: str, response: str) -> None:
    assert _ask(_device("idec-ft1a-smartaxis"), request_) == response


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("07", "87 01"),
        ("03 000F 0001", "03 02 00 00"),
        ("03 0010 0001", "83 02"),  # The hole from 0010 to 001F.
        ("03 001F 0001", "83 02"),
        ("03 000F 0002", "83 02"),
        ("03 001F 0002", "83 02"),
        ("03 000F 0012", "83 02"),  # From area to area, over the hole.
        ("03 0020 0001", "03 02 00 00"),
        ("03 4FFF 0001", "03 02 00 00"),
        ("03 4FFF 0002", "83 02"),
        ("02 001F 0001", "02 01 00"),
        ("02 0020 0001", "82 02"),
        ("0F 001F 0002 01 03", "8f 02"),
        ("03 0000 007E", "83 03"),
        ("03 0000 0000", "83 03"),
        ("03 0010 0000", "83 03"),  # The value is checked before the address.
        ("05 0050 1234", "85 03"),
        ("05 0050 FF00", "85 02"),
        ("0F 0000 0008 02 FF 00", "8f 03"),
        ("0F 0000 0009 01 FF", "8f 03"),
        ("42 01", "c2 03"),
        ("41", "c1 03"),
    ],
)
def test_fa3_analog_module_gives_the_code_of_each_mistake(request_: str, response: str) -> None:
    assert _ask(_device("fa3-at1m8x"), request_) == response


def test_fa3_digital_module_has_16_signals() -> None:
    assert _ask(_device("fa3-th1m16xc"), "02 000F 0001") == "02 01 00"
    assert _ask(_device("fa3-th1m16xc"), "02 0010 0001") == "82 02"


def test_fa3_answers_its_defaults() -> None:
    # Address at next start-up 192.168.3.250, then 600 s, 10 s, 3 messages, 30 s.
    expected = "03 0c 03 fa c0 a8 02 58 00 0a 00 03 00 1e"
    assert _ask(_device("fa3-at1m8y"), "03 00F0 0006") == expected


def test_fa3_is_silent_after_a_remote_reset() -> None:
    assert _ask(_device("fa3-at1m8x"), "41 00") is None


def test_bits_are_packed_from_the_lowest_address() -> None:
    device = _device("idec-ft1a-touch")
    # Supplement, 4.3.3: C1..C11, 21H 03H.
    device.image.set(Table.COILS, 0, [1, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1, 1, 1, 1])
    assert _ask(device, "01 0000 000B") == "01 02 21 03"


def test_a_range_runs_from_one_area_into_the_next() -> None:
    holding = Table.HOLDING_REGISTERS
    device = _own_device(
        (holding, 10, 19, Access.READ_WRITE),
        (holding, 20, 29, Access.READ),
        functions=["03", "10"],
    )
    assert _ask(device, "03 0013 0002") == "03 04 00 00 00 00"
    assert _ask(device, "03 000A 0014") == "03 28" + 40 * " 00"
    assert _ask(device, "03 000A 0015") == "83 12"
    assert _ask(device, "10 0012 0002 04 0001 0002") == "10 00 12 00 02"
    assert _ask(device, "10 0013 0002 04 0001 0002") == "90 12"  # 20 is read only.


def test_masks_a_register() -> None:
    device = _own_device((Table.HOLDING_REGISTERS, 0, 9, Access.READ_WRITE), functions=["16"])
    device.image.set(Table.HOLDING_REGISTERS, 4, [0x12])
    # V1.1b3, 6.16: 12H AND F2H OR 25H gives 17H.
    assert _ask(device, "16 0004 00F2 0025") == "16 00 04 00 f2 00 25"
    assert device.image.get(Table.HOLDING_REGISTERS, 4) == [0x17]
    assert _ask(device, "16 000A 00F2 0025") == "96 12"


def test_reads_what_it_has_just_written_in_one_request() -> None:
    holding = Table.HOLDING_REGISTERS
    device = _own_device((holding, 0, 199, Access.READ_WRITE), functions=["17"])
    assert _ask(device, "17 0001 0003 0002 0001 02 ABCD") == "17 06 00 00 ab cd 00 00"
    assert _ask(device, "17 0001 007E 0002 0001 02 ABCD") == "97 13"
    assert _ask(device, "17 0001 0001 0002 0002 02 ABCD") == "97 13"
    assert _ask(device, "17 00C7 0002 0002 0001 02 1111") == "97 12"
    assert _ask(device, "17 0001 0001 00C7 0002 04 1111 1111") == "97 12"
    assert device.image.get(holding, 0, 200) == [0, 0, 0xABCD, *([0] * 197)]


def test_writes_no_more_in_one_request_than_its_profile_allows() -> None:
    device = _own_device(
        (Table.HOLDING_REGISTERS, 0, 9, Access.READ_WRITE),
        functions={"17": FunctionRule(limit=3, write_limit=2)},
    )
    assert _ask(device, "17 0000 0003 0000 0002 04 0001 0002") == "17 06 00 01 00 02 00 00"
    assert _ask(device, "17 0000 0003 0000 0003 06 0007 0008 0009") == "97 13"
    assert _ask(device, "17 0000 0004 0000 0001 02 0007") == "97 13"
    assert device.image.get(Table.HOLDING_REGISTERS, 0, 3) == [1, 2, 0]


def test_a_listed_function_that_cannot_be_played_is_refused() -> None:
    device = _own_device((Table.COILS, 0, 9, Access.READ), functions=["01", "18"])
    assert _ask(device, "18 0000") == "98 11"


def test_an_empty_pdu_gets_no_answer() -> None:
    assert _device("idec-ft1a-touch").respond(1, b"", 0) is None


def _refusable() -> st.SearchStrategy[bytes]:
    """Random bytes, half of them behind a function that some device has."""
    functions = st.sampled_from([1, 2, 3, 4, 5, 6, 0x0F, 0x10, 0x16, 0x17, 0x41, 0x42, 0x43, 0x44])
    framed = st.builds(
        lambda function, data: bytes([function]) + data, functions, st.binary(max_size=12)
    )
    return framed | st.binary(max_size=300)


@given(st.sampled_from(builtin_profiles()), _refusable())
def test_answers_every_request_and_changes_nothing_where_it_refuses(
    name: str, request_: bytes
) -> None:
    device = _device(name)
    before = _everything(device.image)
    answer = device.respond(1, request_, 0)
    if answer is None:
        assert request_ in (b"", b"\x41\x00")
        return
    assert answer.pdu[0] & 0x7F == request_[0] & 0x7F
    assert len(answer.pdu) <= 253
    if answer.pdu[0] & EXCEPTION_BIT:
        documented = load_profile(name).exceptions.documented
        assert answer.pdu[1] in documented
        assert _everything(device.image) == before
    else:
        assert parse_pdu(answer.pdu, Direction.RESPONSE).problem is None


def _ranges(table: Table, limit: int) -> st.SearchStrategy[tuple[int, list[int]]]:
    values = st.lists(st.integers(0, 1 if table.is_bits else 0xFFFF), min_size=1, max_size=limit)
    return values.flatmap(
        lambda written: st.tuples(st.integers(0, 0x0FFF - len(written) + 1), st.just(written))
    )


@given(_ranges(Table.HOLDING_REGISTERS, 100))
def test_reads_back_the_registers_that_were_written(written: tuple[int, list[int]]) -> None:
    address, values = written
    device = _device("idec-ft1a-touch")
    write = encode_pdu(0x10, Direction.REQUEST, address=address, values=tuple(values))
    acknowledged = device.respond(1, write, 0)
    assert acknowledged is not None
    assert acknowledged.pdu == write[:5]
    read = encode_pdu(0x03, Direction.REQUEST, address=address, quantity=len(values))
    answer = device.respond(1, read, 0)
    assert answer is not None
    assert parse_pdu(answer.pdu, Direction.RESPONSE).numbers() == tuple(values)


@given(st.data())
def test_reads_back_the_coils_that_were_written(data: st.DataObject) -> None:
    values = data.draw(st.lists(st.integers(0, 1), min_size=1, max_size=32))
    address = data.draw(st.integers(0, 0x20 - len(values)))
    device = _device("fa3-at1m8y")
    write = encode_pdu(0x0F, Direction.REQUEST, address=address, values=tuple(values))
    acknowledged = device.respond(1, write, 0)
    assert acknowledged is not None
    assert acknowledged.pdu == write[:5]
    read = encode_pdu(0x01, Direction.REQUEST, address=address, quantity=len(values))
    answer = device.respond(1, read, 0)
    assert answer is not None
    bits = parse_pdu(answer.pdu, Direction.RESPONSE).numbers() or ()
    assert bits == (*values, *([0] * (-len(values) % 8)))


@pytest.mark.parametrize("coil", [0, 7, 0x1F])
@pytest.mark.parametrize("value", [0, 1])
def test_reads_back_a_single_coil(coil: int, value: int) -> None:
    device = _device("fa3-at1m8y")
    device.image.set(Table.COILS, coil, [1 - value])
    request = f"05 {coil:04x} {'ff00' if value else '0000'}"
    assert _ask(device, request) == bytes.fromhex(request).hex(" ")
    assert _ask(device, f"01 {coil:04x} 0001") == f"01 01 {value:02x}"


def test_a_read_that_is_known_gives_what_is_there_now() -> None:
    device = _device("idec-ft1a-touch")
    for value in (1, 2):
        device.image.set(Table.HOLDING_REGISTERS, 5, [value])
        device.image.set(Table.COILS, 3, [value & 1])
        assert _ask(device, "03 0005 0001") == f"03 02 00 {value:02x}"
        assert _ask(device, "01 0000 000A") == f"01 02 {8 * (value & 1):02x} 00"
    _ask(device, "06 0005 0007")
    assert _ask(device, "03 0005 0001") == "03 02 00 07"


def test_what_is_remembered_of_reads_is_bounded() -> None:
    device = _device("idec-ft1a-touch")
    for address in range(MAX_KNOWN):
        _ask(device, f"03 {address:04x} 0001")
    assert len(device._known) == MAX_KNOWN
    assert _ask(device, "03 0000 0002") == "03 04 00 00 00 00"
    assert len(device._known) == 1


def test_a_refused_read_is_not_remembered() -> None:
    device = _device("idec-ft1a-touch")
    for _ in range(2):
        assert _ask(device, "03 1000 0001") == "83 02"
    assert not device._known
