from __future__ import annotations

from dataclasses import replace
from itertools import groupby, permutations, product
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Chunk, Connection, Direction, Endpoint, EventKind
from mbtool.packets.connection import TcpConnection
from mbtool.packets.reassembler import TcpReassembler
from mbtool.packets.segment import ACK, FIN, RST, SYN
from mbtool.packets.stream_events import CloseReason, StreamClosed, StreamGap, StreamOpened
from tests.packets.building import MASTER, MASTER_PORT, SLAVE, SLAVE_PORT, End, Talk, cut
from tests.packets.reading import close_reasons, run_packets, wire_events, words_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import Packet

_MASTER = Endpoint("10.0.0.1", 49152)
_SLAVE = Endpoint("10.0.0.2", 502)
_MS = 1_000_000

# The limits of a connection, as numbers: with others, decode reports other gaps and events.
PATIENCE, PATIENCE_NS, HOLE_NS = 3, 100_000_000, 10_000_000_000
WINDOW = 1024 * 1024
MAX_HELD_BYTES, MAX_HELD_PIECES = 64 * 1024, 64


def test_joins_in_mid_stream_at_the_first_payload() -> None:
    talk = Talk()
    old = talk.at(talk.master, 990, b"0123456789")
    packets = [talk.send(talk.slave), talk.request(b"ask"), talk.response(b"tell")]
    packets += [talk.request(b"again"), talk.response(b"TELL"), old]

    items = run_packets(packets)

    assert isinstance(items[0], StreamOpened)
    assert items[0].joined
    assert words_of(items) == [">ask", "<tell", ">again", "<TELL"]


