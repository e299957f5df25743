from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.packets.fragments import (
    FRAGMENT_NS,
    MAX_DATAGRAMS,
    MAX_FRAGMENT_BYTES,
    PIECE_COST,
    Datagram,
    DatagramEnd,
    Fragment,
    Fragments,
    Overlap,
    find_fragment,
)
from tests.packets.building import ipv4, ipv6

_PAYLOAD = bytes(range(48))


def _fragment(
    start: int, data: bytes, *, last: bool = False, number: int = 1, end: int | None = None
) -> Fragment:
    key = (b"\x0a\x00\x00\x01", b"\x0a\x00\x00\x02", 6, number)
    return Fragment(key, 6, start, start + len(data) if end is None else end, last, data)


def _part(start: int, end: int) -> Fragment:
    return _fragment(start, _PAYLOAD[start:end], last=end == len(_PAYLOAD))


def _feed(fragments: list[Fragment], held: Fragments | None = None) -> list[Datagram]:
    held = held or Fragments()
    return [done for each in fragments for done in held.feed(each, 0, "if0")]


def test_reads_a_fragment_of_ipv4() -> None:
    data = ipv4(b"12345678", fragment=0x2003, identification=9, options=bytes(4))

    assert find_fragment(data + b"padding", 0, len(data) + 7) == Fragment(
        (b"\x0a\x00\x00\x01", b"\x0a\x00\x00\x02", 6, 9), 6, 24, 32, last=False, data=b"12345678"
    )


def test_reads_a_fragment_of_ipv6() -> None:
    data = ipv6(bytes.fromhex("06 00 0018 00000009") + b"123", following=44)

    fragment = find_fragment(data, 0, len(data))

    assert fragment is not None
    assert fragment.key[2:] == (0, 9)
    assert fragment[1:] == (6, 24, 27, True, b"123")


def test_a_fragment_that_is_not_the_last_ends_at_a_multiple_of_eight() -> None:
    data = ipv4(b"123456789", fragment=0x2000)

    fragment = find_fragment(data, 0, len(data))

    assert fragment is not None
    assert (fragment.end, fragment.data) == (8, b"12345678")


def test_a_fragment_that_the_capture_cut_keeps_its_length() -> None:
    data = ipv4(b"12345678", fragment=0x2000)

    fragment = find_fragment(data[:-3], 0, len(data))

    assert fragment is not None
    assert (fragment.end, fragment.data) == (8, b"12345")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        ipv4(b"12345678"),
        ipv4(b"12345678", fragment=0x4000),  # don't fragment
        ipv4(b"12345678", fragment=0x2000, protocol=17),
        ipv4(b"1234567", fragment=0x2000),  # less than eight, and not the last
        ipv4(b"", fragment=0x0001),
        ipv4(b"12345678", fragment=0x1FFF),  # beyond any packet's end
        ipv6(b"12345678"),
        ipv6(b"11 00 0001 00000009", following=44),  # UDP
        ipv6(bytes.fromhex("06 00 0001"), following=44),
        b"\x55" + bytes(60),
    ],
)
def test_ignores_packets_that_are_no_fragment_of_tcp(data: bytes) -> None:
    assert find_fragment(data, 0, len(data)) is None


@given(
    cuts=st.sets(st.sampled_from(range(8, 48, 8))),
    shuffle=st.randoms(use_true_random=False),
    copies=st.lists(st.integers(0, 5), max_size=6),
)
def test_any_cuts_order_and_copies_give_the_packet_once(
    cuts: set[int], shuffle: object, copies: list[int]
) -> None:
    assert hasattr(shuffle, "shuffle")
    parts = [_part(*ends) for ends in pairwise([0, *sorted(cuts), 48])]
    parts += [parts[at % len(parts)] for at in copies]
    shuffle.shuffle(parts)

    (whole,) = _feed(parts)

    assert whole.ending is DatagramEnd.WHOLE
    assert whole.payload == _PAYLOAD
    assert whole.overlap is Overlap.NONE


_OVERLAPS = [(0, 16), (8, 16), (16, 24), (16, 32), (8, 32), (0, 48)]


