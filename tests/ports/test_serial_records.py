"""The records between the serial reader's process and its parent."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.ports.serial_records import (
    MAX_DATA,
    RecordKind,
    RecordReader,
    RecordWriter,
    SerialRecord,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

RECORDS = st.lists(
    st.builds(
        SerialRecord,
        st.sampled_from([RecordKind.DATA, RecordKind.QUIET, RecordKind.ERROR]),
        st.integers(0, 2**62),
        st.binary(max_size=20),
    ),
    max_size=8,
)


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reading, writing = os.pipe()
    yield reading, writing
    for fd in (reading, writing):
        try:
            os.close(fd)
        except OSError:
            continue


@given(records=RECORDS, cut=st.integers(1, 9))
def test_records_come_back_however_the_pipe_cuts_them(
    records: list[SerialRecord], cut: int
) -> None:
    reading, writing = os.pipe()
    try:
        writer = RecordWriter(writing)
        for record in records:
            writer.put(record.kind, record.ts_ns, record.data)
        os.close(writing)
        data = b""
        while piece := os.read(reading, 2**16):
            data += piece
    finally:
        os.close(reading)
    reader = RecordReader()
    pieces = [data[start : start + cut] for start in range(0, len(data), cut)]
    assert [record for piece in pieces for record in reader.feed(piece)] == records


def test_a_full_pipe_is_not_waited_for_and_the_loss_is_told(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    writer = RecordWriter(writing)
    written = 1000
    for number in range(written):
        writer.put(RecordKind.DATA, number, bytes(MAX_DATA))
    reader = RecordReader()
    first = reader.feed(os.read(reading, 2**21))
    assert 0 < len(first) < written
    writer.put(RecordKind.DATA, written, b"after")
    lost, after = reader.feed(os.read(reading, 2**16))
    assert lost.kind is RecordKind.LOST
    assert lost.lost == (written - len(first)) * MAX_DATA
    assert after == SerialRecord(RecordKind.DATA, written, b"after")


def test_a_loss_not_yet_told_is_told_at_the_end(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    writer = RecordWriter(writing)
    for number in range(1000):
        writer.put(RecordKind.DATA, number, bytes(MAX_DATA))
    reader = RecordReader()
    held = len(reader.feed(os.read(reading, 2**21)))
    writer.end(1000, "unplugged")
    lost, error = reader.feed(os.read(reading, 2**16))
    assert lost.lost == (1000 - held) * MAX_DATA
    assert error == SerialRecord(RecordKind.ERROR, 1000, b"unplugged")


def test_says_when_nobody_reads(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    writer = RecordWriter(writing)
    os.close(reading)
    with pytest.raises(BrokenPipeError):
        writer.put(RecordKind.QUIET, 0)