@pytest.mark.parametrize("order", list(permutations(range(4))), ids=str)
def test_the_first_packets_of_a_joined_connection_may_be_swapped(order: tuple[int, ...]) -> None:
    talk = Talk()
    packets = [talk.request(b"a"), talk.request(b"bc"), talk.response(b"d"), talk.response(b"ef")]

    items = run_packets([packets[at] for at in order] + [talk.request(b"g"), talk.response(b"h")])

    assert words_of(items) == [">a", ">bc", "<d", "<ef", ">g", "<h"]
    assert [item.ts_ns // _MS for item in items if isinstance(item, Chunk)][-2:] == [5, 6]


def test_the_beginning_of_a_joined_stream_is_decided_after_a_while() -> None:
    talk = Talk()
    reassembler = TcpReassembler()
    assert words_of(run_packets([talk.request(b"ask")], reassembler, close=False)) == []

    assert words_of(reassembler.advance(_MS + PATIENCE_NS)) == [">ask"]


def test_bytes_behind_those_that_a_joined_connection_acknowledged_are_missing() -> None:
    talk = Talk()
    packets = [talk.request(b"ask")]
    talk.response(b"lost")
    packets += [talk.response(b"tell"), *(talk.request(b"again") for _ in range(4))]

    gaps = [item for item in run_packets(packets) if isinstance(item, StreamGap)]

    assert [(gap.direction, gap.missing) for gap in gaps] == [(Direction.RESPONSE, 4)]


def test_a_handshake_without_its_second_segment_tells_where_the_slave_begins() -> None:
    talk = Talk()
    syn, _, third = talk.handshake()
    packets = [syn, third]
    talk.request(b"ask")
    talk.response(b"lost")
    packets += [talk.request(b"again"), talk.response(b"tell")]
    packets += [talk.request(b"more") for _ in range(4)]

    gaps = [item for item in run_packets(packets) if isinstance(item, StreamGap)]

    assert {(gap.direction, gap.missing) for gap in gaps} == {
        (Direction.REQUEST, 3),
        (Direction.RESPONSE, 4),
    }


@pytest.mark.parametrize("place", [0, 1, 2, 3, 4])
def test_a_syn_that_the_capture_put_behind_bytes_opens_nothing(place: int) -> None:
    talk = Talk()
    syn, *others = talk.handshake()
    packets = [*others, talk.request(b"ask"), talk.request(b" more"), talk.response(b"tell")]

    items = run_packets([*packets[:place], syn, *packets[place:]])

    assert words_of(items) == [">ask", "> more", "<tell"]
    assert len([item for item in items if isinstance(item, StreamOpened)]) == 1


@pytest.mark.parametrize(
    ("segments", "said"),
    [
        ([(0, "abc"), (3, "def")], [">abc", ">def"]),
        ([(0, "abc"), (0, "abc"), (3, "def")], [">abc", ">def"]),
        ([(0, "abc"), (0, "abcdef")], [">abc", ">def"]),
        ([(0, "abc"), (1, "bcde")], [">abc", ">de"]),
        ([(3, "def"), (0, "abc")], [">abc", ">def"]),
        ([(3, "def"), (3, "def"), (0, "abc")], [">abc", ">def"]),
        ([(6, "gh"), (3, "def"), (0, "abc")], [">abc", ">def", ">gh"]),
        ([(3, "def"), (0, "abcd")], [">abc", ">def"]),
        ([(4, "e"), (2, "cdefg"), (0, "ab")], [">ab", ">cd", ">e", ">fg"]),
        ([(0, "abc"), (2, "?"), (3, "def")], [">abc", ">def"]),
        ([(0, "abc"), (9, "jkl")], [">abc", 6, ">jkl"]),
        ([(3, "def")], [3, ">def"]),
    ],
    ids=[
        "in order",
        "sent again",
        "sent again with more",
        "overlapping",
        "reordered",
        "reordered and sent again",
        "backwards",
        "reordered and overlapping",
        "around a piece",
        "keep-alive with a byte",
        "lost in the middle",
        "lost at the start",
    ],
)
@pytest.mark.parametrize("first", [1000, 2**32 - 1, 2**32 - 4])
def test_puts_segments_in_order(
    first: int, segments: list[tuple[int, str]], said: list[str | int]
) -> None:
    talk = Talk(master=End(MASTER, MASTER_PORT, first - 1))
    packets = talk.handshake()
    packets += [talk.at(talk.master, first + at, data.encode()) for at, data in segments]

    items = run_packets(packets)

    assert words_of(items) == said
    assert wire_events(items) == []


# A second segment against a first of three bytes at 3, in the six ways that two can overlap.
_OVERLAPS = {
    "begins before and ends inside": (1, 4),
    "begins before and ends with it": (1, 6),
    "covers it": (1, 8),
    "stands inside": (4, 5),
    "begins with it and ends behind": (3, 8),
    "begins inside and ends behind": (5, 8),
}
_LETTERS = "abcdefgh"


@pytest.mark.parametrize(("start", "end"), _OVERLAPS.values(), ids=list(_OVERLAPS))
def test_the_first_copy_wins_in_every_overlap(start: int, end: int) -> None:
    for first in (1000, 2**32 - 1, 2**32 - 4, 2**32 - 6):
        for sender, delivered, differs in product(
            ("master", "slave"), (False, True), (False, True)
        ):
            first_copy_wins(first, start, end, sender, delivered=delivered, differs=differs)


def first_copy_wins(
    first: int, start: int, end: int, sender: str, *, delivered: bool, differs: bool
) -> None:
    talk = Talk(End(MASTER, MASTER_PORT, first - 1), End(SLAVE, SLAVE_PORT, first - 1))
    packets = talk.handshake()
    by = talk.master if sender == "master" else talk.slave

    def sent(begin: int, behind: int, text: str = _LETTERS) -> Packet:
        return talk.at(by, first + begin, text[begin:behind].encode())

    known, second = sent(3, 6), sent(start, end, "ABCDEFGH" if differs else _LETTERS)
    packets += [sent(0, 3), known, second] if delivered else [known, second, sent(0, 3)]
    items = run_packets([*packets, sent(6, 8)])

    said = "".join(str(part)[1:] for part in words_of(items))
    expected = list(_LETTERS)
    if differs:
        for at in range(start, end):
            if at >= 6 or (at < 3 and not delivered):
                expected[at] = _LETTERS[at].upper()
    assert said == "".join(expected)
    assert {event.kind for event in wire_events(items)} == (
        {EventKind.OVERLAP} if differs else set()
    )


@pytest.mark.parametrize("distance", range(12))
def test_sequence_numbers_wrap_in_both_directions(distance: int) -> None:
    start = 2**32 - distance
    talk = Talk(End(MASTER, MASTER_PORT, start), End(SLAVE, SLAVE_PORT, start + 3))
    packets = talk.handshake()
    for number in range(3):
        packets += [talk.request(f"ask{number}".encode()), talk.response(f"tell{number}".encode())]
    packets[4], packets[5] = packets[5], packets[4]
    lost = packets.pop(6)
    assert b"tell1" in lost.data

    items = run_packets([*packets, *talk.goodbye()])

    assert words_of(items) == [">ask0", "<tell0", ">ask1", 5, ">ask2", "<tell2"]
    assert close_reasons(items) == [CloseReason.FINISHED]


def test_bytes_that_come_after_their_gap_are_one_event() -> None:
    talk = Talk()
    packets = talk.handshake()
    late = talk.request(b"late")
    packets += [talk.request(b"ask"), *(talk.response(str(at).encode()) for at in range(4))]

    items = run_packets([*packets, late, late])

    assert words_of(items) == [4, ">ask", "<0", "<1", "<2", "<3"]
    (event,) = wire_events(items)
    assert (event.kind, event.raw) == (EventKind.DISCARDED, b"late")
    assert event.message == "bytes that came after their gap was told"


@pytest.mark.parametrize("payload", [b"", b"\0"], ids=["without a byte", "with a byte"])
def test_keep_alive_probes_are_counted(payload: bytes) -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]
    for _ in range(3):
        packets += [talk.at(talk.master, talk.master.sequence - 1, payload), talk.send(talk.slave)]
    packets += [talk.at(talk.slave, talk.slave.sequence - 1, payload)]

    items = run_packets([*packets, *talk.goodbye()])

    assert words_of(items) == [">ask", "<tell"]
    assert wire_events(items) == []
    (closed,) = [item for item in items if isinstance(item, StreamClosed)]
    assert closed.keep_alives == 4


