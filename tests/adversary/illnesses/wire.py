"""A two-wire line with masters and slaves as stations; each hears what the others send."""

# Time is simulated, in ns from 0. A station that sends while another one sends damages both frames:
# nobody understands them, and the recording has the bits of both. A master sends its next request
# when the response has come or its time-out is over, as simple masters do.

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from random import Random

MS = 1_000_000
SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Settings:
    """The rate (baud) of a line and the parity: E, O or N."""

    baud: int = 19200
    parity: str = "E"

    @property
    def bits(self) -> int:
        return 10 if self.parity == "N" else 11

    @property
    def character_ns(self) -> int:
        return self.bits * SECOND // self.baud


@dataclass(slots=True)
class Sent:
    """A frame on the wire; `by` is the unit of a slave, or a negative number for a master."""

    at_ns: int
    data: bytes
    by: int
    is_damaged: bool = False


def crc(data: bytes) -> bytes:
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


def framed(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + crc(body)


class Line:
    """The wire, its stations and its clock."""

    def __init__(self, random: Random, settings: Settings) -> None:
        self.random = random
        self.settings = settings
        self.now_ns = 0
        self.sent: list[Sent] = []
        self.stations: list[Master | Slave] = []
        self.disturb: Callable[[Sent], None] | None = None
        """Changes a frame as noise on the wire does, for all who hear it."""
        self._queue: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0

    def at(self, at_ns: int, call: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._queue, (at_ns, self._count, call))

    def run(self, seconds: float) -> None:
        while self._queue and self._queue[0][0] < seconds * SECOND:
            self.now_ns, _, call = heapq.heappop(self._queue)
            call()

    def end_ns(self, one: Sent) -> int:
        return one.at_ns + len(one.data) * self.settings.character_ns

    def send(self, by: int, data: bytes) -> None:
        one = Sent(self.now_ns, data, by)
        if self.disturb is not None:
            self.disturb(one)
        for other in reversed(self.sent[-6:]):
            if self.end_ns(other) > one.at_ns:
                one.is_damaged = other.is_damaged = True
        self.sent.append(one)
        self.at(self.end_ns(one), lambda: self._deliver(one))

    def _deliver(self, one: Sent) -> None:
        if one.is_damaged:
            return
        for station in self.stations:
            station.hear(one)


@dataclass(slots=True, kw_only=True)
class Master:
    """Asks each poll in turn, once a period; `name` is a negative number."""

    line: Line
    polls: Sequence[tuple[int, bytes]]
    name: int = -1
    period_ms: float = 1000
    timeout_ms: float = 500
    pause_ms: float = 10
    begin_ms: float = 0
    asked: int = 0
    failed: int = 0
    _place: int = 0
    _cycle_ns: int = 0
    _waits: int = 0
    """The number of the request whose response is awaited; 0 if none."""

    def start(self) -> None:
        self.line.stations.append(self)
        self.line.at(round(self.begin_ms * MS), self._next)

    def hear(self, one: Sent) -> None:
        unit, pdu = self.polls[self._place - 1]
        fits = one.data[0] == unit and one.data[1] & 0x7F == pdu[0]
        if self._waits and one.by > 0 and fits:
            self._waits = 0
            self._go_on()

    def _next(self) -> None:
        if self._place == len(self.polls) or not self.asked:
            self._place, self._cycle_ns = 0, self.line.now_ns
        unit, pdu = self.polls[self._place]
        self._place += 1
        self.asked += 1
        self._waits = number = self.asked
        frame = framed(unit, pdu)
        self.line.send(self.name, frame)
        sent_ns = len(frame) * self.line.settings.character_ns
        wait_ns = sent_ns + round(self.timeout_ms * MS)
        self.line.at(self.line.now_ns + wait_ns, lambda: self._give_up(number))

    def _give_up(self, number: int) -> None:
        if self._waits == number:
            self._waits = 0
            self.failed += 1
            self._go_on()

    def _go_on(self) -> None:
        at_ns = self.line.now_ns + round(self.pause_ms * MS * self.line.random.uniform(0.9, 1.2))
        if self._place == len(self.polls):
            at_ns = max(at_ns, self._cycle_ns + round(self.period_ms * MS))
        self.line.at(at_ns, self._next)


@dataclass(slots=True, kw_only=True)
class Slave:
    """Answers the requests to its unit after its latency, in order."""

    line: Line
    unit: int
    latency_ms: Callable[[], float]
    refuses: frozenset[int] = frozenset()
    """Addresses of reads that it refuses with code 2."""
    before: Callable[[], bytes] = bytes
    """Bytes that its driver puts on the wire before a frame; `behind` those behind it."""
    behind: Callable[[], bytes] = bytes
    _free_ns: int = 0
    _image: dict[int, int] = field(default_factory=dict)

    def start(self) -> None:
        self.line.stations.append(self)

    def hear(self, one: Sent) -> None:
        if one.by > 0 or one.data[0] != self.unit:
            return
        begin = max(self.line.now_ns, self._free_ns)
        at_ns = begin + round(self.latency_ms() * MS)
        pdu = self._answer(one.data[1:-2])
        frame = self.before() + framed(self.unit, pdu) + self.behind()
        self._free_ns = at_ns + len(frame) * self.line.settings.character_ns
        self.line.at(at_ns, lambda: self.line.send(self.unit, frame))

    def _answer(self, request: bytes) -> bytes:
        function, address = request[0], int.from_bytes(request[1:3], "big")
        if address in self.refuses:
            return bytes([function | 0x80, 2])
        if function in (5, 6, 16):
            return request[:5]
        quantity = int.from_bytes(request[3:5], "big")
        random = self.line.random
        if function in (1, 2):
            size = (quantity + 7) // 8
            bits = random.getrandbits(quantity).to_bytes(size, "little")
            return bytes([function, size]) + bits
        data = b"".join(self._value(address + one) for one in range(quantity))
        return bytes([function, len(data)]) + data

    def _value(self, address: int) -> bytes:
        """A process value that drifts."""
        random = self.line.random
        old = self._image.setdefault(address, random.choice((0, 1, 230, 4711, 21000)))
        self._image[address] = (old + random.choice((0, 0, 0, 1, -1, 3))) & 0xFFFF
        return self._image[address].to_bytes(2, "big")


Heard = list[tuple[int, int]]
"""The time at which each byte begins (ns), and the byte."""


def heard(frames: Sequence[Sent], settings: Settings) -> Heard:
    """What a receiver makes of the frames; where several overlap, a 0 of any driver wins."""
    told: Heard = []
    together: list[Sent] = []
    end_ns = 0
    for one in [*sorted(frames, key=lambda one: one.at_ns), None]:
        if together and (one is None or one.at_ns >= end_ns):
            told += _together(together, settings)
            together.clear()
        if one is not None:
            together.append(one)
            end_ns = max(end_ns, one.at_ns + len(one.data) * settings.character_ns)
    return told


def _together(frames: list[Sent], settings: Settings) -> Heard:
    character_ns = settings.character_ns
    alone = [
        [(one.at_ns + place * character_ns, byte) for place, byte in enumerate(one.data)]
        for one in frames
    ]
    if len(alone) == 1:
        return alone[0]
    return sampled([Levels.of(one, settings) for one in alone], settings)


def received(told: Heard, sender: Settings, listener: Settings) -> Heard:
    """What a receiver with other settings makes of bytes."""
    return sampled([Levels.of(told, sender)], listener)


@dataclass(slots=True)
class Levels:
    """What a driver does: when (ns) it changes to which level."""

    edges: list[int] = field(default_factory=list)
    levels: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, told: Heard, settings: Settings) -> Levels:
        made, bit_ns = cls(), SECOND / settings.baud
        for at_ns, byte in told:
            bits = [0, *(byte >> place & 1 for place in range(8))]
            if settings.parity != "N":
                bits.append((byte.bit_count() + (settings.parity == "O")) & 1)
            for place, level in enumerate([*bits, 1]):
                made.edges.append(round(at_ns + place * bit_ns))
                made.levels.append(level)
        return made

    def at(self, ns: float) -> int:
        place = bisect_right(self.edges, ns) - 1
        return 1 if place < 0 else self.levels[place]


def sampled(drivers: Sequence[Levels], listener: Settings) -> Heard:
    """The bytes that a receiver samples at its own rate, from falling edge to falling edge."""
    result: Heard = []
    free_ns, bit_ns = 0.0, SECOND / listener.baud
    for edge_ns in sorted({edge for one in drivers for edge in one.edges}):
        if edge_ns < free_ns or all(one.at(edge_ns) for one in drivers):
            continue
        if not all(one.at(edge_ns - 1) for one in drivers):
            continue
        byte = 0
        for bit in range(8):
            at_ns = edge_ns + (1.5 + bit) * bit_ns
            byte |= all(one.at(at_ns) for one in drivers) << bit
        result.append((edge_ns, byte))
        free_ns = edge_ns + (listener.bits - 0.5) * bit_ns
    return result
