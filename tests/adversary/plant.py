"""Masters and slaves that talk over a simulated connection and note which answer is to what."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from tests.adversary.tcp import MS, US

if TYPE_CHECKING:
    from collections.abc import Iterator
    from random import Random

    from tests.adversary.tcp import Clock, End

READ_FUNCTIONS = (3, 4, 1, 2)
BIT_READS = (1, 2)
WRITE_REGISTER, WRITE_COIL, WRITE_REGISTERS = 6, 5, 16


@dataclass(slots=True, eq=False)
class Ask:
    """A request that a master sent."""

    connection: int
    raw: bytes
    offset: int
    """Where the request starts in the master's stream."""
    sent_ns: int
    answer: Answer | None = None
    """None if the slave never answers."""
    given_up: bool = False
    """True once the master waits for it no longer."""

    @property
    def end(self) -> int:
        return self.offset + len(self.raw)


@dataclass(slots=True, eq=False)
class Answer:
    """A response that a slave sent."""

    ask: Ask
    raw: bytes
    offset: int
    sent_ns: int
    acknowledged: int
    """How many bytes of the requests the slave had received when it sent this."""

    @property
    def end(self) -> int:
        return self.offset + len(self.raw)


class Ids(Enum):
    """How a master chooses transaction ids."""

    ZERO = "always 0"
    THREE = "always 3"
    CYCLE = "1 to 4"
    COUNTING = "counting"

    def after(self, last: int | None) -> int:
        if self is Ids.ZERO:
            return 0
        if self is Ids.THREE:
            return 3
        if self is Ids.CYCLE:
            return 1 if last is None else last % 4 + 1
        return 0 if last is None else (last + 1) & 0xFFFF


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterPlan:
    """How a master behaves on one connection."""

    ids: Ids
    depth: int = 1
    """How many requests it has open at once."""
    bursts: bool = False
    """True if it sends `depth` requests, and the next ones only after all of these have ended."""
    timeout_ns: int
    pause_ns: int
    """At most this long from an answer to the next request."""
    repeats: bool
    """True if it sends a request again after a timeout; False if it goes on."""
    new_id_for_retry: bool
    requests: int
    """How many requests it sends, retries included."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlavePlan:
    """How a slave behaves."""

    reorders: bool = False
    """True if it works on several requests at once, where their ids differ."""
    silent: float = 0.0
    """The share of requests that it drops."""
    late: float = 0.0
    """The share of requests that it answers after the master's timeout."""
    master_timeout_ns: int
    usual_ns: int
    """Its usual latency."""
    slow: int | None = None
    """A function that takes 150 ms."""
    exceptions: float = 0.02


@dataclass(slots=True)
class Talk:
    """All that was said in a simulation."""

    asks: list[Ask] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)


def adu(transaction_id: int, unit: int, pdu: bytes) -> bytes:
    return struct.pack(">HHHB", transaction_id, 0, len(pdu) + 1, unit) + pdu


def polls(rng: Random) -> list[tuple[int, bytes]]:
    """A plant's list of reads as (unit, PDU): some with equal quantities or addresses."""
    units = rng.choice([[1], [1], [1, 2], [255]])
    quantities = rng.choice([[2], [1, 2, 10], [10, 10, 4, 64], [125, 20, 2]])
    addresses = rng.choice([[0], [0, 100, 200], [107, 0x1000]])
    functions = rng.choice([(3,), (4, 3), READ_FUNCTIONS])
    found = []
    for _ in range(rng.randint(3, 8)):
        function = rng.choice(functions)
        pdu = struct.pack(">BHH", function, rng.choice(addresses), rng.choice(quantities))
        found.append((rng.choice(units), pdu))
    return found


def write(rng: Random) -> bytes:
    function = rng.choice((WRITE_REGISTER, WRITE_COIL, WRITE_REGISTERS))
    address = rng.choice((5, 5, 0x102))
    if function == WRITE_REGISTER:
        return struct.pack(">BHH", function, address, rng.choice((1, 1, rng.randint(0, 65535))))
    if function == WRITE_COIL:
        return struct.pack(">BHH", function, address, rng.choice((0, 0xFF00)))
    count = rng.randint(1, 4)
    values = [rng.randint(0, 65535) for _ in range(count)]
    return struct.pack(f">BHHB{count}H", function, address, count, 2 * count, *values)


