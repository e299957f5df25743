from __future__ import annotations

from itertools import pairwise, product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import EventKind, WireEvent
from mbtool.packets.fragments import (
    Datagram,
    DatagramEnd,
    Fragment,
    Fragments,
    Overlap,
    find_fragment,
    fragment_events,
)
from tests.packets.building import ipv4, ipv6

_PAYLOAD = bytes(range(48))

# The limits of the reassembly, as numbers: with others, decode reports other packets as missing.
MAX_DATAGRAMS, MAX_FRAGMENT_BYTES, PIECE_COST = 256, 4 * 1024 * 1024, 256
FRAGMENT_NS = 10_000_000_000


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


_HOPS = bytes.fromhex("2c 00 0104 00000000")  # hop-by-hop options before the fragment header


@pytest.mark.parametrize(
    ("data", "needed", "begin"),
    [
        (ipv4(b"12345678", fragment=0x2003), 20, 20),
        (ipv4(b"12345678", fragment=0x2003, options=bytes(40)), 20, 60),
        (ipv6(bytes.fromhex("06 00 0019 00000009") + b"12345678", following=44), 48, 48),
        (ipv6(_HOPS + bytes.fromhex("06 00 0019 00000009") + b"12345678", following=0), 56, 56),
    ],
    ids=["IPv4", "IPv4 with options", "IPv6", "IPv6 with options"],
)
def test_a_fragment_is_known_as_soon_as_its_headers_are_there(
    data: bytes, needed: int, begin: int
) -> None:
    for at in (0, 14):
        whole = bytes(at) + data
        for end in range(len(whole) + 1):
            found = find_fragment(whole[:end], at, len(whole))
            assert (found is not None) == (end >= at + needed), end
            if found is not None:
                assert found.data == whole[at + begin : end]
                assert (found.start, found.end, found.last) == (24, 32, False)


def test_any_bit_of_a_place_makes_a_fragment_of_ipv4() -> None:
    for bit in range(16):
        data = ipv4(b"12345678", fragment=1 << bit, total=0 if bit == 3 else None)
        found = find_fragment(data, 0, len(data))
        if bit > 13 or bit == 12:  # Reserved, don't fragment; beyond the end of any packet: 32 KiB.
            assert (found is not None) == (bit == 12)
        else:
            assert found is not None
            assert (found.start, found.last) == (0 if bit == 13 else 8 << bit, bit != 13)


@pytest.mark.parametrize(("size", "is_read"), [(3, True), (4, False)])
def test_a_packet_in_fragments_has_at_most_64_kibibytes(size: int, is_read: bool) -> None:
    # 8189 times 8 bytes, and 3: with the header of 20 bytes 65,535.
    for data in (
        ipv4(bytes(size), fragment=8189),
        ipv6(b"\6\0" + (8189 << 3).to_bytes(2) + bytes(4 + size), following=44),
    ):
        assert (find_fragment(data, 0, len(data)) is not None) == is_read


def test_fragments_of_different_packets_have_different_keys() -> None:
    keys = set()
    for source, destination, number in (
        ("10.0.0.1", "10.0.0.2", 1),
        ("10.0.0.3", "10.0.0.2", 1),
        ("10.0.0.1", "10.0.0.3", 1),
        ("10.0.0.1", "10.0.0.2", 0x101),
        ("fd00::1", "fd00::2", 1),
        ("fd00::3", "fd00::2", 1),
        ("fd00::1", "fd00::3", 1),
        ("fd00::1", "fd00::2", 0x1000001),
    ):
        if ":" in source:
            header = b"\6\0\0\1" + number.to_bytes(4)
            data = ipv6(header + bytes(8), source, destination, following=44)
        else:
            data = ipv4(bytes(8), source, destination, fragment=0x2000, identification=number)
        found = find_fragment(data, 0, len(data))
        assert found is not None
        assert found.key[3] == number
        keys.add(found.key)
    assert len(keys) == 8


