"""The reassembler and connections whose packets, or some of them, were read elsewhere."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

from mbtool.core import Chunk, Connection, Endpoint
from mbtool.packets.connection import HOLE_NS, PATIENCE_NS, TcpConnection
from mbtool.packets.ended_connection import EndedConnection
from mbtool.packets.plain_bytes import PlainBytes, RestPlace
from mbtool.packets.reassembler import IDLE_NS, FlowEnds, TcpReassembler
from mbtool.packets.segment import ACK, FIN, RST
from mbtool.packets.stream_events import CloseReason, StreamGap, StreamItem, StreamOpened
from tests.packets.building import MASTER, SLAVE, End, Talk
from tests.packets.reading import run_packets, words_of

if TYPE_CHECKING:
    from mbtool.core import Packet

_MS = 1_000_000


def _across() -> TcpReassembler:
    return TcpReassembler(across=True)


def _ends(port: int) -> FlowEnds:
    """The ends of a connection from a port of the master to port 502, the lower port first."""
    return bytes((10, 0, 0, 2)), 502, bytes((10, 0, 0, 1)), port


def _talk(port: int, ts_ns: int = 0) -> Talk:
    return Talk(End(MASTER, port, 1000), End(SLAVE, 502, 5000), ts_ns)


def _ended(port: int, last_ns: int = 0) -> tuple[FlowEnds, EndedConnection]:
    identity = Connection(Endpoint(MASTER, port), Endpoint(SLAVE, 502))
    return _ends(port), EndedConnection(identity, last_ns, (1001, 5001), (3, 4), False)


def _open(reassembler: TcpReassembler, *ports: int) -> None:
    for port in ports:
        run_packets(_talk(port).handshake(), reassembler, close=False)


def test_a_connection_is_found_by_its_ends_unless_it_was_read_elsewhere() -> None:
    reassembler = _across()
    _open(reassembler, 10000)
    reassembler.take_ended([_ended(10001)])
    found = reassembler.find(_ends(10000))
    assert isinstance(found, TcpConnection)
    assert found.identity.master.port == 10000
    assert reassembler.find(_ends(10001)) is None
    assert reassembler.find(_ends(10002)) is None


def test_numbers_that_are_taken_are_not_given_again() -> None:
    reassembler = _across()
    assert reassembler.reserve_numbers(3) == 0
    items = run_packets(_talk(10000).handshake(), reassembler, close=False)
    assert [one.connection.number for one in items if isinstance(one, StreamOpened)] == [3]
    assert reassembler.reserve_numbers(2) == 4
    assert reassembler.reserve_numbers(1) == 6


def test_copies_of_a_connection_that_was_read_elsewhere_open_nothing() -> None:
    talk = _talk(10000)
    packets = [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell"), *talk.goodbye()]
    reassembler = _across()
    reassembler.take_ended([_ended(10000)])
    assert run_packets(packets[1:], reassembler, close=False) == []
    assert words_of(run_packets([talk.request(b"new")], reassembler)) == [">new"]


def test_of_too_many_connections_the_least_recently_used_are_forgotten() -> None:
    with patch("mbtool.packets.reassembler.MAX_CONNECTIONS", 2):
        reassembler = _across()
        reassembler.take_ended(_ended(port) for port in (10000, 10001, 10002, 10003))
        reassembler.note_used([_ends(10001), _ends(10000), _ends(7)])
        reassembler.forget_excess()
    copies = {}
    for port in (10000, 10001, 10002, 10003):
        talk = _talk(port)
        copy = talk.at(talk.master, 1001, b"ask")
        copies[port] = run_packets([copy], reassembler, close=False)
    # Of a connection that is still known, a copy of its bytes opens nothing.
    assert [port for port, items in copies.items() if not items] == [10000, 10001]


@pytest.mark.parametrize("most", [2, 3, 4, 5, 6])
def test_it_matters_if_an_open_or_used_connection_may_be_dropped(most: int) -> None:
    reassembler = _across()
    reassembler.take_ended([_ended(10000), _ended(10001)])
    _open(reassembler, 10002)
    with patch("mbtool.packets.reassembler.MAX_CONNECTIONS", most):
        # Three are known; two of these have ended, and are the least recently used ones.
        assert reassembler.may_drop(0, {}, 0) == (most < 1)
        assert reassembler.may_drop(0, {}, 1) == (most < 2)
        assert reassembler.may_drop(0, {}, 2) == (most < 3)
        assert reassembler.may_drop(0, {}, 3) == (most < 4)
        assert reassembler.may_drop(0, {}, 99)
        # The second one is in use; one that is not known adds to the number.
        assert reassembler.may_drop(0, {_ends(10001): 0}, 0) == (most < 2)
        assert reassembler.may_drop(0, {_ends(10001): 0}, 1) == (most < 3)
        assert reassembler.may_drop(0, {_ends(10000): 0}, 1) == (most < 4)
        assert reassembler.may_drop(0, {_ends(10009): 0, _ends(10008): 0}, 0) == (most < 3)
        assert reassembler.may_drop(0, {_ends(10009): 0}, 2) == (most < 4)


def test_it_matters_if_an_open_or_used_connection_is_idle() -> None:
    reassembler = _across()
    reassembler.take_ended([_ended(10000, last_ns=5)])
    assert not reassembler.may_drop(5 + 9 * IDLE_NS, {})
    assert not reassembler.may_drop(4 + IDLE_NS, {_ends(10000): 4 + IDLE_NS})
    assert reassembler.may_drop(5 + IDLE_NS, {_ends(10000): 5 + IDLE_NS})
    _open(reassembler, 10001)  # Its last packet has the time 3 ms.
    assert not reassembler.may_drop(3 * _MS + IDLE_NS - 1, {})
    assert reassembler.may_drop(3 * _MS + IDLE_NS, {})


def _holding(reassembler: TcpReassembler) -> None:
    """Make a connection hold bytes from time 4 ms on that were acknowledged at 5 ms."""
    talk = _talk(10000)
    packets = talk.handshake()
    packets += [talk.at(talk.master, 1004, b"def")]
    talk.master.sequence = 1007
    packets += [talk.send(talk.slave)]
    run_packets(packets, reassembler, close=False)


def test_times_of_other_packets_let_the_patience_of_a_connection_end() -> None:
    due = 5 * _MS + PATIENCE_NS
    for times, at in (
        ([due], [0]),
        ([due - 1], []),
        ([6 * _MS, due - 1, due, due + 1], [2]),
        ([6 * _MS, due - 1], []),
        ([due + 9 * PATIENCE_NS] * 2, [0]),
    ):
        reassembler = _across()
        reassembler.advance(5 * _MS)
        _holding(reassembler)
        found = reassembler.pass_times(times, 0, len(times))
        assert [index for index, _ in found] == at
        assert [words_of(items) for _, items in found] == [[3, ">def"]] * len(at)


def test_only_the_given_times_pass() -> None:
    due = 5 * _MS + PATIENCE_NS
    reassembler = _across()
    reassembler.advance(5 * _MS)
    _holding(reassembler)
    times = [due, due, 6 * _MS, due]
    assert reassembler.pass_times(times, 2, 3) == []
    assert reassembler.pass_times(times, 1, 1) == []
    ((index, _),) = reassembler.pass_times(times, 1, 2)
    assert index == 1


def test_time_is_looked_at_once_in_each_span_of_patience() -> None:
    """A hole is given up with the first packet that comes PATIENCE_NS or more after a look."""
    reassembler = _across()
    reassembler.advance(0)
    talk = _talk(10000)
    run_packets([*talk.handshake(), talk.at(talk.master, 1004, b"x")], reassembler, close=False)
    other = _talk(10001).handshake()[0]
    looked = HOLE_NS + 4 * _MS - 1
    for ts_ns, said in (
        (looked, []),
        (looked + PATIENCE_NS - 1, []),
        (looked + PATIENCE_NS, [3, ">x"]),
    ):
        packet = replace(other, ts_ns=ts_ns)
        assert words_of(run_packets([packet], reassembler, close=False)) == said


def test_a_reassembler_looks_at_the_time_first_when_patience_has_passed_since_0() -> None:
    for ts_ns, said in ((PATIENCE_NS - 1, []), (PATIENCE_NS, [">ask"])):
        talk = _talk(10000)
        joined = replace(talk.request(b"ask"), ts_ns=0)
        other = replace(_talk(10001).handshake()[0], ts_ns=ts_ns)
        assert words_of(run_packets([joined, other], _across(), close=False)) == said


def _conversation() -> tuple[Talk, list[Packet], list[Packet]]:
    """A conversation, its first packets, and a stretch of it that ends with a response."""
    talk = _talk(10000)
    opening = [*talk.handshake(), talk.request(b"ask1"), talk.response(b"tell")]
    stretch = [
        talk.request(b"first"), talk.response(b"FIRST answer"),
        talk.request(b"second!"), talk.response(b"SECOND"),
    ]  # fmt: skip
    return talk, opening, stretch


@pytest.mark.parametrize("mid", [False, True], ids=["from the SYN on", "joined"])
@pytest.mark.parametrize("probed", [False, True])
def test_a_connection_goes_on_behind_a_stretch_as_if_it_had_been_fed(
    mid: bool, probed: bool
) -> None:
    def ending(number: int, talk: Talk) -> list[Packet]:
        master, slave = talk.master, talk.slave
        wrong = talk.at(master, master.sequence - 7, b"SECOND?")
        match number:
            case 0:
                return [talk.request(b"third"), talk.response(b"THIRD")]
            case 1:
                return [wrong, talk.at(slave, slave.sequence - 9, b"?wer"), talk.request(b"x")]
            case 2:
                return [
                    talk.at(master, master.sequence - 1, b"?"),
                    talk.at(slave, slave.sequence - 1),
                ]
            case 3:
                late = talk.at(master, master.sequence + 5, b"late")
                return [late, *(talk.response(b"%d" % one) for one in range(5)), talk.request(b"a")]
            case 4:
                return [talk.send(slave, flags=RST | ACK)]
            case _:
                return [talk.send(master, flags=FIN | ACK), talk.send(slave, flags=FIN | ACK)]

    for number in range(6):
        both: list[list[StreamItem]] = []
        for is_fed in (True, False):
            talk, opening, stretch = _conversation()
            if mid:
                opening = [*opening[3:], talk.at(talk.master, talk.master.sequence - 12)]
            if probed:
                opening.append(replace(stretch[0], ts_ns=stretch[0].ts_ns - 1))
                probe = talk.at(talk.master, 1004)
                opening = [*opening[:-1], replace(probe, ts_ns=6 * _MS)]
            reassembler = _across()
            items = run_packets(opening, reassembler, close=False)
            if mid:
                items += reassembler.advance(opening[-1].ts_ns + PATIENCE_NS)
            if is_fed:
                items += run_packets(stretch, reassembler, close=False)
            else:
                connection = reassembler.find(_ends(10000))
                assert connection is not None
                connection.pass_plain(
                    PlainBytes(12, b"firstsecond!", 3, stretch[2].ts_ns),
                    PlainBytes(18, b"FIRST answerSECOND", 4, stretch[3].ts_ns),
                )
            items += run_packets(ending(number, talk), reassembler)
            both.append(items)
        fed, passed = both
        assert [one for one in fed if one in passed] == passed
        dropped = [one for one in fed if one not in passed]
        assert all(isinstance(one, Chunk) for one in dropped)
        assert words_of(dropped) == [">first", "<FIRST answer", ">second!", "<SECOND"]
        places = [
            [(one.place, one.ts_ns) for one in items if isinstance(one, Chunk)]
            for items in (fed, passed)
        ]
        assert [one for one in places[0] if one in places[1]] == places[1]


def test_a_connection_rests_if_it_holds_nothing_and_waits_for_nothing() -> None:
    talk, opening, stretch = _conversation()
    reassembler = _across()
    rests = []
    for packet in (*opening, *stretch):
        run_packets([packet], reassembler, close=False)
        connection = reassembler.find(_ends(10000))
        assert connection is not None
        rests.append(connection.rest_place)
    assert rests == [
        None, RestPlace(1001, 5001, 0, 0), RestPlace(1001, 5001, 0, 0),
        RestPlace(1005, 5001, 4, 0), RestPlace(1005, 5005, 4, 4),
        RestPlace(1010, 5005, 9, 4), RestPlace(1010, 5017, 9, 16),
        RestPlace(1017, 5017, 16, 16), RestPlace(1017, 5023, 16, 22),
    ]  # fmt: skip
    assert connection is not None
    rests, holds = [], []
    for end in (talk.master, talk.slave):
        copy = [talk.at(end, end.sequence + 3, b"behind a hole")]
        run_packets(copy, reassembler, close=False)
        rests.append(connection.rest_place)
        holds.append(connection.holds_bytes)
        run_packets([talk.at(end, end.sequence, b"abc")], reassembler, close=False)
        end.sequence += 16
        rests.append(connection.rest_place)
        holds.append(connection.holds_bytes)
    run_packets([talk.send(talk.master, flags=FIN | ACK)], reassembler, close=False)
    rests.append(connection.rest_place)
    connection.close(0, CloseReason.RESET)
    rests.append(connection.rest_place)
    assert [one is None for one in rests] == [True, False, True, False, True, True]
    assert holds == [True, False, True, False]


def test_the_time_of_a_connection_only_goes_on() -> None:
    for noted, told in ((99 * _MS, 99 * _MS), (1, 4 * _MS)):
        reassembler = _across()
        talk = _talk(10000)
        packets = talk.handshake()
        talk.slave.sequence += 20  # The master acknowledges bytes that never come.
        run_packets([*packets, talk.send(talk.master)], reassembler, close=False)
        connection = reassembler.find(_ends(10000))
        assert connection is not None
        connection.note_time(noted)
        (gap,) = [one for one in reassembler.close(200 * _MS) if isinstance(one, StreamGap)]
        assert (gap.missing, gap.ts_ns) == (20, told)
