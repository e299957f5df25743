from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Connection, Direction, Endpoint
from mbtool.packets.plain_bytes import PlainBytes
from mbtool.packets.stream import HeldBytes, Stream

# The limits of a stream, as numbers: with others, decode reports other gaps and events.
LEAD = MAX_HELD_BYTES = 64 * 1024
MAX_HELD_PIECES = 64
RECENT_BYTES = 1024
MAX_GAPS = MAX_ACKNOWLEDGEMENTS = 8

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


def test_a_stream_joined_in_its_middle_may_have_begun_with_any_byte_before_its_first() -> None:
    stream = Stream(Direction.REQUEST, CONNECTION)
    stream.join(100_000, arrival=1, ts_ns=0)
    stream.hold(_piece(LEAD + 5, b"x"))
    may = [at for at in range(-2 * LEAD, 20) if stream.begins_at(100_000 + at)]
    # Up to the first byte that is held; without one, up to that of the first segment.
    assert (may[0], may[-1], len(may)) == (-LEAD, 5, LEAD + 6)


@pytest.mark.parametrize("first", [1000, 2**32 - 3])
def test_a_syn_begins_a_stream_behind_itself_only_once(first: int) -> None:
    stream = Stream(Direction.REQUEST, CONNECTION)
    assert stream.take_syn(first) == (first + 1) % 2**32
    assert stream.take_syn(first + 9) == (first + 10) % 2**32
    assert (stream.origin, stream.beginning) == ((first + 1) % 2**32,) * 2
    assert [at for at in range(-3, 4) if stream.begins_at((first + at) % 2**32)] == [1]


@pytest.mark.parametrize("first", [1000, 2**32 - 3])
@pytest.mark.parametrize(
    ("told", "origin", "decided"),
    [(-1, 0, False), (3, 0, False), (4, -1, True), (5, 0, True), (6, 0, True)],
)
def test_the_byte_behind_those_of_a_syn_tells_if_the_syn_counts(
    first: int, told: int, origin: int, decided: bool
) -> None:
    stream = Stream(Direction.REQUEST, CONNECTION)
    stream.begin(first)
    stream.syn_end = 5
    stream.decide_syn((first + told) % 2**32)
    assert stream.origin == (first + origin) % 2**32
    assert (stream.syn_end is None) == decided


@pytest.mark.parametrize("first", [0, 1000, 2**32 - 3, 2**32 - 10])
def test_a_stream_awaits_its_next_byte_unless_something_is_open(first: int) -> None:
    stream = Stream(Direction.REQUEST, CONNECTION)
    assert not stream.awaits(first)
    assert not stream.is_before_next(first)
    rests = [stream.is_at_rest]
    stream.begin(first)
    stream.advance(b"0123456789", 10)
    following = (first + 10) % 2**32
    assert stream.next_sequence == following
    near = [(following + at) % 2**32 for at in range(-3, 4)]
    assert [stream.awaits(one) for one in near] == [one == following for one in near]
    before = [at for at, one in enumerate(near, -3) if stream.is_before_next(one)]
    assert before == [-1]
    rests.append(stream.is_at_rest)
    for name, value in (("joining", True), ("finish", 0), ("finish", 10), ("syn_end", 0)):
        old = getattr(stream, name)
        setattr(stream, name, value)
        assert not stream.awaits(following)
        rests.append(stream.is_at_rest)
        setattr(stream, name, old)
    stream.hold(_piece(12, b"x"))
    assert not stream.awaits(following)
    rests.append(stream.is_at_rest)
    assert rests == [False, True, False, False, False, False, False]


def test_a_second_copy_is_not_new_unless_it_is_far_away() -> None:
    stream = Stream(Direction.REQUEST, CONNECTION)
    assert stream.is_new(0, 0, 100)
    stream.begin(1000)
    stream.advance(b"", 500)
    new = [
        (start, size)
        for start in (1399, 1400, 1401, 1490, 1499, 1500)
        for size in (1, 10, 11)
        if stream.is_new(start, size, 100)
    ]
    assert new == [
        (1399, 1), (1399, 10), (1399, 11), (1490, 11), (1499, 10), (1499, 11),
        (1500, 1), (1500, 10), (1500, 11),
    ]  # fmt: skip


def test_a_fin_counts_within_the_window_only() -> None:
    for place, size, counts in (
        (399, 0, False), (400, 0, True), (600, 0, True), (601, 0, False),
        (395, 5, True), (394, 5, False), (595, 5, True), (596, 5, False),
    ):  # fmt: skip
        stream = Stream(Direction.REQUEST, CONNECTION)
        stream.note_finish(place, size, 100)
        assert stream.finish is None
        stream.begin(0)
        stream.advance(b"", 500)
        stream.note_finish(place, size, 100)
        assert stream.finish == (place + size if counts else None)


def test_a_receipt_counts_within_the_window_and_up_to_the_fin() -> None:
    stream = Stream(Direction.REQUEST, CONNECTION)
    assert stream.acknowledged_position(500, 100) is None
    stream.begin(0)
    stream.advance(b"", 500)
    assert [stream.acknowledged_position(one, 100) for one in (399, 400, 500, 600, 601)] == [
        None, 400, 500, 600, None,
    ]  # fmt: skip
    stream.finish = 510
    assert [stream.acknowledged_position(one, 100) for one in (509, 510, 511, 900)] == [
        509,
        510,
        510,
        510,
    ]


