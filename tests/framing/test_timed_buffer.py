"""A byte queue that keeps the arrival time of each byte."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Origin
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


def test_seams_are_where_appends_began_or_ended_also_behind_taken_bytes() -> None:
    buffer = filled((b"ab", 10), (b"c", 20), (b"", 25), (b"def", 30))

    def seams() -> list[int]:
        return [index for index in range(8) if buffer.is_append_boundary(index)]

    found = [seams()]
    for size in (1, 1, 1, 2, 1):
        buffer.take(size)
        found.append(seams())
    assert found == [[0, 2, 3, 6], [1, 2, 5], [0, 1, 4], [0, 3], [1], [0]]
    buffer.append(b"g", 40)
    assert seams() == [0, 1]


def test_a_mark_is_that_of_the_append_that_brought_the_byte() -> None:
    buffer = TimedBuffer()
    origins = [Origin("f", number) for number in range(3)]
    for number, origin in enumerate(origins):
        buffer.append(b"ab", 10 * number, origin)
    buffer.take(1)
    assert [buffer.mark_at(index) for index in range(5)] == [
        (0, origins[0]), (10, origins[1]), (10, origins[1]), (20, origins[2]), (20, origins[2]),
    ]  # fmt: skip
    with pytest.raises(IndexError):
        buffer.mark_at(5)