def test_keep_alive_probes_without_an_answer_are_counted() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]
    probe = talk.at(talk.slave, talk.slave.sequence - 1)
    packets += [probe, talk.send(talk.master), probe, probe, probe]

    items = run_packets([*packets, talk.send(talk.slave, flags=RST | ACK)])

    (closed,) = [item for item in items if isinstance(item, StreamClosed)]
    assert (closed.reason, closed.keep_alives) == (CloseReason.RESET, 4)
    assert closed.unanswered_probes == 3


def test_a_connection_joined_at_a_keep_alive_probe_begins_behind_it() -> None:
    talk = Talk()
    packets = [talk.send(talk.master), talk.at(talk.master, 999, b"\0"), talk.send(talk.slave)]
    talk.ts_ns += PATIENCE_NS
    packets += [talk.request(b"ask"), talk.response(b"tell")]

    items = run_packets(packets)

    assert words_of(items) == [">ask", "<tell"]
    (closed,) = [item for item in items if isinstance(item, StreamClosed)]
    assert closed.keep_alives == 1


def test_acknowledgements_and_copies_are_no_keep_alive_probes() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]

    copies = [talk.at(talk.master, talk.master.sequence - 2, b"s")]  # One byte, not the last.
    copies += [talk.at(talk.master, talk.master.sequence - 1, b"k!")]  # The last, and one more.
    talk.request(b"!")
    items = run_packets([*packets, *packets, *copies, talk.send(talk.master), *talk.goodbye()])

    (closed,) = [item for item in items if isinstance(item, StreamClosed)]
    assert closed.keep_alives == 0


@pytest.mark.parametrize(
    ("segments", "said", "raw"),
    [
        ([(0, "abc"), (0, "aXc"), (3, "d")], [">abc", ">d"], b"aXc"),
        ([(0, "abc"), (0, "XXXdef")], [">abc", ">def"], b"XXXdef"),
        ([(3, "def"), (3, "dXf"), (0, "abc")], [">abc", ">def"], b"dXf"),
    ],
    ids=["delivered", "delivered in part", "held"],
)
def test_the_first_copy_wins_and_a_difference_is_one_event(
    segments: list[tuple[int, str]], said: list[str | int], raw: bytes
) -> None:
    talk = Talk()
    packets = talk.handshake()
    packets += [talk.at(talk.master, 1001 + at, data.encode()) for at, data in segments]

    items = run_packets(packets)

    assert words_of(items) == said
    (event,) = wire_events(items)
    assert (event.kind, event.link, event.raw) == (EventKind.OVERLAP, "10.0.0.2", raw)
    assert (event.source, event.destination) == (str(_MASTER), str(_SLAVE))


def test_a_segment_sent_again_after_a_while_is_told_once() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask")]
    for wait_ms in (0, 200, 400):
        talk.ts_ns += wait_ms * _MS
        packets.append(talk.at(talk.master, 1001, b"ask"))
    packets.append(talk.response(b"tell"))

    items = run_packets(packets)

    assert words_of(items) == [">ask", "<tell"]
    (event,) = wire_events(items)
    assert (event.kind, event.raw) == (EventKind.SENT_AGAIN, b"ask")
    assert event.message == "a TCP segment sent again after 202 ms"


def test_a_copy_at_once_and_a_keep_alive_probe_are_not_sent_again() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.at(talk.master, 1001, b"ask")]
    talk.ts_ns += 45_000 * _MS
    packets.append(talk.at(talk.master, 1003, b"k"))

    assert wire_events(run_packets(packets)) == []


def test_bytes_behind_a_filled_hole_have_the_time_of_the_segment_that_filled_it() -> None:
    talk = Talk()
    late = talk.at(talk.master, 1004, b"def")
    filling = talk.at(talk.master, 1001, b"abc")
    afterwards = talk.at(talk.master, 1007, b"ghi")

    items = run_packets([*Talk().handshake(), late, filling, afterwards])

    times = [(item.data, item.ts_ns) for item in items if isinstance(item, Chunk)]
    assert times == [(b"abc", 2 * _MS), (b"def", 2 * _MS), (b"ghi", 3 * _MS)]


def test_bytes_behind_a_gap_keep_their_own_time() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.at(talk.master, 1004, b"def")]

    items = run_packets(packets, close=False)
    assert words_of(items) == []
    items = run_packets([*packets, talk.at(talk.slave, 5001)])

    gap = StreamGap(4 * _MS, Connection(_MASTER, _SLAVE), Direction.REQUEST, 3, EventKind.GAP)
    assert gap in items
    assert [item.ts_ns for item in items if isinstance(item, Chunk)] == [4 * _MS]