@pytest.mark.parametrize(("start", "end"), _OVERLAPS, ids=str)
def test_the_same_bytes_in_other_cuts_are_an_overlap(start: int, end: int) -> None:
    rest = [_part(0, 8), _part(24, 32), _part(32, 48)]

    (whole,) = _feed([_part(8, 24), _part(start, end), *rest])[:1]

    assert whole.payload == _PAYLOAD
    assert whole.overlap is Overlap.SAME


@pytest.mark.parametrize(("start", "end"), [*_OVERLAPS, (8, 24)], ids=str)
def test_the_first_copy_wins_where_bytes_differ(start: int, end: int) -> None:
    other = _fragment(start, bytes(end - start), last=end == 48)
    rest = [_part(0, 8), _part(24, 32), _part(32, 48)]

    (whole, *_) = _feed([_part(8, 24), other, *rest])

    assert whole.payload[8:24] == _PAYLOAD[8:24]
    assert whole.overlap is Overlap.DIFFERENT


@pytest.mark.parametrize(
    "other",
    [_fragment(40, b"12345678"), _fragment(24, b"12", last=True), _fragment(24, b"1" * 16)],
    ids=["behind the end", "another end", "across the end"],
)
def test_the_first_end_wins(other: Fragment) -> None:
    end = _fragment(24, b"the end", last=True)

    (whole,) = _feed([end, other, _part(0, 24)])

    assert whole.payload == _PAYLOAD[:24] + b"the end"
    assert whole.overlap is Overlap.DIFFERENT


def test_an_end_before_bytes_that_have_come_is_ignored() -> None:
    (whole,) = _feed([_part(8, 24), _fragment(0, b"short", last=True), _part(24, 48), _part(0, 8)])

    assert whole.payload == _PAYLOAD


def test_bytes_behind_a_cut_fragment_are_missing() -> None:
    (whole,) = _feed([_fragment(0, b"1234", end=8), _fragment(8, b"rest", last=True)])

    data, length = whole.packet()
    assert data[20:] == b"1234"
    assert length == 20 + 12


def test_another_packet_may_have_the_same_identification() -> None:
    first = [_part(0, 24), _part(24, 48)]
    second = [_fragment(0, bytes(24)), _fragment(24, bytes(9), last=True)]

    assert [one.payload for one in _feed(first + second)] == [_PAYLOAD, bytes(33)]


def test_a_packet_that_is_not_whole_in_time_is_given_up() -> None:
    held = Fragments()
    held.feed(_part(0, 8), 0, "if0")

    assert held.advance(FRAGMENT_NS - 1) == []
    (given_up,) = held.advance(FRAGMENT_NS)
    assert (given_up.ending, given_up.payload) == (DatagramEnd.INCOMPLETE, _PAYLOAD[:8])
    assert held.close() == []


def test_a_clock_that_steps_back_does_not_keep_packets_for_long() -> None:
    held = Fragments()
    held.feed(_part(0, 8), 10**18, "if0")

    assert len(held.advance(0)) == 1


def test_the_number_of_packets_is_bounded() -> None:
    held = Fragments()
    many = [_fragment(0, b"12345678", number=number) for number in range(MAX_DATAGRAMS)]
    assert _feed(many, held) == []

    (given_up,) = _feed([_fragment(0, b"12345678", number=MAX_DATAGRAMS)], held)

    assert (given_up.ending, given_up.key[3]) == (DatagramEnd.DISCARDED, 0)


def test_a_whole_packet_is_forgotten_without_an_event() -> None:
    held = Fragments()
    _feed([_part(0, 24), _part(24, 48)], held)

    assert held.advance(FRAGMENT_NS) == []
    assert held.cost == 0


@pytest.mark.parametrize("size", [8, 4096])
def test_the_bytes_held_are_bounded(size: int) -> None:
    held, discarded = Fragments(), 0
    count = 2 * MAX_FRAGMENT_BYTES // (size + PIECE_COST)
    for number in range(count):
        at = 2 * size * (number % (60_000 // (2 * size)))
        which = number // (60_000 // (2 * size))
        discarded += len(_feed([_fragment(at, bytes(size), number=which)], held))
        assert held.cost <= MAX_FRAGMENT_BYTES
    assert discarded

    held.close()
    assert held.cost == 0
