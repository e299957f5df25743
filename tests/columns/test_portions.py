"""Rows are made of a portion of a block's values at a time, so that they take little memory."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pytest

from mbtool.columns import portions
from mbtool.columns.block_table import BlockTables
from mbtool.columns.usual_values import UsualValues
from mbtool.core import Direction
from mbtool.logs import csv_line
from mbtool.modbus import encode_pdu
from mbtool.workflows.shared.column_reading import ColumnReading
from mbtool.workflows.shared.reading import ReadingOptions
from tests.columns.both_ways import blocks_of, without_dictionaries
from tests.columns.test_equality import FORMS, encoded, poll
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from mbtool.columns.plain_rows import PlainRows

COILS = 2000
"""The most that one read gives."""
LARGEST = 8 * (12 + 9 + COILS // 8)
"""How many bits the ADUs of one read of so many coils can hold."""


def coil_reads(count: int, coils: int = COILS) -> bytes:
    """A capture whose responses have every third coil on."""
    request = encode_pdu(0x01, Direction.REQUEST, address=0, quantity=coils)
    values = tuple(number % 3 == 0 for number in range(coils))
    response = encode_pdu(0x01, Direction.RESPONSE, values=values)
    talk = Talk()
    return pcap([*talk.handshake(), *poll(talk, count, request, response)])


def plain_rows(capture: bytes) -> list[PlainRows]:
    return [one.plain for one in blocks_of(capture)[0] if one.plain is not None]


def test_a_portion_has_as_many_bits_as_its_limit_and_one_transaction() -> None:
    capture = coil_reads(40)
    with patch.object(portions, "MOST_VALUES", 5 * COILS):
        found = [len(rows.response) for rows in plain_rows(capture)]
    assert sum(found) == 39
    assert len(found) > 5
    assert max(found) <= (5 * COILS + LARGEST) // COILS


def test_a_block_full_of_registers_is_one_portion() -> None:
    most_bytes = 8 * 1024 * 1024
    packets = 16 + 54 + 12 + 16 + 54 + 9 + 250  # A read of 125 registers, with its record headers.
    assert most_bytes // packets * ((12 + 9 + 250) // 2) < portions.MOST_VALUES


WAYS: list[Callable[[ColumnReading], Iterable[Any]]] = [
    ColumnReading.batches,
    ColumnReading.decoded,
    lambda reading: reading.lines(csv_line, " "),
    lambda reading: reading.runs(lambda _: None, 0),
]


@pytest.mark.parametrize("way", WAYS, ids=("Parquet", "several processes", "lines", "table"))
def test_every_output_is_made_in_portions(
    way: Callable[[ColumnReading], Iterable[Any]], tmp_path: Path
) -> None:
    (tmp_path / "a.pcap").write_bytes(coil_reads(40))
    with patch.object(portions, "MOST_VALUES", 5 * COILS):
        reading = ColumnReading([str(tmp_path / "a.pcap")], ReadingOptions())
        assert len([*way(reading)]) > 5


def test_the_table_of_portions_is_that_of_the_whole_block() -> None:
    talk = Talk()
    packets = talk.handshake()
    for form in FORMS:
        packets += poll(talk, 3, *encoded(form))
    capture = pcap(packets)
    tables, numbers = [], []
    for most in (20, portions.MOST_VALUES):
        with patch.object(portions, "MOST_VALUES", most):
            made = [BlockTables().batch(one).table for one in blocks_of(capture)[0]]
        numbers.append(len(made))
        tables.append(pa.concat_tables(map(without_dictionaries, made)).combine_chunks())
    assert tables[0].equals(tables[1])
    assert tables[0].num_rows == 3 * len(FORMS)
    assert numbers[0] > numbers[1]


@pytest.mark.parametrize("coils", [COILS, COILS - 3])
def test_reading_bits_takes_few_bytes_of_memory_for_each(coils: int) -> None:
    (rows,) = plain_rows(coil_reads(50, coils))
    usual = UsualValues(rows)
    chosen = np.flatnonzero(usual.is_usual)
    tracemalloc.start()
    try:
        values = usual.response_values(chosen)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert values.numbers[:coils].tolist() == [number % 3 == 0 for number in range(coils)]
    assert len(values.numbers) == coils * len(chosen)
    assert peak < 8 * len(values.numbers)
