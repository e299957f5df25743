"""Makes the traffic of an RS-485 line from a seed, and knows the truth about every byte of it."""

# A master polls a list over and over, writes now and then, and now and then uses what is rare. What
# is usual on such a line follows from the list; all else happens at the rates of RATES, whose
# comments say what each is there to try. Slaves answer after 1 to 50 ms, whether or not that keeps
# t3.5; the master pauses from t3.5 to 50 ms. Nobody speaks while another does.
#
# The truth is told as a tap can know it: a request that is asked again stayed without an answer,
# and an answer that comes after the repetition belongs to the repetition.

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from mbtool.core import Direction, SerialFormat
from mbtool.modbus import Outcome, encode_pdu, exception_pdu, rtu_adu

if TYPE_CHECKING:
    from collections.abc import Callable

LINE = SerialFormat()
START_NS = 1_700_000_000_000_000_000
MS = 1_000_000

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@dataclass(frozen=True, slots=True, kw_only=True)
class Rates:
    """How often, as a share of what the master starts; the rest is polling."""

    # What is asked.
    write: float = 0.10  # 05 06 0F 10 16 17
    rare: float = 0.06  # 07 08 0B 0C 11 14 15 18 2B: in turn, so that each comes
    vendor: float = 0.02  # 65-72 and 100-110: no table knows their length
    broadcast: float = 0.01  # no answer, then 100 to 200 ms of silence
    embedded: float = 0.01  # registers that hold whole valid frames
    # What becomes of it.
    exception: float = 0.02  # a third of them with CHINO's codes 11H and 12H
    missing: float = 0.01  # nobody answers, and the master goes on
    retry: float = 0.01  # nobody answers, and the master asks again, once or twice
    late: float = 0.005  # the answer comes after the repetition; half of them come twice
    late_elsewhere: float = 0.002  # the answer comes after a request to another unit
    # How it looks.
    zero_ended: float = 0.03  # a CRC that ends in 00, where values can be chosen for it
    hesitating: float = 0.02  # a pause of up to t1.5 inside a frame


RATES = Rates()

WRITES = (0x05, 0x06, 0x0F, 0x10, 0x16, 0x17)
RARE = (0x07, 0x08, 0x0800, 0x0804, 0x0B, 0x0C, 0x11, 0x14, 0x15, 0x18, 0x2B0D, 0x2B0E)
"""Functions, and with four digits a function with what follows it; 0800 has longer data."""
VENDOR = (*range(65, 73), *range(100, 111))
EXCEPTIONS = (0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x08, 0x0A, 0x0B)
VENDOR_EXCEPTIONS = (0x11, 0x12)
BROADCASTS = (0x05, 0x06, 0x0F, 0x10)

AREAS = ((0x0000, 0x00FF), (0x0200, 0x02FF), (0x0300, 0x03FF), (0x0400, 0xFF00))
"""In 0200-03FF a request can look like a response of two or three bytes."""
ZERO_ENDED_POLLS = 0.2
"""The share of the poll list whose requests end in 00."""
TRIES = 2048
"""One in 256 ends in 00."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One frame as it was sent."""

    raw: bytes
    direction: Direction
    offset: int
    """Where it begins in the bytes of the line."""
    start_ns: int
    end_ns: int
    transaction: int
    """Its place in the list of transactions."""


@dataclass(slots=True)
class Exchange:
    """One transaction as it happened: places in the list of frames, and the outcome."""

    request: int | None
    response: int | None
    outcome: Outcome

    @property
    def frames(self) -> tuple[int, ...]:
        return tuple(one for one in (self.request, self.response) if one is not None)


@dataclass(slots=True)
class Traffic:
    """What was sent on a line."""

    line: SerialFormat
    frames: list[Frame] = field(default_factory=list)
    exchanges: list[Exchange] = field(default_factory=list)
    data: bytearray = field(default_factory=bytearray)
    times: list[int] = field(default_factory=list)
    """When the last bit of each byte was sent."""


@dataclass(frozen=True, slots=True)
class Poll:
    """What a master asks again and again."""

    unit: int
    function: int
    address: int
    quantity: int