def test_a_gap_tells_when_its_bytes_were_first_acknowledged() -> None:
    talk = Talk()
    packets = talk.handshake()
    talk.request(b"abc")  # The capture lacks it.
    packets += [talk.send(talk.slave), talk.request(b"def"), talk.send(talk.slave)]
    (gap,) = [one for one in run_packets(packets) if isinstance(one, StreamGap)]
    assert (gap.missing, gap.ts_ns, gap.acknowledged_ns) == (3, 6 * _MS, 5 * _MS)


def test_an_acknowledged_hole_is_given_up_after_a_few_packets() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"first"), talk.response(b"FIRST")]
    talk.request(b"lost")
    packets += [talk.response(b"LOST"), talk.request(b"third")]
    assert words_of(run_packets(packets, close=False)) == [">first", "<FIRST"]

    packets += [talk.response(b"THIRD"), talk.request(b"fourth")]
    items = run_packets(packets, close=False)

    # All bytes after the lost request wait for it, then come in order.
    assert len(packets) - 6 == PATIENCE
    assert words_of(items) == [">first", "<FIRST", 4, "<LOST", ">third", "<THIRD", ">fourth"]


def test_an_acknowledged_hole_is_given_up_after_a_while() -> None:
    talk = Talk()
    packets = talk.handshake()
    talk.request(b"lost")
    packets += [talk.response(b"LOST"), talk.request(b"second")]
    reassembler = TcpReassembler()
    assert words_of(run_packets(packets, reassembler, close=False)) == []

    assert words_of(reassembler.advance(4 * _MS + PATIENCE_NS)) == []
    assert words_of(reassembler.advance(5 * _MS + PATIENCE_NS)) == [4, "<LOST", ">second"]


def test_a_hole_without_an_acknowledgement_is_given_up_later() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.at(talk.master, 1004, b"def")]
    reassembler = TcpReassembler()
    run_packets(packets, reassembler, close=False)

    assert words_of(reassembler.advance(4 * _MS + HOLE_NS - 1)) == []
    assert words_of(reassembler.advance(4 * _MS + HOLE_NS)) == [3, ">def"]


def test_a_lost_response_is_a_gap_before_the_next_response() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"first")]
    talk.response(b"LOST")
    packets += [talk.request(b"second"), talk.response(b"SECOND"), *talk.goodbye()]

    items = run_packets(packets)

    assert words_of(items) == [">first", 4, ">second", "<SECOND"]
    (gap,) = [item for item in items if isinstance(item, StreamGap)]
    assert gap.direction is Direction.RESPONSE


def test_a_response_never_comes_before_its_request() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]
    packets[3], packets[4] = packets[4], packets[3]

    assert words_of(run_packets(packets)) == [">ask", "<tell"]


def test_a_false_acknowledgement_loses_no_bytes() -> None:
    talk = Talk()
    packets = talk.handshake()
    talk.master.sequence += 500
    packets += [talk.response(str(number).encode()) for number in range(5)]
    talk.master.sequence -= 500
    packets += [talk.request(b"ask")]

    said = words_of(run_packets(packets))
    assert said == ["<0", "<1", "<2", "<3", "<4", ">ask", 497]  # A gap at the end, not before.


def test_bytes_that_the_snapshot_length_cut_off_are_a_gap_behind_the_rest() -> None:
    talk = Talk()
    packets = talk.handshake()
    packets += [cut(talk.request(b"abcdef"), 54 + 2), talk.request(b"ghi")]

    items = run_packets(packets)

    assert words_of(items) == [">ab", 4, ">ghi"]
    (gap,) = [item for item in items if isinstance(item, StreamGap)]
    assert gap.kind is EventKind.CUT


def test_a_syn_may_carry_bytes() -> None:
    talk = Talk()
    packets = [talk.at(talk.master, 1000, b"early", SYN), talk.at(talk.master, 1006, b"late")]

    assert words_of(run_packets(packets)) == [">early", ">late"]


@pytest.mark.parametrize("is_acknowledged", [False, True])
@pytest.mark.parametrize("counted", [0, 1])
def test_a_syn_with_bytes_may_not_be_counted(counted: int, is_acknowledged: bool) -> None:
    talk = Talk()
    start = 1005 + counted
    packets = [talk.at(talk.master, 1000, b"early", SYN)]
    if is_acknowledged:
        talk.master.sequence = start
        packets.append(talk.response(b"answer"))
    packets += [talk.at(talk.master, start, b"late"), talk.at(talk.master, start + 4, b"r")]

    items = run_packets(packets)

    answer = ["<answer"] if is_acknowledged else []
    assert words_of(items) == [">early", *answer, ">late", ">r"]
    assert wire_events(items) == []
    receipts = [one.place.acknowledged for one in items if isinstance(one, Chunk) and one.place]
    if is_acknowledged:
        assert receipts[1] == len(b"early")


def test_a_syn_with_bytes_that_comes_twice_is_counted_once() -> None:
    talk = Talk()
    syn = talk.at(talk.master, 1000, b"early", SYN)
    packets = [syn, syn, talk.at(talk.master, 1005, b"late"), talk.at(talk.master, 1009, b"more")]

    assert words_of(run_packets(packets)) == [">early", ">late", ">more"]


