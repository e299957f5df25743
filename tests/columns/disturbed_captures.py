"""Captures of many short and long connections with disorder, made from a seed."""

# Masters poll on connections of their own, some for each poll, with few ports, so that the same
# ends connect again. Requests come in pieces, two at once, or are not answered; connections end
# with FINs, with RST or not at all. Then packets are lost, sent again, late, or exchanged.

from __future__ import annotations

import random
import struct
from itertools import count
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus import encode_pdu, exception_pdu, mbap_adu
from mbtool.packets.segment import ACK, RST
from tests.benchmarks.file_workloads import Poll

if TYPE_CHECKING:
    from collections.abc import Iterator

_START_NS = 1_790_000_000_000_000_000
_PORTS = 12


def disturbed(number: int, connections: int = 40) -> bytes:
    """A pcap file; `connections` is about the number of connections in it."""
    rng = random.Random(f"disturbed {number}")
    talks = [_talk(one, rng) for one in range(connections)]
    frames = _mixed(talks, rng, at_once=rng.choice((1, 3, 10)))
    return _pcap(_disordered(frames, rng, rng.choice((0.0, 0.0, 0.01, 0.05))), rng)


def _talk(number: int, rng: random.Random) -> Iterator[bytes]:
    """The frames of one connection."""
    poll = Poll(rng.randrange(3), 1024 + rng.randrange(_PORTS), rng)
    transactions = rng.choice((0, 1, 1, 1, 2, 3, 20))
    opened, closed = [*poll.open()], []
    yield from opened[: rng.choice((3, 3, 3, 3, 2))]
    for _ in range(transactions):
        yield from _transaction(poll, rng)
    match rng.choice(("fin", "fin", "fin", "fin", "rst", "none", "half")):
        case "fin":
            closed = [*poll.close()]
        case "half":
            closed = [*poll.close()][: rng.randrange(3)]
        case "rst":
            closed = [poll.asks(b"", RST | ACK)]
    yield from closed
    if rng.random() < 0.1:
        yield rng.choice(opened + closed)


def _transaction(poll: Poll, rng: random.Random) -> Iterator[bytes]:
    chance = rng.random()
    request = poll.request() if rng.random() < 0.7 else _other_request(poll, rng)
    response = poll.response(request) if request[7] == 3 else _other_response(request, rng)
    if chance < 0.06:
        cut = rng.randrange(1, len(request))
        yield poll.asks(request[:cut])
        if rng.random() < 0.2:
            yield poll.answers(b"")
        yield poll.asks(request[cut:])
    elif chance < 0.12:
        second = poll.request()
        yield poll.asks(request + second)
        response += poll.response(second)
    else:
        yield poll.asks(request)
    if rng.random() < 0.1:
        yield poll.answers(b"")
    if chance < 0.97:
        if rng.random() < 0.03:
            cut = rng.randrange(1, len(response))
            yield poll.answers(response[:cut])
            response = response[cut:]
        yield poll.answers(response)
    if rng.random() < 0.2:
        yield poll.asks(b"")


def _other_request(poll: Poll, rng: random.Random) -> bytes:
    pdu = rng.choice(
        (
            encode_pdu(0x06, Direction.REQUEST, address=1, value=rng.randrange(9)),
            encode_pdu(0x10, Direction.REQUEST, address=7, values=(1, 2)),
            encode_pdu(0x01, Direction.REQUEST, address=7, quantity=3),
            bytes.fromhex("2b 0e 01 00"),
            bytes.fromhex("03 0001"),
            bytes.fromhex("64 01"),
        )
    )
    head = poll.request()
    return mbap_adu(head[0] << 8 | head[1], head[6], pdu)


def _other_response(request: bytes, rng: random.Random) -> bytes:
    code = request[7]
    pdu = {
        0x06: request[7:],
        0x10: request[7:12],
        0x01: bytes((1, 1, rng.randrange(8))),
    }.get(code, exception_pdu(code, 1))
    return mbap_adu(request[0] << 8 | request[1], request[6], pdu)


def _mixed(talks: list[Iterator[bytes]], rng: random.Random, at_once: int) -> Iterator[bytes]:
    """The frames of all connections, of which `at_once` are open at the same time."""
    waiting = talks[::-1]
    running: list[Iterator[bytes]] = []
    while waiting or running:
        while waiting and len(running) < at_once:
            running.append(waiting.pop())
        one = rng.choice(running)
        frame = next(one, None)
        if frame is None:
            running.remove(one)
        else:
            yield frame


def _disordered(frames: Iterator[bytes], rng: random.Random, rate: float) -> Iterator[bytes]:
    late: list[tuple[int, bytes]] = []
    for at, frame in enumerate(frames):
        chance = rng.random() / rate if rate else 9.0
        if chance < 1:
            if chance < 0.5:
                yield frame
            if chance < 0.8:
                late.append((at + rng.choice((1, 1, 2, 5, 40)), frame))
        else:
            yield frame
        due = [one for one in late if one[0] <= at]
        late = [one for one in late if one[0] > at]
        yield from (one for _, one in due)
    yield from (one for _, one in late)


def _pcap(frames: Iterator[bytes], rng: random.Random) -> bytes:
    records = [struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1)]
    ts_ns, steps = _START_NS, count()
    for frame in frames:
        ts_ns += rng.choice((0, 50_000, 1_000_000, 20_000_000))
        if next(steps) % 500 == 499:
            ts_ns += rng.choice((1_000_000_000, 15_000_000_000, 70_000_000_000))
        seconds, ns = divmod(ts_ns, 1_000_000_000)
        records.append(struct.pack("<IIII", seconds, ns, len(frame), len(frame)) + frame)
    return b"".join(records)