def test_the_first_acknowledgement_of_a_byte_tells_when_it_was_received() -> None:
    stream = _stream()
    for position, ts_ns in ((3, 10), (3, 20), (7, 30), (5, 40), (9, 50)):
        stream.acknowledge(position, arrival=1, ts_ns=ts_ns)
    assert [stream.acknowledged_ns(one) for one in (1, 3, 4, 7, 8, 9, 10)] == [
        10, 10, 30, 30, 50, 50, None,
    ]  # fmt: skip
    assert stream.acknowledged == 9


def test_a_wait_is_over_at_its_limit_of_packets_or_of_time() -> None:
    stream = _stream()
    stream.acknowledge(5, arrival=10, ts_ns=1000)
    stream.acknowledge(8, arrival=11, ts_ns=2000)
    over = [
        (arrival, ts_ns, needed)
        for arrival, ts_ns in ((12, 1099), (13, 1000), (12, 1100), (13, 2099), (14, 0), (0, 2100))
        for needed in (0, 5, 6, 8, 9)
        if stream.is_overdue(arrival, 3, ts_ns, 100, needed)
    ]
    assert over == [
        (13, 1000, 0), (13, 1000, 5), (12, 1100, 0), (12, 1100, 5), (13, 2099, 0), (13, 2099, 5),
        *((14, 0, needed) for needed in (0, 5, 6, 8)),
        *((0, 2100, needed) for needed in (0, 5, 6, 8)),
    ]  # fmt: skip


def test_a_new_start_forgets_what_was_told_of_the_old_place() -> None:
    stream = _stream()
    stream.advance(b"abc", 3)
    stream.pass_over(4)
    stream.advance(b"def", 3)
    stream.acknowledge(20, arrival=1, ts_ns=0)
    stream.finish = 30
    stream.joining = True
    stream.rebase(2**32 - 1)
    assert (stream.position, stream.position_of(2**32 - 1), stream.position_of(0)) == (10, 10, 11)
    assert [stream.finish, stream.acknowledged, stream.joining] == [None, 10, False]
    assert stream.take_late(_piece(0, b"x" * 10)) == b""
    assert not stream.differs_from_delivered(7, b"xyz")
    assert not stream.is_overdue(99, 3, 999, 100, needed=0)
    assert stream.acknowledged_ns(20) is None


def test_bytes_of_a_gap_that_come_late_are_given_once() -> None:
    for start, size, late in (
        (0, 3, b""), (0, 4, b"d"), (0, 20, b"defg"), (4, 2, b"ef"), (6, 9, b"g"), (7, 3, b""),
    ):  # fmt: skip
        stream = _stream()
        stream.advance(b"abc", 3)
        stream.pass_over(4)
        stream.advance(b"hij", 3)
        piece = _piece(start, b"abcdefghijklmnopqrstuvwxyz"[start : start + size])
        assert stream.take_late(piece) == late
        assert stream.take_late(piece) == b""


def test_a_single_byte_before_the_next_may_differ_as_a_probe() -> None:
    stream = _stream()
    stream.advance(b"abcdef", 6)
    differing = [
        (start, data)
        for start in range(-1, 8)
        for data in (b"?", b"??")
        if stream.differs_from_delivered(start, data)
    ]
    assert differing == [
        (-1, b"??"), *((at, data) for at in range(5) for data in (b"?", b"??")), (5, b"??"),
    ]  # fmt: skip


def test_a_single_byte_with_none_behind_it_may_be_a_probe() -> None:
    for pieces, is_probe in (
        ([(5, b"a")], True),
        ([(5, b"ab")], False),
        ([(5, b"a"), (6, b"b")], False),
        ([(5, b"a"), (7, b"b")], True),
        ([(5, b"a"), (7, b"b"), (8, b"c")], True),
    ):
        stream = _stream()
        for start, data in pieces:
            stream.hold(_piece(start, data))
        assert stream.holds_a_probe == is_probe


def test_what_is_held_is_counted_until_it_is_released() -> None:
    stream = _stream()
    cut = HeldBytes(20, 30, b"", acknowledged=0, ts_ns=0, arrival=0)
    for piece in (_piece(5, b"abc"), cut, _piece(4, b"?bcd")):
        stream.hold(piece)
    assert [(one.start, one.data) for one in stream.held] == [(4, b"?"), (5, b"abc"), (20, b"")]
    counts = []
    while stream.held:
        counts.append(stream.held_bytes)
        stream.release()
    assert (counts, stream.held_bytes) == ([4, 3, 0], 0)
    # A copy of bytes that the capture did not keep does not differ from them.
    stream.hold(cut)
    assert not stream.hold(_piece(20, b"0123456789"))


def test_the_time_and_the_place_of_a_chunk_are_those_of_its_stream() -> None:
    stream = _stream()
    stream.latest = (3, 77)
    chunk = stream.deliver(b"abc", 9, None)
    assert (chunk.ts_ns, chunk.data, chunk.link) == (77, b"abc", CONNECTION.link)
    assert chunk.place == (0, 9, None)
    assert (chunk.direction, chunk.connection) == (Direction.REQUEST, CONNECTION)
    assert stream.deliver(b"d", None, None).place == (3, None, None)


def test_bytes_read_elsewhere_are_known_as_delivered() -> None:
    stream = _stream()
    stream.advance(b"abc", 3)
    stream.pass_plain(PlainBytes(2000, b"y" * RECENT_BYTES, 4, 99), arrivals=10)
    assert (stream.position, stream.latest) == (2003, (14, 99))
    assert stream.differs_from_delivered(2003 - RECENT_BYTES, b"xx")
    assert not stream.differs_from_delivered(2001 - RECENT_BYTES, b"xx")
