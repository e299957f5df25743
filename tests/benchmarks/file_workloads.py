"""Capture files and logs for tests.benchmarks.files, made from seeds."""

# The captures have 20 connections on which masters read holding registers in turn; "per poll" has
# one for each transaction. In the dirty one 2 % of the segments with bytes are retransmitted, and
# 1 % are exchanged with the next packet of the file. 5 % of the requests are in two segments. 5 %
# of the polls come two at once: two requests in one segment, then both responses in one. Each frame
# comes with the number of transactions that it completes.

from __future__ import annotations

import random
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.logs import LogWriter
from mbtool.modbus import encode_pdu, mbap_adu, rtu_adu
from mbtool.packets import read_capture
from mbtool.packets.segment import ACK, FIN, SYN

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

CONNECTIONS = 20
REGISTERS = 10
PSH = 0x08

_START_NS = 1_790_000_000_000_000_000
_STEP_NS = 50_000
_UNIT = 1
_ETHERNET = bytes.fromhex("020000000002 020000000001 0800")


@dataclass(frozen=True, slots=True)
class Made:
    """A file that was made."""

    path: Path
    packets: int
    """How many packets it has; bytes, of a serial line."""
    transactions: int
    options: tuple[str, ...] = ()
    """The options with which `mbtool decode` reads it."""


class _End:
    """One end of a connection."""

    def __init__(self, host: int, port: int, sequence: int) -> None:
        self.host = host
        self.port = port
        self.sequence = sequence


class Poll:
    """A connection between a master and a slave."""

    def __init__(self, number: int, port: int, rng: random.Random) -> None:
        self.master = _End(0x0A000001, port, rng.getrandbits(32))
        self.slave = _End(0x0A010000 + number, 502, rng.getrandbits(32))
        self._rng = rng
        self._id = 0

    def open(self) -> Iterator[bytes]:
        yield self._send(self.master, flags=SYN)
        yield self._send(self.slave, flags=SYN | ACK)
        yield self._send(self.master)

    def close(self) -> Iterator[bytes]:
        yield self._send(self.master, flags=FIN | ACK)
        yield self._send(self.slave, flags=FIN | ACK)
        yield self._send(self.master)

    def request(self) -> bytes:
        self._id = self._id + 1 & 0xFFFF
        address = 100 * (self._id % 5)
        pdu = encode_pdu(0x03, Direction.REQUEST, address=address, quantity=REGISTERS)
        return mbap_adu(self._id, _UNIT, pdu)

    def response(self, request: bytes) -> bytes:
        data = self._rng.randbytes(2 * REGISTERS)
        return request[:2] + struct.pack(">HHBBB", 0, 3 + len(data), _UNIT, 3, len(data)) + data

    def asks(self, data: bytes, flags: int = ACK | PSH) -> bytes:
        return self._send(self.master, data, flags)

    def answers(self, data: bytes) -> bytes:
        return self._send(self.slave, data, ACK | PSH)

    def _send(self, sender: _End, data: bytes = b"", flags: int = ACK) -> bytes:
        other = self.slave if sender is self.master else self.master
        acknowledged = other.sequence if flags & ACK else 0
        frame = _frame(sender, other, acknowledged, flags, data)
        sender.sequence = sender.sequence + len(data) + bool(flags & (SYN | FIN)) & 0xFFFFFFFF
        return frame


def _frame(sender: _End, other: _End, acknowledged: int, flags: int, data: bytes) -> bytes:
    ip = struct.pack(
        ">BBHHHBBHII", 0x45, 0, 40 + len(data), 1, 0, 64, 6, 0, sender.host, other.host
    )
    tcp = struct.pack(
        ">HHIIBBHHH",
        sender.port,
        other.port,
        sender.sequence,
        acknowledged,
        0x50,
        flags,
        8192,
        0,
        0,
    )
    return (_ETHERNET + ip + tcp + data).ljust(60, b"\0")