def test_only_headers_that_may_stand_before_tcp_begin_a_fragment() -> None:
    read = []
    for following in range(256):
        data = ipv6(bytes([following]) + bytes.fromhex("00 0001 00000009") + bytes(8), following=44)
        if find_fragment(data, 0, len(data)) is not None:
            read.append(following)
    assert read == [0, 6, 43, 51, 60, 135, 139, 140]


def test_a_whole_packet_gets_a_plain_header() -> None:
    (whole,) = _feed([_fragment(0, b"12345678", number=7), _fragment(8, b"9", last=True, number=7)])
    data, length = whole.packet()
    assert data == (bytes.fromhex("4500 001d 0000 0000 0006 0000 0a000001 0a000002") + b"123456789")
    assert length == len(data)
    key = (b"\xfd" + bytes(15), b"\xfe" + bytes(15), 0, 7)
    (whole,) = _feed(
        [
            Fragment(key, 60, 0, 8, last=False, data=b"12345678"),
            Fragment(key, 6, 8, 9, last=True, data=b"9"),
        ]
    )
    data, length = whole.packet()
    assert data == bytes.fromhex("60000000 0009 3c 00") + key[0] + key[1] + b"123456789"
    assert length == len(data)


def test_a_packet_that_is_not_whole_reaches_to_its_first_missing_byte() -> None:
    for fragments, payload, length in (
        ([_part(0, 8), _part(16, 24)], _PAYLOAD[:8], 16),
        ([_part(8, 16)], b"", 8),
        ([_part(0, 8), _part(40, 48)], _PAYLOAD[:8], 48),
        ([_fragment(0, b"123", end=8), _part(8, 16)], b"123", 16),
    ):
        held = Fragments()
        _feed(fragments, held)
        (given_up,) = held.close()
        assert given_up.ending is DatagramEnd.INCOMPLETE
        data, claimed = given_up.packet()
        assert (data[20:], claimed) == (payload, 20 + length)


def test_a_contradiction_is_not_forgotten_for_a_mere_overlap() -> None:
    contradiction, overlap = _fragment(0, bytes(16)), _part(8, 24)
    for fragments in ([contradiction, overlap], [overlap, contradiction]):
        (whole, *_) = _feed([_part(0, 16), *fragments, _part(16, 48)])
        assert whole.overlap is Overlap.DIFFERENT


def test_a_copy_of_a_whole_packet_is_ignored_and_anything_else_is_another_packet() -> None:
    for other, is_copy in (
        (_part(0, 8), True),
        (_part(8, 40), True),
        (_part(24, 48), True),
        (_fragment(8, bytes(8)), False),
        (_fragment(40, _PAYLOAD[40:] + b"12345678"), False),
        (_fragment(48, b"12345678"), False),
        (_fragment(8, b"\x08\x09", end=16), True),  # As the capture cut it.
    ):
        held = Fragments()
        assert len(_feed([_part(0, 24), _part(24, 48), other], held)) == 1
        assert (held.close() == []) == is_copy


def test_a_packet_may_become_whole_until_10_s_have_passed() -> None:
    for sign in (1, -1):
        for late, is_whole in ((FRAGMENT_NS - 1, True), (FRAGMENT_NS, False)):
            held = Fragments()
            held.feed(_part(0, 8), 5, "if0")
            (done,) = held.feed(_part(8, 48), 5 + sign * late, "if0")
            assert (done.ending is DatagramEnd.WHOLE) == is_whole


def test_what_is_held_costs_its_bytes_and_the_place_of_each_piece() -> None:
    held = Fragments()
    costs = []
    for fragment in (
        _part(0, 8), _part(0, 8), _part(16, 24), _part(4, 20), _fragment(0, bytes(8), number=2),
        _fragment(24, b"123", end=32), _part(32, 48),
    ):  # fmt: skip
        held.feed(fragment, 0, "if0")
        costs.append(held.cost)
    assert costs == [
        2 * 256 + 8, 2 * 256 + 8, 3 * 256 + 16, 4 * 256 + 24, 6 * 256 + 32,
        7 * 256 + 40, 8 * 256 + 56,
    ]  # fmt: skip
    held.close()
    assert held.cost == 0


