"""Lines with masters and slaves, heard byte by byte, by a port with 1 ms, or by an FTDI adapter."""

# Each frame is put on the wire at a time. Where two frames overlap, their bytes are damaged, as on
# a real wire. A master sends its next request when the response has come or its time-out is over.

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat, WireEvent
from mbtool.decode.connections import Bus
from mbtool.devices import Namer
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.ledger.account import Account
from mbtool.modbus import Transaction, rtu_adu
from mbtool.troubles.judge import Judge

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices import NamedTransaction
    from mbtool.troubles.judge import Judgement

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
LINE = SerialFormat(19200)
FTDI_NS, FTDI_BYTES = 16 * MS, 62
EXACT, POLLED, FTDI = "exact", "1 ms", "FTDI"
TIMINGS = (EXACT, POLLED, FTDI)


@dataclass(slots=True)
class Sent:
    """A frame on the wire."""

    at_ns: int
    data: bytes

    def end_ns(self, line: SerialFormat) -> int:
        return self.at_ns + len(self.data) * line.character_ns


def read_pdu(address: int, quantity: int) -> bytes:
    return bytes([3]) + address.to_bytes(2) + quantity.to_bytes(2)


def values_pdu(random: Random, quantity: int) -> bytes:
    return bytes([3, 2 * quantity]) + random.randbytes(2 * quantity)


@dataclass(slots=True, kw_only=True)
class Plant:
    """A master that polls units in turn; `respond` returns what a unit sends to a request.

    Times are in ms. `latency` has the latency of each unit; a unit without one is silent.
    """

    units: Sequence[int] = (1, 2, 3)
    latency: dict[int, float] = field(default_factory=dict)
    timeout: float = 500
    cycle: float = 1000
    pause: float = 10
    quantity: int = 4
    retries: int = 0
    seed: int = 1
    line: SerialFormat = LINE
    begin: float = 0
    respond: Callable[[Plant, Sent, int, bytes], list[Sent]] | None = None
    random: Random = field(init=False)
    failed: int = field(init=False, default=0)
    """How many requests the master gave up: the truth by its own count."""

    def __post_init__(self) -> None:
        self.random = Random(self.seed)

    def run(self, seconds: float) -> list[Sent]:
        """Return all frames that master and slaves send, sorted by time.

        The master takes the first response of the unit that begins while it waits, be it to this
        request or late to an earlier one.
        """
        frames: list[Sent] = []
        self.failed = 0
        now = START_NS + round(self.begin * MS)
        end = now + round(seconds * 1e9)
        busy_until = dict.fromkeys(self.units, 0)
        coming: dict[int, list[Sent]] = {unit: [] for unit in self.units}
        while now < end:
            next_cycle = now + round(self.cycle * MS)
            for unit in self.units:
                pdu = read_pdu(unit * 16, self.quantity)
                for _ in range(self.retries + 1):
                    request = Sent(now, rtu_adu(unit, pdu))
                    came = self._answers(request, unit, pdu, busy_until)
                    frames += [request, *came]
                    coming[unit] += came
                    sent = request.end_ns(self.line)
                    give_up = sent + round(self.timeout * MS)
                    taken = [one for one in coming[unit] if sent <= one.at_ns < give_up]
                    now = min((one.end_ns(self.line) for one in taken), default=give_up)
                    coming[unit] = [one for one in coming[unit] if one.at_ns > now]
                    now += round(self.pause * MS)
                    if taken:
                        break
                    self.failed += 1
            now = max(now, next_cycle)
        return sorted(frames, key=lambda one: one.at_ns)

    def _answers(
        self, request: Sent, unit: int, pdu: bytes, busy_until: dict[int, int]
    ) -> list[Sent]:
        if self.respond is not None:
            return self.respond(self, request, unit, pdu)
        latency = self.latency.get(unit)
        if latency is None:
            return []
        jitter = self.random.uniform(0.9, 1.1)
        begin = max(request.end_ns(self.line), busy_until[unit])
        at_ns = begin + round(latency * jitter * MS)
        busy_until[unit] = at_ns
        return [Sent(at_ns, rtu_adu(unit, values_pdu(self.random, self.quantity)))]


def reads(
    frames: Sequence[Sent], timing: str, line: SerialFormat = LINE
) -> Iterator[tuple[bytes, int]]:
    """Yield what a program reads: bytes, and the time at which it got the last of them."""
    heard: list[tuple[int, int]] = []
    ends_ns = 0
    for one in sorted(frames, key=lambda one: one.at_ns):
        for place, byte in enumerate(one.data):
            at_ns = one.at_ns + (place + 1) * line.character_ns
            if at_ns <= ends_ns:  # Two drivers at once: a 0 of either of them wins.
                at = len(heard) - 1
                while at > 0 and heard[at][0] > at_ns:
                    at -= 1
                heard[at] = (heard[at][0], heard[at][1] & byte)
            else:
                heard.append((at_ns, byte))
                ends_ns = at_ns
    if timing == EXACT:
        yield from ((bytes([byte]), at_ns) for at_ns, byte in heard)
        return
    tick_ns = MS if timing == POLLED else FTDI_NS
    data, due_ns = bytearray(), 0
    for at_ns, byte in heard:
        if data and (at_ns > due_ns or len(data) >= FTDI_BYTES):
            yield bytes(data), min(due_ns, at_ns)
            data.clear()
        if not data:
            due_ns = (at_ns // tick_ns + 1) * tick_ns
        data.append(byte)
    if data:
        yield bytes(data), due_ns


def records_of(
    frames: Sequence[Sent], timing: str = EXACT, line: SerialFormat = LINE
) -> Iterator[NamedTransaction | WireEvent]:
    """Decode what is heard of the frames."""
    bus, namer = Bus("line", line), Namer()
    for data, at_ns in reads(frames, timing, line):
        yield from _named(bus.advance(at_ns - len(data) * line.character_ns), namer)
        yield from _named(bus.feed(data, at_ns), namer)
    yield from _named(bus.close(), namer)


def _named(items: Sequence[object], namer: Namer) -> Iterator[NamedTransaction | WireEvent]:

    for one in items:
        if isinstance(one, Transaction):
            yield namer.name(one)
        elif isinstance(one, WireEvent):
            yield one


def judged(frames: Sequence[Sent], timing: str = EXACT, line: SerialFormat = LINE) -> Judgement:
    """Decode what is heard of the frames, and judge it as `check` does."""
    context = CaptureContext(line_of=lambda _: line, has_exact_times=lambda _: timing == EXACT)
    judge = Judge(Account(lambda _: line), context)
    judge.begin_capture()
    for record in records_of(frames, timing, line):
        judge.count(record)
        for finding in judge.check(record):
            judge.note(finding)
    for finding in judge.end_capture():
        judge.note(finding)
    judge.ledger.settle()
    return judge.judgement()


def codes(judgement: Judgement) -> list[tuple[str, int | None]]:
    return [(one.code, one.unit) for one in judgement.troubles]