def test_an_acknowledgement_of_a_syn_alone_decides_nothing() -> None:
    talk = Talk()
    packets = [
        talk.at(talk.master, 1000, b"early", SYN),
        talk.at(talk.slave, 5000, flags=SYN | ACK),
        talk.at(talk.master, 1006, b"late"),
    ]

    assert words_of(run_packets(packets)) == [">early", ">late"]


def test_a_syn_sent_again_opens_nothing() -> None:
    talk = Talk()
    syn, *others = talk.handshake()

    items = run_packets([syn, syn, *others, others[0], talk.request(b"ask")])

    assert len([item for item in items if isinstance(item, StreamOpened)]) == 1
    assert words_of(items) == [">ask"]


def test_half_of_a_connection_may_close_first() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.send(talk.master, flags=FIN | ACK)]
    packets += [talk.response(b"tell"), talk.send(talk.slave, flags=FIN | ACK)]

    items = run_packets(packets)

    assert words_of(items) == [">ask", "<tell"]
    assert close_reasons(items) == [CloseReason.FINISHED]


def test_bytes_that_come_behind_fin_in_the_capture_are_delivered() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), *talk.goodbye()]
    packets[3], packets[4] = packets[4], packets[3]

    items = run_packets(packets)

    assert words_of(items) == [">ask"]
    assert close_reasons(items) == [CloseReason.FINISHED]


def test_a_fin_far_from_the_bytes_in_flight_ends_nothing() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask")]
    packets += [
        talk.at(end, end.sequence - 2 * WINDOW, flags=FIN | ACK)
        for end in (talk.master, talk.slave)
    ]

    items = run_packets([*packets, talk.response(b"tell")])

    assert words_of(items) == [">ask", "<tell"]
    assert close_reasons(items) == [CloseReason.CAPTURE_END]


def test_a_reset_ends_a_connection() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.send(talk.slave, flags=RST | ACK)]

    items = run_packets([*packets, packets[3], packets[4]])

    assert words_of(items) == [">ask"]
    assert close_reasons(items) == [CloseReason.RESET]


def test_a_reset_in_answer_to_a_syn_is_a_refusal() -> None:
    talk = Talk()

    items = run_packets([talk.send(talk.master, flags=SYN), talk.send(talk.slave, flags=RST | ACK)])

    assert close_reasons(items) == [CloseReason.REFUSED]


@pytest.mark.parametrize("is_master_first", [True, False])
@pytest.mark.parametrize("flags", [RST | ACK, FIN | ACK])
def test_the_end_of_a_connection_says_who_sent_the_reset_or_the_first_fin(
    flags: int, is_master_first: bool
) -> None:
    talk = Talk()
    first, second = (talk.master, talk.slave) if is_master_first else (talk.slave, talk.master)
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]
    packets += [talk.send(first, flags=flags), talk.send(second, flags=flags), talk.send(first)]

    (closed,) = [item for item in run_packets(packets) if isinstance(item, StreamClosed)]

    assert closed.by is (Direction.REQUEST if is_master_first else Direction.RESPONSE)


@pytest.mark.parametrize(
    ("later_ms", "reason"),
    [(1000, CloseReason.UNANSWERED), (900, CloseReason.CAPTURE_END)],
)
def test_a_syn_without_any_answer_for_a_second_is_an_unanswered_connection(
    later_ms: int, reason: CloseReason
) -> None:
    talk = Talk()
    syn = talk.send(talk.master, flags=SYN)
    again = replace(syn, ts_ns=syn.ts_ns + later_ms * _MS)
    assert close_reasons(run_packets([syn, again])) == [reason]
    # An acknowledgement shows that the capture lacks the slave's packets.
    third = replace(talk.send(talk.master), ts_ns=again.ts_ns)
    assert close_reasons(run_packets([syn, third])) == [CloseReason.CAPTURE_END]


def test_a_jump_of_the_sequence_numbers_is_a_gap_of_unknown_length() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"one")]
    talk.master.sequence += WINDOW + 1
    packets += [talk.request(b"two"), talk.response(b"TWO"), talk.request(b"three")]

    assert words_of(run_packets(packets)) == [">one", 0, ">two", "<TWO", ">three"]


def test_the_number_of_held_pieces_is_limited() -> None:
    talk = Talk()
    packets = talk.handshake()
    packets += [talk.at(talk.master, 1002 + at, b"x") for at in range(MAX_HELD_PIECES)]
    assert words_of(run_packets(packets, close=False)) == []

    packets.append(talk.at(talk.master, 1002 + MAX_HELD_PIECES, b"x"))

    assert words_of(run_packets(packets, close=False)) == [1, *[">x"] * (MAX_HELD_PIECES + 1)]