def bus_traffic(
    seed: int, transactions: int, line: SerialFormat = LINE, rates: Rates = RATES
) -> Traffic:
    """The traffic of a line, the same for the same arguments."""
    return _Master(Random(f"bus {seed}"), line, rates).run(transactions)


class _Master:
    """Plays the master and, since nobody speaks while another does, the slaves too."""

    def __init__(self, random: Random, line: SerialFormat, rates: Rates) -> None:
        self._random = random
        self._rates = rates
        self._traffic = Traffic(line)
        self._now_ns = START_NS
        self._units = random.sample(range(1, 248), random.randint(1, 8))
        self._latency_ms = {unit: random.uniform(1, 40) for unit in self._units}
        self._timeout_ns = random.randint(100, 1000) * MS
        self._pause_ns = random.randint(line.t3_5_ns, 30 * MS)
        self._polls = self._poll_list()
        self._values: dict[Poll, list[int]] = {}
        self._started = 0
        self._rare = random.sample(RARE, len(RARE))

    def run(self, transactions: int) -> Traffic:
        while len(self._traffic.exchanges) < transactions:
            self._start_one()
            least = self._traffic.line.t3_5_ns
            self._now_ns += max(least, int(self._pause_ns * self._random.uniform(0.8, 1.6)))
        return self._traffic

    # What is asked.

    def _start_one(self) -> None:
        random, rates = self._random, self._rates
        kind = random.random()
        unit = random.choice(self._units)
        rarer: tuple[tuple[float, Callable[[], None]], ...] = (
            (rates.write, lambda: self._write(unit, random.choice(WRITES))),
            (rates.rare, lambda: self._exchange(unit, *self._rare_pdus())),
            (rates.vendor, lambda: self._exchange(unit, *self._vendor_pdus())),
            (rates.broadcast, lambda: self._write(0, random.choice(BROADCASTS))),
            (rates.embedded, lambda: self._exchange(unit, *self._embedding_pdus())),
        )
        for share, ask in rarer:
            if kind < share:
                ask()
                return
            kind -= share
        poll = self._polls[self._started % len(self._polls)]
        self._started += 1
        self._exchange(poll.unit, _request(poll), lambda: self._answer(poll))

    def _poll_list(self) -> list[Poll]:
        random = self._random
        polls = [self._poll(unit) for unit in self._units for _ in range(random.randint(1, 3))]
        unit = random.choice(self._units)
        polls.append(self._poll(unit, random.choice((0x01, 0x02)), (0x0300, 0x03FF), (17, 24)))
        polls.append(self._poll(unit, random.choice((0x01, 0x02, 0x03, 0x04)), (0x0200, 0x02FF)))
        polls.append(self._poll(unit, random.choice((0x03, 0x04)), quantities=(2, 2)))
        random.shuffle(polls)
        return polls

    def _poll(
        self,
        unit: int,
        function: int | None = None,
        area: tuple[int, int] | None = None,
        quantities: tuple[int, int] | None = None,
    ) -> Poll:
        random = self._random
        function = function or random.choice((0x01, 0x02, 0x03, 0x03, 0x03, 0x04, 0x04))
        area = area or random.choice(AREAS)
        if quantities is None:
            small, large = ((1, 64), (65, 2000)) if function < 0x03 else ((1, 20), (21, 125))
            quantities = random.choice((small, small, small, small, small, large))
        quantity = random.randint(*quantities)
        poll = Poll(unit, function, random.randint(*area), quantity)
        if random.random() < ZERO_ENDED_POLLS:
            for _ in range(TRIES):
                if rtu_adu(unit, _request(poll))[-1] == 0:
                    break
                poll = Poll(unit, function, random.randint(*area), random.randint(*quantities))
        return poll

    def _answer(self, poll: Poll) -> bytes:
        """The values of a poll, of which some change from one time to the next."""
        random = self._random
        highest = 1 if poll.function < 0x03 else 0xFFFF
        values = self._values.get(poll)
        if values is None:
            values = self._values[poll] = [self._value(highest) for _ in range(poll.quantity)]
        for _ in range(random.randint(0, 3)):
            values[random.randrange(poll.quantity)] = self._value(highest)
        return encode_pdu(poll.function, RESPONSE, values=tuple(values))

    def _value(self, highest: int = 0xFFFF) -> int:
        """Registers are mostly small, or zero."""
        return min(highest, self._random.choice((0, 1, *(self._random.randrange(n) for n in
                   (256, 4096, 65536)))))  # fmt: skip

    def _registers(self, least: int, most: int) -> tuple[int, ...]:
        return tuple(self._value() for _ in range(self._random.randint(least, most)))

    def _bytes(self, least: int, most: int) -> bytes:
        return self._random.randbytes(self._random.randint(least, most))

    def _write(self, unit: int, function: int) -> None:
        random = self._random
        address = random.randint(*random.choice(AREAS))
        match function:
            case 0x05:
                request = encode_pdu(
                    function, REQUEST, address=address, value=random.choice((0, 0xFF00))
                )
                response = request
            case 0x06:
                request = response = encode_pdu(
                    function, REQUEST, address=address, value=self._value()
                )
            case 0x0F:
                bits = tuple(random.choices((0, 1), k=random.randint(1, 64)))
                request = encode_pdu(function, REQUEST, address=address, values=bits)
                response = request[:5]
            case 0x10:
                registers = self._registers(1, random.choice((4, 16, 123)))
                request = encode_pdu(function, REQUEST, address=address, values=registers)
                response = request[:5]
            case 0x16:
                request = response = encode_pdu(
                    function,
                    REQUEST,
                    address=address,
                    and_mask=random.randrange(65536),
                    or_mask=random.randrange(65536),
                )
            case _:  # 17
                registers = self._registers(1, 8)
                read = self._registers(1, 20)
                request = encode_pdu(
                    function,
                    REQUEST,
                    address=random.randint(*random.choice(AREAS)),
                    quantity=len(read),
                    write_address=address,
                    values=registers,
                )
                response = encode_pdu(function, RESPONSE, values=read)
        if unit == 0:
            self._broadcast(request)
        else:
            self._exchange(unit, request, lambda: response)

    def _rare_pdus(self) -> tuple[bytes, Callable[[], bytes | None]]:
        random = self._random
        self._rare.append(rare := self._rare.pop(0))
        function = rare if rare < 0x100 else rare >> 8
        response: bytes | None
        match rare:
            case 0x07:
                request = encode_pdu(function, REQUEST)
                response = encode_pdu(function, RESPONSE, status=random.randrange(256))
            case 0x08:
                sub_function = random.choice((1, 2, 3, *range(10, 19), 20))
                asked = {1: random.choice((0, 0xFF00)), 3: 0x3B00}.get(sub_function, 0)
                echoed = sub_function in (1, 3, 10, 20)
                request, response = (
                    encode_pdu(function, role, sub_function=sub_function, values=(value,))
                    for role, value in (
                        (REQUEST, asked),
                        (RESPONSE, asked if echoed else self._value()),
                    )
                )
            case 0x0800:
                words = tuple(random.randrange(65536) for _ in range(random.randint(1, 60)))
                request = response = encode_pdu(function, REQUEST, sub_function=0, values=words)
            case 0x0804:  # Force listen only: nobody answers.
                request = encode_pdu(function, REQUEST, sub_function=4, values=(0,))
                response = None
            case 0x0B:
                request = encode_pdu(function, REQUEST)
                response = encode_pdu(
                    function,
                    RESPONSE,
                    status=random.choice((0, 0xFFFF)),
                    event_count=self._value(),
                )
            case 0x0C:
                request = encode_pdu(function, REQUEST)
                response = encode_pdu(function, RESPONSE, data=bytes(2) + self._bytes(4, 68))
            case 0x11:
                request = encode_pdu(function, REQUEST)
                name = self._bytes(1, 20) + random.choice((b"\x00", b"\xff"))
                response = encode_pdu(function, RESPONSE, data=name)
            case 0x14 | 0x15:
                files = [
                    (random.randint(1, 9), random.randrange(10000), self._registers(1, 12))
                    for _ in range(random.randint(1, 3))
                ]
                if rare == 0x15:
                    request = response = encode_pdu(function, REQUEST, groups=tuple(files))
                else:
                    wanted = tuple((file, record, len(data)) for file, record, data in files)
                    request = encode_pdu(function, REQUEST, groups=wanted)
                    read = tuple((data,) for _, _, data in files)
                    response = encode_pdu(function, RESPONSE, groups=read)
            case 0x18:
                request = encode_pdu(function, REQUEST, address=random.randint(*AREAS[1]))
                queue = self._registers(0, 31)
                response = encode_pdu(function, RESPONSE, fifo=(len(queue), *queue))
            case 0x2B0D:
                request = encode_pdu(function, REQUEST, mei_type=0x0D, data=self._bytes(2, 20))
                response = encode_pdu(function, RESPONSE, mei_type=0x0D, data=self._bytes(2, 40))
            case _:  # 2B0E
                code = random.randint(1, 4)
                request = encode_pdu(function, REQUEST, mei_type=0x0E, read_code=code, object_id=0)
                objects = tuple((number, self._bytes(1, 20)) for number in range(3))
                response = encode_pdu(
                    function,
                    RESPONSE,
                    mei_type=0x0E,
                    read_code=code,
                    conformity=random.choice((0x01, 0x02, 0x83)),
                    more_follows=0,
                    next_object_id=0,
                    objects=objects,
                )
        return request, lambda: response

    def _vendor_pdus(self) -> tuple[bytes, Callable[[], bytes]]:
        code = bytes([self._random.choice(VENDOR)])
        return code + self._bytes(0, 40), lambda: code + self._bytes(0, 60)

    def _embedding_pdus(self) -> tuple[bytes, Callable[[], bytes]]:
        """A read or a write of registers that hold frames of this very line."""
        random = self._random
        poll = random.choice(self._polls)
        request, response = (
            rtu_adu(poll.unit, pdu) for pdu in (_request(poll), self._answer(poll))
        )
        held = random.choice((request, response, request + response))
        if len(held) > 200:
            held = request
        around = random.choice((0, 1, 2, 3, 20))
        data = self._bytes(around, around) + held
        data += self._bytes(around, around)
        data += bytes(len(data) % 2)
        registers = tuple(int.from_bytes(data[at : at + 2]) for at in range(0, len(data), 2))
        address = random.randint(*random.choice(AREAS))
        if random.random() < 0.3:
            write = encode_pdu(0x10, REQUEST, address=address, values=registers)
            return write, lambda: write[:5]
        function = random.choice((0x03, 0x04))
        return (
            encode_pdu(function, REQUEST, address=address, quantity=len(registers)),
            lambda: encode_pdu(function, RESPONSE, values=registers),
        )

    # What becomes of it.

    def _exchange(self, unit: int, request: bytes, answer: Callable[[], bytes | None]) -> None:
        random, rates = self._random, self._rates
        response = answer()
        if random.random() < rates.zero_ended:
            request, response = self._zero_ended(unit, request, response)
        chance = random.random()
        if response is None or (chance := chance - rates.missing) < 0:
            self._ask(unit, request)
            self._now_ns += self._timeout_ns
            return
        outcome = Outcome.OK
        if random.random() < rates.exception:
            codes = random.choice((EXCEPTIONS, EXCEPTIONS, VENDOR_EXCEPTIONS))
            response = exception_pdu(request[0], random.choice(codes))
            outcome = Outcome.EXCEPTION
        if (chance := chance - rates.retry) < 0:
            for _ in range(random.randint(1, 2)):
                self._ask(unit, request)
                self._now_ns += self._timeout_ns
        elif (chance := chance - rates.late) < 0:
            self._answer_late(unit, request, response, outcome)
            return
        elif chance - rates.late_elsewhere < 0 and len(self._units) > 1:
            self._answer_elsewhere(unit, request, response)
            return
        exchange = self._ask(unit, request)
        self._now_ns += self._latency_ns(unit)
        self._reply(unit, response, exchange, outcome)

    def _answer_late(self, unit: int, request: bytes, response: bytes, outcome: Outcome) -> None:
        self._ask(unit, request)
        self._now_ns += self._timeout_ns
        exchange = self._ask(unit, request)
        self._now_ns += self._latency_ns(unit)
        self._reply(unit, response, exchange, outcome)
        if self._random.random() < 0.5:
            self._now_ns += self._latency_ns(unit)
            self._reply(unit, response, None, Outcome.UNSOLICITED)

    def _answer_elsewhere(self, unit: int, request: bytes, response: bytes) -> None:
        late = self._ask(unit, request)
        self._now_ns += self._timeout_ns
        others = [poll for poll in self._polls if poll.unit != unit]
        poll = self._random.choice(others)
        exchange = self._ask(poll.unit, _request(poll))
        self._now_ns += self._latency_ns(unit)
        self._reply(unit, response, late, Outcome.LATE)
        self._now_ns += self._latency_ns(poll.unit)
        self._reply(poll.unit, self._answer(poll), exchange, Outcome.OK)

    def _broadcast(self, request: bytes) -> None:
        exchange = self._ask(0, request)
        self._traffic.exchanges[exchange].outcome = Outcome.BROADCAST
        self._now_ns += self._random.randint(100, 200) * MS

    def _zero_ended(
        self, unit: int, request: bytes, response: bytes | None
    ) -> tuple[bytes, bytes | None]:
        """The same with other values at the end of what carries them, so that a CRC ends in 00."""
        values_end = {0x03: response, 0x04: response, 0x17: response, 0x06: request, 0x10: request}
        pdu = values_end.get(request[0])
        if pdu is None or len(pdu) < 4:
            return request, response
        for _ in range(TRIES):
            if rtu_adu(unit, pdu)[-1] == 0:
                break
            pdu = pdu[:-2] + self._random.randbytes(2)
        match request[0]:
            case 0x06:
                return pdu, pdu
            case 0x10:
                return pdu, pdu[:5]
        return request, pdu

    # How it is sent.

    def _latency_ns(self, unit: int) -> int:
        return int(self._latency_ms[unit] * self._random.uniform(1, 1.25) * MS)

    def _ask(self, unit: int, pdu: bytes) -> int:
        """Send a request, to which there is no answer as yet; its place among the exchanges."""
        exchanges = self._traffic.exchanges
        exchanges.append(Exchange(len(self._traffic.frames), None, Outcome.NO_ANSWER))
        self._say(unit, pdu, REQUEST, len(exchanges) - 1)
        return len(exchanges) - 1

    def _reply(self, unit: int, pdu: bytes, exchange: int | None, outcome: Outcome) -> None:
        exchanges = self._traffic.exchanges
        frame = len(self._traffic.frames)
        if exchange is None:
            exchange = len(exchanges)
            exchanges.append(Exchange(None, frame, outcome))
        else:
            exchanges[exchange].response = frame
            exchanges[exchange].outcome = outcome
        self._say(unit, pdu, RESPONSE, exchange)

    def _say(self, unit: int, pdu: bytes, direction: Direction, exchange: int) -> None:
        traffic, random = self._traffic, self._random
        raw = rtu_adu(unit, pdu)
        start_ns, offset = self._now_ns, len(traffic.data)
        hesitates_at = -1
        if random.random() < self._rates.hesitating:
            hesitates_at = random.randrange(1, len(raw))
        for at in range(len(raw)):
            if at == hesitates_at:
                self._now_ns += random.randint(0, traffic.line.t1_5_ns)
            self._now_ns += traffic.line.character_ns
            traffic.times.append(self._now_ns)
        traffic.data += raw
        traffic.frames.append(
            Frame(
                raw=raw,
                direction=direction,
                offset=offset,
                start_ns=start_ns,
                end_ns=self._now_ns,
                transaction=exchange,
            )
        )


def _request(poll: Poll) -> bytes:
    return encode_pdu(poll.function, REQUEST, address=poll.address, quantity=poll.quantity)
