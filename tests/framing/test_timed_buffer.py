"""A byte queue that keeps the arrival time of each byte."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.framing.timed_buffer import TimedBuffer


def filled(*appends: tuple[bytes, int]) -> TimedBuffer:
    buffer = TimedBuffer()
    for data, ts_ns in appends:
        buffer.append(data, ts_ns)
    return buffer


def test_byte_keeps_the_time_of_its_append() -> None:
    buffer = filled((b"ab", 10), (b"", 15), (b"c", 20))
    assert [buffer.mark_at(index)[0] for index in range(3)] == [10, 10, 20]
    assert buffer.take(1) == b"a"
    assert (buffer.first_ns, buffer.mark_at(1)[0]) == (10, 20)
    assert buffer.take(1) == b"b"
    assert buffer.first_ns == 20
    with pytest.raises(IndexError):
        buffer.mark_at(1)


def test_peek_leaves_bytes_and_take_removes_them() -> None:
    buffer = filled((b"abc", 10))
    assert (buffer.peek(2), buffer.peek(9, 1), len(buffer)) == (b"ab", b"bc", 3)
    assert (buffer.take(9), len(buffer)) == (b"abc", 0)


def test_finds_a_pattern_from_an_index_on() -> None:
    buffer = filled((b"aba", 10))
    pattern = re.compile(b"a")
    assert (buffer.find(pattern, 0), buffer.find(pattern, 1), buffer.find(pattern, 3)) == (
        0,
        2,
        None,
    )
    buffer.append(b"c", 11)
    assert len(buffer) == 4


def test_drains_in_pieces_of_one_time() -> None:
    buffer = filled((b"ab", 10), (b"cd", 20), (b"e", 30))
    assert list(buffer.drain(3)) == [(b"ab", 10), (b"c", 20)]
    assert buffer.first_ns == 20
    assert list(buffer.drain(9)) == [(b"d", 20), (b"e", 30)]
    assert list(buffer.drain(1)) == []


@given(st.lists(st.tuples(st.binary(max_size=5), st.integers(0, 3)), max_size=20))
def test_every_byte_comes_out_with_its_time(appends: list[tuple[bytes, int]]) -> None:
    buffer = filled(*appends)
    came = [(byte, ts_ns) for data, ts_ns in buffer.drain(1000) for byte in data]
    assert came == [(byte, ts_ns) for data, ts_ns in appends for byte in data]
