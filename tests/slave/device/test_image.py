"""The register image, against a plain dictionary."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.devices import load_profile
from mbtool.modbus import encode_pdu
from mbtool.modbus.tables import Table
from mbtool.slave.device.image import RegisterImage, packed_bits


def _writes() -> st.SearchStrategy[tuple[Table, int, list[int]]]:
    def of_table(table: Table) -> st.SearchStrategy[tuple[Table, int, list[int]]]:
        values = st.lists(st.integers(0, 1 if table.is_bits else 0xFFFF), max_size=20)
        address = st.one_of(st.integers(0, 30), st.integers(0xFFFF - 19, 0xFFFF - 19))
        return st.tuples(st.just(table), address, values)

    return st.sampled_from(list(Table)).flatmap(of_table)


@given(st.lists(_writes(), max_size=10))
def test_holds_what_was_written_last(writes: list[tuple[Table, int, list[int]]]) -> None:
    image = RegisterImage()
    model: dict[tuple[Table, int], int] = {}
    for table, address, values in writes:
        image.set(table, address, values)
        model.update(((table, address + place), value) for place, value in enumerate(values))
    for table in Table:
        for first in (0, 0xFFFF - 49):
            expected = [model.get((table, first + place), 0) for place in range(50)]
            assert image.get(table, first, 50) == expected


def test_reaches_the_last_address() -> None:
    image = RegisterImage()
    image.set(Table.HOLDING_REGISTERS, 0xFFFF, [0xABCD])
    assert image.get(Table.HOLDING_REGISTERS, 0xFFFF) == [0xABCD]


@pytest.mark.parametrize(
    ("table", "address", "values"),
    [
        (Table.HOLDING_REGISTERS, 0, [1, 0x10000]),
        (Table.HOLDING_REGISTERS, 0, [1, -1]),
        (Table.COILS, 0, [1, 2]),
        (Table.INPUT_REGISTERS, 0xFFFF, [1, 2]),
        (Table.INPUT_REGISTERS, -1, [1]),
    ],
)
def test_refuses_what_no_table_holds_and_changes_nothing(
    table: Table, address: int, values: list[int]
) -> None:
    image = RegisterImage()
    with pytest.raises(ValueError, match="0\\.\\."):
        image.set(table, address, values)
    assert image.get(table, 0) == [0]
    assert image.get(table, 0xFFFF) == [0]


def test_refuses_to_read_past_the_end() -> None:
    with pytest.raises(ValueError, match="65535"):
        RegisterImage().get(Table.COILS, 0xFFFF, 2)


def test_begins_with_the_defaults_of_the_profile() -> None:
    image = RegisterImage.of(load_profile("fa3-at1m8x"))
    # FA3 chapters 10.3 and 10.4: 192.168.3.250, 600 s, 10 s, 3 messages, 30 s.
    expected = [0x03FA, 0xC0A8, 600, 10, 3, 30]
    assert image.get(Table.HOLDING_REGISTERS, 0x00F0, 6) == expected
    assert image.get(Table.HOLDING_REGISTERS, 0x0020, 0x00D0) == [0] * 0x00D0


@given(st.lists(_writes(), max_size=5), st.sampled_from(list(Table)), st.data())
def test_packs_a_range_as_a_response_carries_it(
    writes: list[tuple[Table, int, list[int]]], table: Table, data: st.DataObject
) -> None:
    image = RegisterImage()
    for each, address, values in writes:
        image.set(each, address, values)
    quantity = data.draw(st.integers(1, 250))
    address = data.draw(st.one_of(st.integers(0, 30), st.just(0x10000 - quantity)))
    code = {Table.COILS: 1, Table.DISCRETE_INPUTS: 2, Table.HOLDING_REGISTERS: 3}.get(table, 4)
    if not table.is_bits:
        quantity = min(quantity, 125)
    held = tuple(image.get(table, address, quantity))
    cells, part = image.cells(table, range(address, address + quantity))
    packed = packed_bits(cells[part]) if table.is_bits else cells[part]
    assert packed == encode_pdu(code, Direction.RESPONSE, values=held)[2:]


def test_tables_that_are_shared_are_one() -> None:
    image = RegisterImage()
    image.set(Table.INPUT_REGISTERS, 1, [5, 6])
    image.set(Table.HOLDING_REGISTERS, 1, [7])
    for _ in range(2):
        image.share_contents(Table.INPUT_REGISTERS, Table.HOLDING_REGISTERS)
    assert image.get(Table.HOLDING_REGISTERS, 0, 4) == [0, 7, 6, 0]
    image.set(Table.HOLDING_REGISTERS, 3, [8])
    assert image.get(Table.INPUT_REGISTERS, 0, 4) == [0, 7, 6, 8]


def test_a_point_of_a_block_is_put_into_its_block() -> None:
    profile = load_profile("wago-750")
    image = RegisterImage.of(profile)
    by_name = {point.name: point for point in profile.points}
    image.put(by_name["BadLength statistics"], 0x102B, [9])
    image.put(by_name["Item number"], 0x2012, [341])
    assert image.blocks.get(Table.HOLDING_REGISTERS, range(0x1029, 0x102C)) == [0, 0, 9]
    assert image.get(Table.HOLDING_REGISTERS, 0x102B) == [0]
    assert image.get(Table.HOLDING_REGISTERS, 0x2012) == [341]