class AduSplitter:
    """Cuts a stream without errors into ADUs."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[bytes]:
        self._rest += data
        while len(self._rest) >= 6:
            length = 6 + struct.unpack_from(">H", self._rest, 4)[0]
            if len(self._rest) < length:
                return
            yield self._rest[:length]
            self._rest = self._rest[length:]


class Master:
    """Sends requests to one slave over one connection until it has sent as many as planned."""

    def __init__(self, clock: Clock, end: End, plan: MasterPlan, talk: Talk, rng: Random) -> None:
        self.open: list[Ask] = []
        self.on_end = end.close
        self._clock, self._end, self._plan, self._talk, self._rng = clock, end, plan, talk, rng
        self._splitter = AduSplitter()
        self._polls = polls(rng)
        self._next_poll = 0
        self._last_id: int | None = None
        self._sent = 0
        self._waiting = False
        self._again: list[bytes] = []
        """Requests to be repeated."""
        end.on_bytes = self._take

    def start(self) -> None:
        self._waiting = False
        plan = self._plan
        count = plan.depth - len(self.open)
        if plan.bursts and self.open:
            return
        raws = [self._make() for _ in range(min(count, plan.requests - self._sent))]
        self._sent += len(raws)
        together = len(raws) > 1 and self._rng.random() < 0.5
        start = self._end.sent
        for raw in raws:
            self._note(raw, start)
            start += len(raw)
        if together:
            self._end.send(b"".join(raws))
        else:
            for raw in raws:
                self._end.send(raw, 5 if self._rng.random() < 0.04 else 0)

    def _make(self) -> bytes:
        if self._again:
            raw = self._again.pop(0)
            if not self._plan.new_id_for_retry:
                return raw
            unit, pdu = raw[6], raw[7:]
        elif self._rng.random() < 0.1:
            unit, pdu = self._polls[0][0], write(self._rng)
        else:
            unit, pdu = self._polls[self._next_poll % len(self._polls)]
            self._next_poll += 1
        self._last_id = self._plan.ids.after(self._last_id)
        return adu(self._last_id, unit, pdu)

    def _note(self, raw: bytes, offset: int) -> None:
        ask = Ask(self._end.connection, raw, offset, self._clock.now_ns)
        self._talk.asks.append(ask)
        self.open.append(ask)
        self._clock.after(self._plan.timeout_ns, lambda: self._give_up(ask))

    def _give_up(self, ask: Ask) -> None:
        if ask in self.open:
            ask.given_up = True
            self.open.remove(ask)
            if self._plan.repeats:
                self._again.append(ask.raw)
            self._go_on(self._rng.randint(0, 200) * US)

    def _take(self, data: bytes) -> None:
        for raw in self._splitter.feed(data):
            for ask in self.open:
                if ask.raw[:2] == raw[:2]:
                    self.open.remove(ask)
                    self._go_on(self._rng.randint(50 * US, max(self._plan.pause_ns, 60 * US)))
                    break

    def _go_on(self, delay_ns: int) -> None:
        if self._sent < self._plan.requests:
            if not self._waiting:
                self._waiting = True
                self._clock.after(delay_ns, self.start)
        elif not self.open:
            self._clock.after(2 * self._plan.timeout_ns, self._finish)

    def _finish(self) -> None:
        end, self.on_end = self.on_end, lambda: None
        end()


class Slave:
    """Answers the requests of one connection. The k-th request that arrives is the k-th noted."""

    def __init__(self, clock: Clock, end: End, plan: SlavePlan, talk: Talk, rng: Random) -> None:
        self._clock, self._end, self._plan, self._talk, self._rng = clock, end, plan, talk, rng
        self._splitter = AduSplitter()
        self._arrived = 0
        self._free_ns = 0
        self._free_by_id: dict[bytes, int] = {}
        self._held: list[tuple[Ask, bytes]] = []
        self.pending = 0
        """How many requests it works on."""
        self._value = 0
        end.on_bytes = self._take

    def _take(self, data: bytes) -> None:
        for raw in self._splitter.feed(data):
            ask = next(
                one
                for one in self._talk.asks
                if one.connection == self._end.connection and one.offset == self._arrived
            )
            assert ask.raw == raw
            self._arrived += len(raw)
            self._work(ask)

    def _work(self, ask: Ask) -> None:
        if self._rng.random() < self._plan.silent:
            return
        latency = int(self._plan.usual_ns * self._rng.uniform(0.7, 1.5))
        if ask.raw[7] == self._plan.slow:
            latency = 150 * MS
        if self._rng.random() < self._plan.late:
            latency = self._plan.master_timeout_ns + self._rng.randint(MS, 40 * MS)
        free = self._free_ns
        if self._plan.reorders:
            free = self._free_by_id.get(ask.raw[:2], 0)
        ready = max(self._clock.now_ns, free) + latency
        if self._plan.reorders:
            self._free_by_id[ask.raw[:2]] = ready
        self._free_ns = ready
        self.pending += 1
        self._clock.after(ready - self._clock.now_ns, lambda: self._answer(ask))

    def _answer(self, ask: Ask) -> None:
        self.pending -= 1
        pdu = self._pdu(ask.raw[7:])
        self._held.append((ask, adu(int.from_bytes(ask.raw[:2]), ask.raw[6], pdu)))
        soon = self._clock.now_ns < self._free_ns < self._clock.now_ns + 30 * MS
        if soon and not self._plan.reorders and len(self._held) < 4 and self._rng.random() < 0.3:
            return  # The next answer brings this one along.
        start = self._end.sent
        for one, raw in self._held:
            one.answer = Answer(one, raw, start, self._clock.now_ns, self._end.received)
            self._talk.answers.append(one.answer)
            start += len(raw)
        data = b"".join(raw for _, raw in self._held)
        self._held = []
        self._end.send(
            data, self._rng.randint(1, len(data) - 1) if self._rng.random() < 0.06 else 0
        )

    def _pdu(self, request: bytes) -> bytes:
        function = request[0]
        if self._rng.random() < self._plan.exceptions:
            return bytes([function | 0x80, self._rng.choice((1, 2, 3, 4, 6))])
        if function in READ_FUNCTIONS:
            quantity = struct.unpack_from(">H", request, 3)[0]
            size = (quantity + 7) // 8 if function in BIT_READS else 2 * quantity
            self._value += self._rng.choice((0, 1))
            values = bytes((self._value + place // 2) & 0x7F for place in range(size))
            return bytes([function, size]) + values
        return request[:5]