def test_the_number_of_held_bytes_is_limited() -> None:
    talk = Talk()
    block = MAX_HELD_BYTES // 4
    packets = talk.handshake()
    packets += [talk.at(talk.master, 1002 + at * block, b"x" * block) for at in range(4)]
    assert words_of(run_packets(packets, close=False)) == []

    packets.append(talk.at(talk.master, 1002 + 4 * block, b"x"))

    assert words_of(run_packets(packets, close=False)) == [1, *[">" + "x" * block] * 4, ">x"]


@given(
    first=st.integers(0, 2**32 - 1),
    sizes=st.lists(st.integers(1, 9), min_size=1, max_size=30),
    shuffle=st.randoms(use_true_random=False),
    copies=st.lists(st.integers(0, 29), max_size=10),
)
def test_any_cuts_copies_and_order_give_the_same_bytes(
    first: int, sizes: list[int], shuffle: object, copies: list[int]
) -> None:
    assert hasattr(shuffle, "shuffle")
    talk = Talk(master=End(MASTER, MASTER_PORT, first))
    syn = talk.send(talk.master, flags=SYN)
    text = "".join(chr(0x30 + at % 64) for at in range(sum(sizes)))
    segments, at = [], 0
    for size in sizes:
        segments.append(talk.request(text[at : at + size].encode()))
        at += size
    segments += [segments[index % len(segments)] for index in copies]
    shuffle.shuffle(segments)

    items = run_packets([syn, *segments])

    said = words_of(items)
    assert "".join(str(part).removeprefix(">") for part in said) == text
    assert wire_events(items) == []


@given(
    exchanges=st.lists(st.tuples(st.integers(1, 3), st.integers(1, 3)), min_size=1, max_size=10),
    swaps=st.sets(st.integers(0, 70)),
    copies=st.sets(st.integers(0, 70)),
)
def test_swapped_and_doubled_packets_give_the_same_conversation(
    exchanges: list[tuple[int, int]], swaps: set[int], copies: set[int]
) -> None:
    talk = Talk()
    packets = talk.handshake()
    wanted = []
    for number, (asked, told) in enumerate(exchanges):
        packets += [talk.request(f"ask{number}.{part}".encode()) for part in range(asked)]
        packets += [talk.response(f"tell{number}.{part}".encode()) for part in range(told)]
        wanted.append(">" + "".join(f"ask{number}.{part}" for part in range(asked)))
        wanted.append("<" + "".join(f"tell{number}.{part}" for part in range(told)))
    packets += talk.goodbye()
    for at in range(3, len(packets) - 1):
        if at in swaps and at - 1 not in swaps:
            packets[at], packets[at + 1] = packets[at + 1], packets[at]
    doubled = [
        each for at, one in enumerate(packets) for each in [one] * (2 if at in copies else 1)
    ]

    items = run_packets(doubled)

    said = [str(part) for part in words_of(items)]
    groups = groupby(said, key=lambda part: part[0])
    assert [side + "".join(part[1:] for part in parts) for side, parts in groups] == wanted
    assert len([item for item in items if isinstance(item, StreamClosed)]) == 1


@given(lost=st.integers(0, 19), pipelined=st.booleans())
def test_a_lost_segment_loses_only_its_own_bytes(lost: int, pipelined: bool) -> None:
    talk = Talk()
    packets = talk.handshake()
    names = [f"{number:02}" for number in range(20)]
    for at, name in enumerate(names):
        sender = talk.master if pipelined or at % 2 == 0 else talk.slave
        packets.append(talk.send(sender, name.encode()))
    packets += talk.goodbye()
    del packets[3 + lost]

    said = words_of(run_packets(packets))

    words = [part[1:] for part in said if isinstance(part, str)]
    assert words == [name for at, name in enumerate(names) if at != lost]
    assert [part for part in said if isinstance(part, int)] == [2]


@pytest.mark.parametrize(
    ("distance", "said"),
    [
        (WINDOW, [WINDOW, ">two"]),
        (WINDOW + 1, [0, ">two"]),
        (-WINDOW, []),
        (-WINDOW - 1, [0, ">two"]),
    ],
)
def test_a_mebibyte_is_the_farthest_that_a_segment_may_be_from_the_next_byte(
    distance: int, said: list[str | int]
) -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"one")]
    packets += [talk.at(talk.master, talk.master.sequence + distance, b"two")]
    assert words_of(run_packets(packets)) == [">one", *said]


def test_a_jump_while_a_hole_is_open_tells_the_hole_first() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.at(talk.master, 1004, b"def")]
    packets += [talk.at(talk.master, 1001 + 2 * WINDOW, b"two")]
    assert words_of(run_packets(packets)) == [3, ">def", 0, ">two"]


def test_a_jump_before_a_joined_stream_has_begun_is_no_gap() -> None:
    talk = Talk()
    packets = [talk.response(b"told"), talk.at(talk.master, 1000 + 2 * WINDOW, b"two")]
    assert words_of(run_packets(packets)) == ["<told", ">two"]
    one, two = talk.request(b"one"), talk.at(talk.master, 1000 + 2 * WINDOW, b"two")
    assert words_of(run_packets([one, two])) == [">one", 0, ">two"]


