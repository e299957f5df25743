"""Registers that are read from one address alone."""

from __future__ import annotations

import pytest

from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.slave.device.image import Blocks, RegisterImage

HOLDING, INPUT = Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS
WAGO = load_profile("wago-750")


def test_a_block_is_read_from_its_first_address_as_far_as_it_goes() -> None:
    blocks = Blocks.of(WAGO)
    blocks.set(HOLDING, 0x2020, 0, [0x3735, 0x3031])
    assert blocks.get(HOLDING, range(0x2020, 0x2022)) == [0x3735, 0x3031]
    assert blocks.get(HOLDING, range(0x2021, 0x2022)) == [0]
    assert blocks.get(HOLDING, range(0x2022, 0x202A)) == [0] * 8
    assert blocks.get(HOLDING, range(0x2010, 0x2011)) is None


def test_tables_that_are_one_have_the_same_blocks() -> None:
    blocks = Blocks.of(WAGO)
    blocks.share_contents(INPUT, HOLDING)
    blocks.set(HOLDING, 0x2020, 1, [7])
    assert blocks.get(INPUT, range(0x2020, 0x2022)) == [0, 7]


def test_a_device_without_blocks_has_none() -> None:
    assert Blocks.of(load_profile("idec-ft1a-touch")).get(HOLDING, range(4)) is None


@pytest.mark.parametrize(("offset", "values"), [(15, [1, 2]), (0, [65536]), (0, [-1])])
def test_a_block_takes_only_what_it_can_hold(offset: int, values: list[int]) -> None:
    image = RegisterImage.of(WAGO)
    with pytest.raises(ValueError, match="does not hold"):
        image.blocks.set(HOLDING, 0x2020, offset, values)
    assert image.blocks.get(HOLDING, range(0x2020, 0x2030)) == [0] * 16
