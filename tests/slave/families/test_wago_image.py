"""The process image of a described node, through the responder."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from mbtool.slave.families.wago import stored_range

if TYPE_CHECKING:
    from mbtool.slave.device.responder import DeviceResponder

HOLDING, COILS = Table.HOLDING_REGISTERS, Table.COILS
WAGO = load_profile("wago-750")


def _node(
    analog_outputs: int, analog_inputs: int, digital_outputs: int, digital_inputs: int
) -> DeviceResponder:
    image = RegisterImage.of(WAGO)
    image.set(HOLDING, 0x1022, [analog_outputs, analog_inputs, digital_outputs, digital_inputs])
    return make_device(WAGO, image)


def _ask(device: DeviceResponder, request: str) -> str:
    answer = device.respond(1, bytes.fromhex(request), 0)
    assert answer is not None
    return answer.pdu.hex(" ")


@pytest.mark.parametrize(
    ("table", "first", "stands"),
    [
        (HOLDING, 0x0000, 0x0200),
        (HOLDING, 0x00FF, 0x02FF),
        (HOLDING, 0x0200, 0x0200),
        (HOLDING, 0x62FC, 0x72FC),
        (HOLDING, 0x1003, 0x1003),
        (COILS, 0x01FF, 0x03FF),
        (COILS, 0x3000, 0x4000),
    ],
)
def test_outputs_stand_higher_than_they_are_written(table: Table, first: int, stands: int) -> None:
    assert stored_range(table, range(first, first + 1)).start == stands


def test_digital_inputs_are_in_registers_behind_the_analog_ones() -> None:
    node = _node(0, 32, 0, 20)  # two words, 20 bits
    node.image.set(HOLDING, 0, [0x1111, 0x2222, 0x3333, 0x4444, 0x5555])
    node.image.set(COILS, 0, [1, 0, 0, 1, *[0] * 12, 0, 1, 1, 1, 1])
    assert _ask(node, "03 0000 0005") == "03 0a 11 11 22 22 00 09 00 0e 55 55"
    assert _ask(node, "04 0003 0001") == "04 02 00 0e"


def test_digital_outputs_are_set_and_read_back_either_way() -> None:
    node = _node(16, 0, 12, 0)
    _ask(node, "10 0000 0002 04 1234 F00F")
    assert _ask(node, "01 0200 000C") == "01 02 0f 00"
    assert _ask(node, "03 0200 0002") == "03 04 12 34 00 0f"
    _ask(node, "05 0008 FF00")
    assert _ask(node, "03 0201 0001") == "03 02 01 0f"
    assert _ask(node, "16 0001 FF00 00A0") == "16 00 01 ff 00 00 a0"
    assert _ask(node, "01 0200 000C") == "01 02 a0 01"
    assert _ask(node, "03 0000 0002") == "03 04 00 00 00 00"


def test_a_node_that_nobody_described_keeps_bits_and_registers_apart() -> None:
    node = _node(0, 0, 0, 0)
    _ask(node, "06 0000 FFFF")
    assert _ask(node, "01 0200 0008") == "01 01 00"


@pytest.mark.parametrize("size", [0xFFFF, 4096, 513])
def test_a_size_beyond_the_first_part_does_no_harm(size: int) -> None:
    node = _node(size, size, size, size)
    for request in ("03 0000 007D", "03 0083 007D", "03 0200 007D", "10 00FE 0002 04 FFFF FFFF"):
        assert _ask(node, request)[:2] == request[:2]
    assert node.image.get(COILS, 0x0400, 64) == [0] * 64