@pytest.mark.parametrize(("ahead", "missing"), [(1, [1]), (WINDOW, [WINDOW]), (WINDOW + 1, [])])
def test_an_acknowledgement_far_ahead_is_no_gap_at_the_end(ahead: int, missing: list[int]) -> None:
    talk = Talk()
    packets = talk.handshake()
    talk.master.sequence += ahead
    packets += [talk.send(talk.slave)]
    assert words_of(run_packets(packets)) == missing


@pytest.mark.parametrize(("ahead", "missing"), [(0, []), (1, [1]), (WINDOW, [WINDOW])])
def test_bytes_before_a_fin_that_never_came_are_a_gap_at_the_end(
    ahead: int, missing: list[int]
) -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.at(talk.master, 1001 + ahead, b"", FIN | ACK)]
    items = run_packets(packets)
    assert words_of(items) == missing
    assert close_reasons(items) == [CloseReason.CAPTURE_END]


def _lost_request(later: int, wait_ns: int = 0) -> list[str | int]:
    """What is said when a request is lost, and some packets come behind the response to it."""
    talk = Talk()
    packets = talk.handshake()
    talk.request(b"lost")
    packets += [talk.response(b"LOST")]
    talk.ts_ns += wait_ns
    packets += [talk.send(talk.slave) for _ in range(later)]
    return words_of(run_packets(packets, close=False))


@pytest.mark.parametrize(
    ("later", "wait_ns", "is_given_up"),
    [
        (2, 0, False),
        (3, 0, True),
        (1, PATIENCE_NS - 2 * _MS, False),
        (1, PATIENCE_NS - _MS, True),
    ],
)
def test_a_response_waits_for_three_packets_or_a_tenth_of_a_second(
    later: int, wait_ns: int, is_given_up: bool
) -> None:
    assert _lost_request(later, wait_ns) == (["<LOST"] if is_given_up else [])


@pytest.mark.parametrize(
    ("later", "wait_ns", "is_probe"),
    [
        (2, 0, False),
        (3, 0, True),
        (1, PATIENCE_NS - 2 * _MS, False),
        (1, PATIENCE_NS - _MS, True),
    ],
)
def test_a_single_first_byte_is_a_probe_if_none_follows_it_in_time(
    later: int, wait_ns: int, is_probe: bool
) -> None:
    talk = Talk()
    packets = [talk.at(talk.master, 999, b"\0")]
    talk.ts_ns += wait_ns
    packets += [talk.send(talk.slave) for _ in range(later)]
    packets += [talk.request(b"ask")]
    items = run_packets(packets)
    (closed,) = [item for item in items if isinstance(item, StreamClosed)]
    assert words_of(items) == ([">ask"] if is_probe else [">\0", ">ask"])
    assert closed.keep_alives == is_probe


@pytest.mark.parametrize("payload", [b"e", b"ea"])
@pytest.mark.parametrize("counted", [0, 1])
def test_a_syn_with_one_byte_always_counts(payload: bytes, counted: int) -> None:
    talk = Talk()
    packets = [talk.at(talk.master, 1000, payload, SYN)]
    start = 1000 + len(payload) + counted
    packets += [talk.at(talk.master, start, b"late")]
    # One byte at one place less than the next could be a probe, so it decides nothing.
    is_cut = len(payload) == 1 and not counted
    said = [">" + payload.decode(), ">ate" if is_cut else ">late"]
    assert words_of(run_packets(packets)) == said


@pytest.mark.parametrize(
    ("packets", "reason"),
    [
        (lambda talk: [talk.send(talk.slave, flags=RST | ACK)], CloseReason.REFUSED),
        (lambda talk: [talk.send(talk.master, flags=RST)], CloseReason.RESET),
        (
            lambda talk: [
                talk.at(talk.master, 1001, b"early"), talk.send(talk.slave, flags=RST | ACK),
            ],
            CloseReason.RESET,
        ),
        (
            lambda talk: [
                talk.at(talk.master, 1009, b"held"), talk.send(talk.slave, flags=RST | ACK),
            ],
            CloseReason.RESET,
        ),
        (
            lambda talk: [
                talk.send(talk.slave, flags=SYN | ACK), talk.send(talk.slave, flags=RST | ACK),
            ],
            CloseReason.RESET,
        ),
    ],
    ids=["at once", "by the master", "after bytes", "after held bytes", "after its SYN"],
)  # fmt: skip
def test_only_a_slave_that_resets_before_any_byte_refuses(
    packets: Callable[[Talk], list[Packet]], reason: CloseReason
) -> None:
    talk = Talk()
    syn = talk.send(talk.master, flags=SYN)
    assert close_reasons(run_packets([syn, *packets(talk)])) == [reason]