def test_four_mebibytes_of_fragments_are_held_and_no_byte_more() -> None:
    held = Fragments()
    size = 64 * 1024 - 2 * PIECE_COST
    full = [_fragment(0, bytes(size), number=number) for number in range(64)]
    assert _feed(full, held) == []
    assert held.cost == MAX_FRAGMENT_BYTES
    (discarded,) = _feed([_fragment(size, b"x", number=63)], held)
    assert (discarded.key[3], discarded.ending) == (0, DatagramEnd.DISCARDED)


@pytest.mark.parametrize(
    ("overlap", "ending", "told"),
    [
        (Overlap.NONE, DatagramEnd.WHOLE, []),
        (Overlap.SAME, DatagramEnd.WHOLE, [(EventKind.OVERLAP, "fragments of a packet overlap")]),
        (
            Overlap.DIFFERENT,
            DatagramEnd.INCOMPLETE,
            [
                (
                    EventKind.OVERLAP,
                    "fragments of a packet contradict each other; the first copy is kept",
                ),
                (EventKind.UNREADABLE, "a packet of which fragments are missing"),
            ],
        ),
        (
            Overlap.NONE,
            DatagramEnd.DISCARDED,
            [
                (
                    EventKind.DISCARDED,
                    "a packet of which fragments are missing, given up since too many are held",
                )
            ],
        ),
    ],
)
def test_what_was_wrong_with_a_packet_is_told(
    overlap: Overlap, ending: DatagramEnd, told: list[tuple[EventKind, str]]
) -> None:
    for total, missing in ((None, 0), (40, 32)):
        datagram = Datagram(_part(0, 8).key, "if7", 0, 6, overlap=overlap, ending=ending)
        datagram.add(_part(0, 8))
        datagram.total = total
        assert fragment_events(datagram, 99, 5000, 502) == [
            WireEvent(
                ts_ns=99,
                link="if7",
                kind=kind,
                message=message,
                source="10.0.0.1:5000",
                destination="10.0.0.2:502",
                raw=_PAYLOAD[:8],
                missing=missing,
            )
            for kind, message in told
        ]


def test_the_bytes_that_came_first_are_kept_whatever_three_fragments_come() -> None:
    kinds = [*product((0, 8, 16), (8, 16), (False, True), (False, True))]
    for sent in product(kinds, repeat=3):
        datagram = Datagram(_part(0, 8).key, "if0", 0, 6)
        first: dict[int, int] = {}
        end: int | None = None
        differs = False
        for number, (start, size, is_last, is_other) in enumerate(sent):
            at, byte = range(start, start + size, 4), number + 1 if is_other else 7
            datagram.add(_fragment(start, bytes([byte]) * size, last=is_last))
            if is_last and end is None and at.stop > max(first, default=0):
                end = at.stop
            elif (end is not None and at.stop > end) or (is_last and at.stop != end):
                differs = True
                continue
            differs |= any(first.get(place, byte) != byte for place in at)
            for place in at:
                first.setdefault(place, byte)
        leading = next(place for place in range(0, 99, 4) if place not in first)
        assert datagram.payload[::4] == bytes(first[place] for place in range(0, leading, 4)), sent
        assert (datagram.held, datagram.total) == (4 * len(first), end), sent
        assert (datagram.overlap is Overlap.DIFFERENT) == differs, sent


def test_the_fragment_at_0_says_what_its_packet_begins_with() -> None:
    # RFC 8200, 4.5: the others may say something else.
    key = (b"\xfd" + bytes(15), b"\xfe" + bytes(15), 0, 7)
    parts = [
        Fragment(key, 60, 0, 8, last=False, data=b"12345678"),
        Fragment(key, 6, 8, 9, last=True, data=b"9"),
    ]
    for order in (parts, parts[::-1]):
        (whole,) = _feed(order)
        assert whole.packet()[0][6] == 60
