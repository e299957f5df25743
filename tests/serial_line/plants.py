"""Traffic of plants with a known truth: slow writes, dead units, retries, times set exactly."""

# A master polls registers in turn and writes in between. Unlike tests/benchmarks/bus_traffic.py,
# all times and losses are parameters of the plant, so that a test can ask for just one difficulty.

from __future__ import annotations

from dataclasses import dataclass, replace
from random import Random

from mbtool.core import Direction, SerialFormat
from mbtool.modbus import Outcome, rtu_adu
from tests.benchmarks.adapters import Column, Damage, Wire, damaged, delivered
from tests.benchmarks.bus_traffic import START_NS, Exchange, Frame, Traffic
from tests.benchmarks.figures import Figures, figures
from tests.benchmarks.line import hear

MS = 1_000_000
LINE = SerialFormat(19200, 8, "E", 1)
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """One master and its slaves. All times are in milliseconds."""

    units: tuple[int, ...] = (1, 2, 3)
    dead_units: tuple[int, ...] = ()
    """Units that are written to and never answer."""
    write_codes: tuple[int, ...] = (0x05, 0x06)
    write_share: float = 0.2
    """The share of writes among what the master starts."""
    write_loss: float = 0.0
    """The share of writes that no slave hears, so that the master has to repeat them."""
    read_loss: float = 0.0
    read_latency: tuple[float, float] = (3, 4)
    write_latency: tuple[float, float] = (3, 4)
    pause: tuple[float, float] = (10, 20)
    """From the end of an exchange to the next request."""
    timeout: float = 200
    jitter: float = 0
    """The master's timer is late by up to so much."""
    retries: int = 2
    """How often the master repeats a request at most."""

    def traffic(self, seed: int, exchanges: int = 400) -> Traffic:
        return _Master(self, Random(f"plant {seed}")).run(exchanges)


class _Master:
    def __init__(self, plant: Plant, random: Random) -> None:
        self._plant = plant
        self._random = random
        self._traffic = Traffic(LINE)
        self._now_ns = START_NS
        self._started = 0

    def run(self, exchanges: int) -> Traffic:
        for _ in range(exchanges):
            self._exchange()
            self._wait(self._plant.pause)
        return self._traffic

    def _exchange(self) -> None:
        plant, random = self._plant, self._random
        if random.random() < plant.write_share:
            unit = random.choice(plant.units + plant.dead_units)
            request, response = self._write(random.choice(plant.write_codes))
            loss, latency = plant.write_loss, plant.write_latency
        else:
            unit = plant.units[self._started % len(plant.units)]
            self._started += 1
            address = self._started % 5
            request = bytes((0x03, 0x10, address, 0, 2))
            response = b"\x03\x04" + random.randbytes(4)
            loss, latency = plant.read_loss, plant.read_latency
        if unit in plant.dead_units:
            loss = 1.0
        for _ in range(plant.retries + 1):
            asked = self._say(unit, request, REQUEST, None)
            if random.random() >= loss:
                self._wait(latency)
                self._say(unit, response, RESPONSE, asked)
                return
            self._wait((plant.timeout, plant.timeout + plant.jitter))

    def _write(self, code: int) -> tuple[bytes, bytes]:
        random = self._random
        address = bytes((code, 0x02, random.randrange(4)))
        if code == 0x05:
            request = address + random.choice((b"\xff\x00", b"\x00\x00"))
            return request, request
        if code == 0x06:
            request = address + bytes((0, random.randrange(200)))
            return request, request
        request = address + b"\x00\x02\x04" + random.randbytes(4)
        return request, request[:5]

    def _wait(self, times_ms: tuple[float, float]) -> None:
        self._now_ns += int(self._random.uniform(*times_ms) * MS)

    def _say(self, unit: int, pdu: bytes, direction: Direction, exchange: int | None) -> int:
        """Send a frame; `exchange` is the place of the exchange that it answers."""
        traffic = self._traffic
        exchanges, raw = traffic.exchanges, rtu_adu(unit, pdu)
        if exchange is None:
            exchange = len(exchanges)
            exchanges.append(Exchange(len(traffic.frames), None, Outcome.NO_ANSWER))
        else:
            exchanges[exchange].response = len(traffic.frames)
            exchanges[exchange].outcome = Outcome.OK
        start_ns, offset = self._now_ns, len(traffic.data)
        traffic.times += [start_ns + (at + 1) * traffic.line.character_ns for at in range(len(raw))]
        traffic.data += raw
        self._now_ns = traffic.times[-1]
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
        return exchange


def wire_of(traffic: Traffic) -> Wire:
    """The traffic on a wire, without damage."""
    return damaged(traffic, Damage.NONE, Random(0))


def read(traffic: Traffic, column: Column = Column.BYTES) -> Figures:
    """What the decoder makes of the traffic through one kind of adapter."""
    wire = wire_of(traffic)
    return figures(traffic, wire, hear(wire, delivered(wire, column), column))


def read_all(plant: Plant, column: Column, seeds: range, exchanges: int = 400) -> Figures:
    """The figures of several lines of one plant."""
    counted = Figures()
    for seed in seeds:
        counted.add(read(plant.traffic(seed, exchanges), column))
    return counted


SLOW_WRITES = Plant(write_latency=(95, 105))
DEAD_UNITS = Plant(dead_units=(20, 21), write_codes=(0x05, 0x06, 0x10))
RETRIED_WRITES = Plant(write_loss=0.1, read_loss=0.02, write_codes=(0x05, 0x06, 0x10))
SLOW_AND_RETRIED = replace(RETRIED_WRITES, write_latency=(20, 60), jitter=15)