def clean(packets: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
    """Polling in order: two packets for each transaction."""
    polls = [Poll(number, 40_000 + number, rng) for number in range(CONNECTIONS)]
    for poll in polls:
        yield from ((frame, 0) for frame in poll.open())
    for number in range((packets - 3 * CONNECTIONS) // 2):
        poll = polls[number % CONNECTIONS]
        request = poll.request()
        yield poll.asks(request), 0
        yield poll.answers(poll.response(request)), 1


def dirty(packets: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
    """The same with disorder; everything that was sent is in the capture."""
    return _disordered(_cut_and_joined(packets, rng), rng)


def _cut_and_joined(packets: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
    polls = [Poll(number, 40_000 + number, rng) for number in range(CONNECTIONS)]
    for poll in polls:
        yield from ((frame, 0) for frame in poll.open())
    for number in range((packets - 3 * CONNECTIONS) // 2):
        poll, chance = polls[number % CONNECTIONS], rng.random()
        request = poll.request()
        if chance < 0.05:
            place = rng.randrange(1, len(request))
            yield poll.asks(request[:place]), 0
            yield poll.asks(request[place:]), 0
            yield poll.answers(poll.response(request)), 1
        elif chance < 0.10:
            second = poll.request()
            yield poll.asks(request + second), 0
            yield poll.answers(poll.response(request) + poll.response(second)), 2
        else:
            yield poll.asks(request), 0
            yield poll.answers(poll.response(request)), 1


def _disordered(
    frames: Iterator[tuple[bytes, int]], rng: random.Random
) -> Iterator[tuple[bytes, int]]:
    held: tuple[bytes, int] | None = None
    for frame, completes in frames:
        chance = rng.random()
        if held is None and chance < 0.01:
            held = frame, completes
            continue
        yield frame, completes
        if held is not None:
            yield held
            held = None
        if chance > 0.98:
            yield frame, 0
    if held is not None:
        yield held


def per_poll(packets: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
    """A connection of its own for each transaction."""
    for number in range(packets // 8):
        poll = Poll(number % CONNECTIONS, 1024 + number % 60_000, rng)
        yield from ((frame, 0) for frame in poll.open())
        request = poll.request()
        yield poll.asks(request), 0
        yield poll.answers(poll.response(request)), 1
        yield from ((frame, 0) for frame in poll.close())


def random_requests(packets: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
    """Reads and writes of random addresses and quantities, in order, on 20 connections."""
    polls = [Poll(number, 40_000 + number, rng) for number in range(CONNECTIONS)]
    for poll in polls:
        yield from ((frame, 0) for frame in poll.open())
    for number in range((packets - 3 * CONNECTIONS) // 2):
        poll = polls[number % CONNECTIONS]
        unit, address, quantity = rng.randrange(1, 5), rng.randrange(2000), rng.randrange(1, 20)
        function = rng.choice((0x03, 0x03, 0x04, 0x06, 0x10))
        values = tuple(rng.randrange(0x10000) for _ in range(quantity))
        if function in (0x03, 0x04):
            request = encode_pdu(function, Direction.REQUEST, address=address, quantity=quantity)
            response = encode_pdu(function, Direction.RESPONSE, values=values)
        elif function == 0x06:
            request = encode_pdu(function, Direction.REQUEST, address=address, value=values[0])
            response = request
        else:
            request = encode_pdu(
                function, Direction.REQUEST, address=address, quantity=quantity, values=values
            )
            response = encode_pdu(function, Direction.RESPONSE, address=address, quantity=quantity)
        yield poll.asks(mbap_adu(number & 0xFFFF, unit, request)), 0
        yield poll.answers(mbap_adu(number & 0xFFFF, unit, response)), 1


def scan(packets: int, rng: random.Random) -> Iterator[tuple[bytes, int]]:
    """One master asks all units for all addresses; a tenth of them is answered with a value."""
    poll = Poll(0, 40_000, rng)
    yield from ((frame, 0) for frame in poll.open())
    for number in range((packets - 3) // 2):
        unit, address = 1 + number % 247, number * 7 % 0x10000
        request = encode_pdu(0x03, Direction.REQUEST, address=address, quantity=1)
        is_there = rng.random() < 0.1
        value = (rng.randrange(0x10000),)
        answer = encode_pdu(0x03, Direction.RESPONSE, values=value) if is_there else b"\x83\x02"
        yield poll.asks(mbap_adu(number & 0xFFFF, unit, request)), 0
        yield poll.answers(mbap_adu(number & 0xFFFF, unit, answer)), 1


def make_capture(
    path: Path, frames: Callable[[int, random.Random], Iterator[tuple[bytes, int]]], packets: int
) -> Made:
    """Write a pcap file of about so many packets."""
    count = transactions = 0
    ts_ns = _START_NS
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        for frame, completes in frames(packets, random.Random(path.stem)):
            ts_ns += _STEP_NS
            seconds, ns = divmod(ts_ns, 1_000_000_000)
            head = struct.pack("<IIII", seconds, ns // 1000, len(frame), len(frame))
            file.write(head + frame)
            count += 1
            transactions += completes
    return Made(path, count, transactions)


def make_serial(path: Path, packets: int) -> Made:
    """Write the bytes of a serial line with half as many transactions as packets."""
    rng = random.Random(path.stem)
    frames = []
    for number in range(packets // 2):
        request = encode_pdu(0x03, Direction.REQUEST, address=number % 100, quantity=REGISTERS)
        values = tuple(rng.randrange(0x10000) for _ in range(REGISTERS))
        response = encode_pdu(0x03, Direction.RESPONSE, values=values)
        frames += [rtu_adu(1 + number % 5, request), rtu_adu(1 + number % 5, response)]
    data = b"".join(frames)
    path.write_bytes(data)
    return Made(path, len(data), packets // 2, ("--link", "rtu@19200-8E1"))


def make_log(path: Path, capture: Made) -> Made:
    """Write a log of the packets of a capture and its transactions, as sniff does."""
    decoder = Decoder(Namer(), ports=(502,))
    with capture.path.open("rb") as stream, LogWriter(path, capture={}) as log:
        for packet in read_capture(stream):
            log.write(packet)
            for record in decoder.feed(packet):
                log.write(record)
        for record in decoder.close():
            log.write(record)
    return Made(path, capture.packets, capture.transactions)
