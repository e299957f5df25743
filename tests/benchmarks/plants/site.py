"""What a plant has: a line, slaves, a master and what the master asks for, all drawn by a seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat
from tests.benchmarks.plants import pdus
from tests.benchmarks.plants.recording import MS, Bus

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
BAUD_WEIGHTS = (1, 1, 1, 6, 6, 3, 2, 4)
FORMATS = ("8E1", "8N1", "8N2")
FORMAT_WEIGHTS = (4, 4, 1)
TIMEOUTS_MS = (100, 200, 250, 300, 500, 1000)
SMALL_UNITS = range(1, 25)
UNITS = range(1, 248)


@dataclass(frozen=True, slots=True)
class Poll:
    """A read that the master repeats."""

    unit: int
    function: int
    address: int
    quantity: int

    @property
    def pdu(self) -> bytes:
        return pdus.read(self.function, self.address, self.quantity)


class Site:
    """A line with its slaves and its master."""

    def __init__(self, random: Random, line: SerialFormat | None = None) -> None:
        self.random = random
        self.line = line or SerialFormat.parse(
            f"{random.choices(BAUDS, BAUD_WEIGHTS)[0]}-{random.choices(FORMATS, FORMAT_WEIGHTS)[0]}"
        )
        self.bus = Bus(self.line, random)
        self.units = draw_units(random, random.randint(1, 6))
        self.latency_ns = {unit: self._latency() for unit in self.units}
        """The shortest and the longest time until a slave responds."""
        least_ns = max(self.line.t3_5_ns, random.randint(2, 50) * MS)
        self.pause_ns = (least_ns, int(least_ns * random.uniform(1.05, 1.5)))
        """The shortest and the longest pause of the master after a response."""
        self.tries = random.randint(1, 3)
        """How often the master asks before it gives up."""
        self.set_timeout(random.choice(TIMEOUTS_MS) * MS)
        self._values: dict[Poll, list[int]] = {}
        self.polls = [self.poll(unit) for unit in self.units for _ in range(random.randint(1, 4))]
        random.shuffle(self.polls)

    def _latency(self) -> tuple[int, int]:
        least_ns = max(self.line.t3_5_ns, self.random.randint(2 * MS, 25 * MS))
        return least_ns, int(least_ns * self.random.uniform(1.1, 1.6))

    def set_timeout(self, timeout_ns: int, jitter_ns: int = MS // 2) -> None:
        """Choose how long the master waits for a response.

        At a low baud rate the time is longer, since the response itself must fit.
        """
        recording = self.bus.recording
        recording.timeout_ns = max(timeout_ns, 60 * self.line.character_ns)
        recording.jitter_ns = jitter_ns
        recording.pause_ns = self.pause_ns[1]

    # What is asked.

    def poll(self, unit: int, functions: tuple[int, ...] = (1, 2, 3, 3, 3, 4, 4)) -> Poll:
        random = self.random
        function = random.choice(functions)
        address = random.choice((
            random.randrange(0x20), random.randrange(0x100), random.randrange(0x1000),
            random.randrange(0xFF00),
        ))  # fmt: skip
        quantity = random.randint(1, random.choice((12, 12, 12, 125)))
        # A master gives its slave the time to send the whole response.
        room = self.bus.recording.timeout_ns // self.line.character_ns // 2 - 5
        quantity = max(1, min(quantity, room // 2))
        is_bits = function in pdus.READS_OF_BITS
        return Poll(unit, function, address, quantity * 3 if is_bits else quantity)

    def values(self, poll: Poll) -> bytes:
        """The response to a poll; some values change from one time to the next."""
        random = self.random
        highest = 1 if poll.function in pdus.READS_OF_BITS else 0xFFFF
        values = self._values.get(poll)
        if values is None:
            values = [min(highest, self.value()) for _ in range(poll.quantity)]
            self._values[poll] = values
        for _ in range(random.randint(0, 3)):
            values[random.randrange(poll.quantity)] = min(highest, self.value())
        return pdus.read_response(poll.function, values)

    def value(self) -> int:
        """A register: often 0 or small."""
        random = self.random
        return random.choice((0, 1, random.randrange(100), random.randrange(4096),
                              random.randrange(65536)))  # fmt: skip

    def write(self, functions: tuple[int, ...] = (0x05, 0x06, 0x0F, 0x10)) -> bytes:
        """A write request."""
        random = self.random
        address = random.choice((random.randrange(0x40), random.randrange(0x2000)))
        match random.choice(functions):
            case 0x05:
                return pdus.write_coil(address, random.random() < 0.5)
            case 0x06:
                return pdus.write_register(address, self.value())
            case 0x0F:
                return pdus.write_coils(address, random.choices((0, 1), k=random.randint(1, 40)))
            case 0x16:
                return pdus.mask_write(address, self.value(), self.value())
            case _:
                return pdus.write_registers(
                    address, [self.value() for _ in range(random.randint(1, 10))]
                )

    # What becomes of it.

    def read(self, poll: Poll, lost: int = 0) -> None:
        """Poll a slave, which responds."""
        self.exchange(poll.unit, poll.pdu, lambda: self.values(poll), lost=lost)

    def exchange(
        self,
        unit: int,
        request: bytes,
        response: Callable[[], bytes],
        latency_ns: tuple[int, int] | None = None,
        lost: int = 0,
    ) -> None:
        """Ask, and get a response; so many times before in vain."""
        for number in range(lost):
            self.bus.ask(unit, request, is_retry=number > 0)
            self.time_out()
        at = self.bus.ask(unit, request, is_retry=lost > 0)
        self.bus.wait(self.random.randint(*(latency_ns or self.latency(unit))))
        self.bus.reply(at, response())
        self.pause()

    def latency(self, unit: int) -> tuple[int, int]:
        return self.latency_ns.get(unit, (3 * MS, 6 * MS))

    def unanswered(self, unit: int, request: bytes, tries: int | None = None) -> None:
        """Ask as often as the master does, and get no response."""
        for number in range(tries or self.tries):
            self.bus.ask(unit, request, is_retry=number > 0)
            self.time_out()
        self.pause()

    def time_out(self) -> None:
        recording = self.bus.recording
        self.bus.wait(recording.timeout_ns + self.random.randint(0, recording.jitter_ns))

    def pause(self) -> None:
        self.bus.wait(self.random.randint(*self.pause_ns))

    @property
    def asked(self) -> int:
        """How many requests there were."""
        return self.bus.recording.requests


def draw_units(random: Random, count: int) -> list[int]:
    """Numbers of slaves: usually they begin at 1 and are small."""
    kind = random.random()
    if kind < 0.4:
        return list(range(1, count + 1))
    if kind < 0.8:
        return random.sample(SMALL_UNITS, count)
    return random.sample(UNITS, count)