def test_probes_are_unanswered_until_the_other_end_sends_anything() -> None:
    def probes(*senders: str) -> tuple[int, int]:
        talk = Talk()
        packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]
        ends = {"m": talk.master, "s": talk.slave}
        for sender in senders:
            end = ends[sender.lower()]
            packets.append(talk.at(end, end.sequence - 1) if sender.islower() else talk.send(end))
        items = run_packets(packets)
        (closed,) = [item for item in items if isinstance(item, StreamClosed)]
        return closed.keep_alives, closed.unanswered_probes

    assert probes() == (0, 0)
    assert probes("m", "m") == (2, 2)
    assert probes("m", "S") == (1, 0)
    assert probes("m", "s") == (2, 1)  # A probe of the other end answers, and is one.
    assert probes("m", "M", "m") == (2, 2)
    assert probes("s", "s", "M", "s") == (3, 1)
    assert probes("m", "m", "s", "s", "s") == (5, 3)


@pytest.mark.parametrize("flags", [FIN | ACK, SYN | ACK, ACK])
def test_only_a_bare_acknowledgement_is_a_probe_without_a_byte(flags: int) -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]
    for back in (0, 1, 2):
        packets.append(talk.at(talk.slave, talk.slave.sequence - back, b"", flags))
    items = run_packets(packets)
    closed = next(item for item in items if isinstance(item, StreamClosed))
    assert closed.keep_alives == (flags == ACK)


def test_an_event_of_a_response_names_the_slave_first() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell")]
    (event,) = wire_events(run_packets([*packets, talk.at(talk.slave, 5001, b"TELL")]))
    assert (event.source, event.destination) == (str(_SLAVE), str(_MASTER))
    assert (event.ts_ns, event.raw) == (6 * _MS, b"TELL")


def test_the_gap_of_a_cut_packet_has_the_time_of_that_packet() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), cut(talk.response(b"tellmore"), 54 + 4)]
    (gap,) = [item for item in run_packets(packets) if isinstance(item, StreamGap)]
    assert gap == StreamGap(
        5 * _MS, Connection(_MASTER, _SLAVE), Direction.RESPONSE, 4, EventKind.CUT
    )


def test_both_ends_may_close_with_the_last_of_their_bytes() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.send(talk.master, b"ask", FIN | ACK)]
    packets += [talk.send(talk.slave, b"tell", FIN | ACK)]
    for order in permutations(range(3, 5)):
        reassembler = TcpReassembler()
        items = run_packets(
            [*packets[:3], *(packets[at] for at in order)], reassembler, close=False
        )
        if order == (4, 3):  # Before the FIN has come, its acknowledgement is one of a byte.
            items += reassembler.advance(5 * _MS + PATIENCE_NS)
        assert words_of(items) == [">ask", "<tell"]
        assert close_reasons(items) == [CloseReason.FINISHED]


def test_a_connection_closes_when_the_hole_before_its_fin_is_given_up() -> None:
    talk = Talk()
    packets = talk.handshake()
    packets += [
        talk.at(talk.master, 1004, b"def", FIN | ACK),
        talk.send(talk.slave, b"", FIN | ACK),
    ]
    reassembler = TcpReassembler()
    assert close_reasons(run_packets(packets, reassembler, close=False)) == []
    assert reassembler.advance(4 * _MS + HOLE_NS - 1) == []
    items = reassembler.advance(4 * _MS + HOLE_NS)
    assert words_of(items) == [3, ">def"]
    assert close_reasons(items) == [CloseReason.FINISHED]


def test_a_hole_waits_as_long_as_the_oldest_of_the_held_bytes() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.at(talk.master, 1010, b"old")]
    talk.ts_ns += 1000 * _MS
    packets += [talk.at(talk.master, 1004, b"new")]
    reassembler = TcpReassembler()
    run_packets(packets, reassembler, close=False)
    assert words_of(reassembler.advance(4 * _MS + HOLE_NS - 1)) == []
    assert words_of(reassembler.advance(4 * _MS + HOLE_NS)) == [3, ">new", 3, ">old"]


def test_the_packet_that_brought_bytes_is_their_origin() -> None:
    talk = Talk()
    packets = [
        *talk.handshake(),
        talk.at(talk.master, 1004, b"def"),
        talk.at(talk.master, 1001, b"abc"),
    ]
    numbered = [replace(each, file="f", number=at) for at, each in enumerate(packets, 1)]
    places = [one.place for one in run_packets(numbered) if isinstance(one, Chunk)]
    assert [(one.position, one.origin[:2]) for one in places if one and one.origin] == [
        (0, ("f", 5)), (3, ("f", 4)),
    ]  # fmt: skip


def test_a_segment_in_order_takes_the_short_way_only() -> None:
    """The long way gives the same with four times as many calls."""
    talk = Talk()
    reassembler = TcpReassembler()
    run_packets([*talk.handshake(), talk.request(b"ask")], reassembler, close=False)
    with patch.object(TcpConnection, "_take", side_effect=AssertionError):
        items = run_packets([talk.response(b"tell")], reassembler, close=False)
        with pytest.raises(AssertionError):
            run_packets([talk.send(talk.slave, b"x", FIN | ACK)], reassembler, close=False)
    assert words_of(items) == ["<tell"]
