from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Connection, Direction, Endpoint
from mbtool.packets.stream import (
    LEAD,
    MAX_ACKNOWLEDGEMENTS,
    MAX_GAPS,
    MAX_HELD_BYTES,
    MAX_HELD_PIECES,
    RECENT_BYTES,
    HeldBytes,
    Stream,
)

CONNECTION = Connection(Endpoint("10.0.0.1", 49152), Endpoint("10.0.0.2", 502))


def _stream(first: int = 0) -> Stream:
    stream = Stream(Direction.REQUEST, CONNECTION)
    stream.origin = first
    return stream


def _piece(start: int, data: bytes) -> HeldBytes:
    return HeldBytes(start, start + len(data), data, acknowledged=0, ts_ns=0, arrival=0)


@given(
    first=st.integers(0, 2**32 - 1),
    position=st.integers(0, 2**40),
    distance=st.integers(-(2**31), 2**31 - 1),
)
def test_places_a_sequence_number_nearest_to_the_next(
    first: int, position: int, distance: int
) -> None:
    stream = _stream(first)
    stream.position = position

    assert stream.position_of((first + position + distance) % 2**32) == position + distance


@given(st.lists(st.tuples(st.integers(0, 40), st.binary(min_size=1, max_size=12)), max_size=20))
def test_held_pieces_do_not_overlap_and_keep_first_copies(copies: list[tuple[int, bytes]]) -> None:
    stream = _stream()
    expected: dict[int, int] = {}
    for start, data in copies:
        differs = any(expected.get(start + i, byte) != byte for i, byte in enumerate(data))
        assert stream.hold(_piece(start, data)) == differs
        for i, byte in enumerate(data):
            expected.setdefault(start + i, byte)

    held = [(piece.start + i, byte) for piece in stream.held for i, byte in enumerate(piece.data)]
    assert held == sorted(expected.items())
    assert stream.held_bytes == len(expected)


def test_is_overfull_beyond_its_bounds() -> None:
    stream = _stream()
    stream.hold(_piece(10, bytes(MAX_HELD_BYTES)))
    assert not stream.is_overfull()
    stream.hold(_piece(9, b"a"))
    assert stream.is_overfull()

    stream = _stream()
    for number in range(MAX_HELD_PIECES):
        stream.hold(_piece(10 + 2 * number, b"a"))
    assert not stream.is_overfull()
    stream.hold(_piece(2, b"a"))
    assert stream.is_overfull()


def test_compares_a_second_copy_with_the_bytes_that_it_still_has() -> None:
    stream = _stream()
    data = bytes(range(256)) * 8
    stream.advance(data, len(data))

    kept = len(data) - RECENT_BYTES
    assert not stream.differs_from_delivered(0, data + b"more")
    assert not stream.differs_from_delivered(0, b"x" * kept)
    assert stream.differs_from_delivered(0, b"x" * (kept + 1))
    assert stream.differs_from_delivered(len(data) - 2, b"\xfe\x00")


def test_keeps_no_more_of_many_pieces_than_of_one() -> None:
    stream = _stream()
    for _ in range(4):
        stream.advance(b"y" * (RECENT_BYTES // 2), RECENT_BYTES // 2)
    assert not stream.differs_from_delivered(0, b"x" * RECENT_BYTES)
    assert stream.differs_from_delivered(0, b"x" * (RECENT_BYTES + 1))


def test_a_gap_leaves_nothing_to_compare_with() -> None:
    stream = _stream()
    stream.advance(b"abc", 3)
    stream.advance(b"", 10)

    assert stream.position == 13
    assert not stream.differs_from_delivered(0, b"xyz")


def test_a_joined_stream_begins_where_its_first_hole_ends() -> None:
    stream = Stream(Direction.REQUEST, CONNECTION)
    stream.join(3, arrival=1, ts_ns=0)

    assert (stream.position_of(3), stream.position_of(2)) == (LEAD, LEAD - 1)
    assert stream.begins_at(3)
    assert stream.begins_at(2**32 - 7)
    assert not stream.begins_at(4)
    stream.pass_over(LEAD - 1)
    assert (stream.position, stream.beginning, stream.joining) == (LEAD - 1, 2, False)
    assert stream.begins_at(2)
    assert not stream.begins_at(3)
    assert stream.take_late(_piece(0, bytes(LEAD))) == b""


def test_a_wait_begins_with_the_acknowledgement_of_the_missing_bytes() -> None:
    stream = _stream()
    stream.acknowledge(3, arrival=1, ts_ns=0)
    stream.acknowledge(6, arrival=3, ts_ns=0)

    assert stream.is_overdue(4, 3, 0, 100, needed=0)
    stream.advance(b"abc", 3)
    assert not stream.is_overdue(5, 3, 0, 100, needed=0)
    assert stream.is_overdue(6, 3, 0, 100, needed=0)
    assert stream.is_overdue(5, 3, 100, 100, needed=0)
    stream.advance(b"def", 3)
    assert not stream.is_overdue(99, 3, 999, 100, needed=0)


def test_remembers_a_limited_number_of_acknowledgements_and_gaps() -> None:
    stream = _stream()
    for number in range(1000):
        stream.acknowledge(10 * number + 1, arrival=number, ts_ns=0)
    stream.advance(b"x" * 9980, 9980)
    # Further ones are as old as the last that is remembered by itself, which is number 7.
    assert not stream.is_overdue(MAX_ACKNOWLEDGEMENTS + 1, 3, 0, 100, needed=0)
    assert stream.is_overdue(MAX_ACKNOWLEDGEMENTS + 2, 3, 0, 100, needed=0)

    stream = _stream()
    for _ in range(MAX_GAPS + 1):
        stream.pass_over(1)
        stream.advance(b"x", 1)
    assert stream.take_late(_piece(0, b"a")) == b""
    told = [stream.take_late(_piece(0, bytes(range(20)))) for _ in range(MAX_GAPS + 1)]
    assert told == [bytes([2 * number]) for number in range(1, MAX_GAPS + 1)] + [b""]
