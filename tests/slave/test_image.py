"""The register image, against a plain dictionary."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices import load_profile
from mbtool.modbus.tables import Table
from mbtool.slave.image import RegisterImage


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
