"""A serial server or port redirector: one direction of a connection carries a whole line."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, Connection, Direction, Endpoint, WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Outcome, rtu_adu
from mbtool.packets import CloseReason, StreamClosed, StreamGap, StreamOpened
from tests.feeding import START_NS

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record

MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
WAYS = pytest.mark.parametrize("way", [RESPONSE, REQUEST], ids=["server sends", "client sends"])
PORTS = pytest.mark.parametrize("rtu_ports", [(8899,), ()], ids=["--rtu-port", "--port any"])
CONNECTION = Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 8899), 1)
READ = rtu_adu(1, bytes.fromhex("03 0064 0006"))
ANSWER = rtu_adu(1, bytes.fromhex("03 0C 0001 0002 0003 0004 0005 0006"))
WRITE = rtu_adu(2, bytes.fromhex("06 0001 0005"))
ABSENT = rtu_adu(3, bytes.fromhex("04 0000 0002"))
FRAMES = (READ, ANSWER, WRITE, WRITE, ABSENT) * 6
OUTCOMES = [Outcome.OK, Outcome.OK, Outcome.NO_ANSWER] * 6


def decoder(rtu_ports: tuple[int, ...]) -> Decoder:
    return Decoder(Namer(), any_port=not rtu_ports, rtu_ports=rtu_ports)


def said(data: bytes, at_ms: int, way: Direction) -> Chunk:
    return Chunk(
        ts_ns=START_NS + at_ms * MS,
        link=CONNECTION.link,
        data=data,
        direction=way,
        connection=CONNECTION,
    )


def records(one: Decoder, *items: Chunk | StreamGap, joined: bool = False) -> list[Record]:
    found = one.feed(StreamOpened(START_NS, CONNECTION, joined=joined))
    for item in items:
        found += one.feed(item)
    end_ns = items[-1].ts_ns + MS
    return found + one.feed(StreamClosed(end_ns, CONNECTION, CloseReason.FINISHED))


def outcomes(found: list[Record]) -> list[Outcome]:
    """The outcomes in the order of the requests."""
    done = [one for one in found if isinstance(one, NamedTransaction)]
    return [one.outcome for one in sorted(done, key=lambda one: one.start_ns)]


def raws(found: list[Record]) -> list[bytes]:
    return [one.raw for one in found if isinstance(one, WireEvent) and one.raw]


def timed(frames: tuple[bytes, ...], way: Direction) -> list[Chunk]:
    """A segment for each frame: a response 20 ms after its request, the next request 300 ms on."""
    at_ms, chunks = 0, []
    for before, frame in pairwise((b"", *frames)):
        is_answer = frame == ANSWER or frame == before == WRITE
        at_ms += 20 if is_answer else 300
        chunks.append(said(frame, at_ms, way))
    return chunks


@WAYS
@PORTS
def test_a_direction_that_carries_a_whole_line_is_read_as_one(
    rtu_ports: tuple[int, ...], way: Direction
) -> None:
    found = records(decoder(rtu_ports), *timed(FRAMES, way))
    assert outcomes(found) == OUTCOMES
    assert raws(found) == []
    done = [one for one in found if isinstance(one, NamedTransaction)]
    assert {one.transport for one in done} == {"rtu"}
    assert {one.link for one in done} == {CONNECTION.link}
    assert {one.latency_ns is not None for one in done if one.outcome is Outcome.OK} == {True}


@PORTS
@pytest.mark.parametrize("size", [3, 7, 16, 100])
def test_segments_may_end_anywhere(rtu_ports: tuple[int, ...], size: int) -> None:
    data = b"".join(FRAMES)
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    chunks = [said(one, 10 * at, RESPONSE) for at, one in enumerate(pieces)]
    found = records(decoder(rtu_ports), *chunks)
    assert outcomes(found) == OUTCOMES
    assert raws(found) == []


@pytest.mark.parametrize("first", [1, 2, 3, 4])
def test_a_capture_may_begin_anywhere(first: int) -> None:
    found = records(decoder((8899,)), *timed(FRAMES[first:], RESPONSE), joined=True)
    assert outcomes(found)[-15:] == OUTCOMES[-15:]


@PORTS
def test_what_a_client_sends_is_on_the_line_once(rtu_ports: tuple[int, ...]) -> None:
    chunks = []
    for at in range(0, 8000, 1000):
        chunks += [said(READ, at, REQUEST), said(READ, at + 10, RESPONSE)]
        chunks.append(said(ANSWER, at + 30, RESPONSE))
    found = records(decoder(rtu_ports), *chunks)
    assert outcomes(found) == [Outcome.OK] * 8


def test_what_a_client_sends_and_the_server_does_not_repeat_is_on_the_line_too() -> None:
    chunks = timed(FRAMES[:5], RESPONSE)
    chunks += [said(READ, 3000, REQUEST), said(ANSWER, 3030, RESPONSE)]
    found = records(decoder((8899,)), *chunks)
    assert outcomes(found) == [*OUTCOMES[:3], Outcome.OK]


def test_after_lost_bytes_the_line_goes_on() -> None:
    before, after = timed(FRAMES[:5], RESPONSE), timed(FRAMES[:5], RESPONSE)
    gap = StreamGap(before[-1].ts_ns + MS, CONNECTION, RESPONSE, 40)
    found = records(decoder((8899,)), *before, gap, *after)
    assert sorted(outcomes(found)) == sorted([*OUTCOMES[:5], Outcome.NOT_CAPTURED])


def test_a_connection_with_a_direction_each_is_none() -> None:
    chunks = []
    for at in range(0, 3000, 1000):
        chunks += [said(READ, at, REQUEST), said(ANSWER, at + 30, RESPONSE)]
    found = records(decoder((8899,)), *chunks)
    done = [one for one in found if isinstance(one, NamedTransaction)]
    assert {(one.transport, one.outcome) for one in done} == {("rtu-tcp", Outcome.OK)}
