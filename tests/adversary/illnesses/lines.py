"""Sick and healthy serial lines."""

# Each illness is a cause in the field, made on the simulated wire or at the listener. `share` is
# how often it shows, from 0 to 1, by its severity.

from __future__ import annotations

from functools import partial
from itertools import pairwise
from random import Random
from typing import TYPE_CHECKING

from tests.adversary.illnesses.case import (
    ALONE,
    BESIDES,
    DEAD,
    MEDIUM,
    MILD,
    REFUSING,
    SEVERE,
    SEVERITIES,
    SLOW,
    WITH,
    Case,
    Recording,
)
from tests.adversary.illnesses.files import TIMINGS, write_line
from tests.adversary.illnesses.wire import (
    MS,
    SECOND,
    Heard,
    Line,
    Master,
    Sent,
    Settings,
    Slave,
    heard,
    received,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

SECONDS = 120
DEAD_UNIT, SLOW_UNIT, REFUSED = 77, 78, 900
SHARE = {MILD: 0.05, MEDIUM: 0.25, SEVERE: 0.8}


class Plant:
    """A line with its ordinary master and slaves, before it becomes sick."""

    def __init__(
        self, seed: int, beside: str, baud: int | None = None, seconds: int = SECONDS
    ) -> None:
        self.seconds = seconds
        self.random = random = Random(seed)
        self.beside = beside
        self.settings = Settings(baud or random.choice((9600, 19200, 38400)))
        self.line = Line(random, self.settings)
        self.units = random.sample(range(1, 60), random.choice((3, 4, 5)))
        self.timeout_ms = random.choice((300, 500, 800))
        self.slaves = [
            Slave(line=self.line, unit=unit, latency_ms=self._usual()) for unit in self.units
        ]
        polls = [
            (unit, self._poll()) for unit in self.units for _ in range(random.choice((1, 1, 2)))
        ]
        if beside == DEAD:
            polls.append((DEAD_UNIT, self._poll()))
        if beside == REFUSING:
            polls.append((self.units[0], bytes([3]) + REFUSED.to_bytes(2, "big") + b"\0\2"))
            self.slaves[0].refuses = frozenset([REFUSED])
        if beside == SLOW:
            slow = Slave(
                line=self.line,
                unit=SLOW_UNIT,
                latency_ms=lambda: self.timeout_ms * random.uniform(0.4, 0.6),
            )
            self.slaves.append(slow)
            polls.append((SLOW_UNIT, self._poll()))
        self.master = Master(
            line=self.line,
            polls=polls,
            period_ms=random.choice((1000, 1500, 500)),
            timeout_ms=self.timeout_ms,
            pause_ms=random.choice((5, 10, 40)),
        )
        self.sick: set[int] = {DEAD_UNIT, SLOW_UNIT}

    def run(self) -> list[Sent]:
        for slave in self.slaves:
            slave.start()
        self.master.start()
        self.line.run(self.seconds)
        return self.line.sent

    def _usual(self) -> Callable[[], float]:
        middle = self.random.choice((6, 10, 20, 40))
        return lambda: middle * self.random.uniform(0.8, 1.3)

    def _poll(self) -> bytes:
        random = self.random
        function, most = random.choice(((3, 20), (4, 12), (3, 60), (1, 40)))
        quantity = random.randint(2, most)
        return (
            bytes([function])
            + random.choice((0, 16, 100, 4096)).to_bytes(2, "big")
            + (quantity.to_bytes(2, "big"))
        )


Told = tuple[Heard, Settings]
"""What the listener heard, and with which settings."""


def late(plant: Plant, severity: str) -> Told:
    """One slave is sometimes, often or always slower than the master's time-out."""
    share = 1.0 if severity == SEVERE else SHARE[severity]
    slave = plant.slaves[1]
    usual = slave.latency_ms
    plant.sick.add(slave.unit)

    def latency() -> float:
        if plant.random.random() < share:
            return plant.timeout_ms * plant.random.uniform(1.1, 1.7)
        return usual()

    slave.latency_ms = latency
    return _all(plant, plant.run())


def two_masters(plant: Plant, severity: str) -> Told:
    """A second master, which does not know of the first, asks one of the slaves or two."""
    period = {MILD: 1870, MEDIUM: 730, SEVERE: 310}[severity]
    other = Master(
        line=plant.line,
        polls=[(unit, bytes.fromhex("03 0200 0006")) for unit in plant.units[:2]],
        name=-2,
        period_ms=period,
        timeout_ms=400,
        begin_ms=430,
    )
    other.start()
    return _all(plant, plant.run())


def same_unit(plant: Plant, severity: str) -> Told:
    """Two slaves have one address: the second answers behind the first, or at the same time."""
    first = plant.slaves[1]
    plant.sick.add(first.unit)
    gap = {MILD: 60.0, MEDIUM: 4.0, SEVERE: 0.1}[severity]
    usual = first.latency_ms
    second = Slave(
        line=plant.line,
        unit=first.unit,
        latency_ms=lambda: usual() + plant.random.uniform(0.7, 1.3) * gap,
    )
    plant.slaves.append(second)
    return _all(plant, plant.run())


def bias(plant: Plant, severity: str) -> Told:
    """The idle line floats: a receiver takes an edge before or behind a frame for a byte."""
    random = plant.random
    if severity == MILD:

        def sometimes() -> bytes:
            return b"\0" if random.random() < 0.15 else b""

        for slave in plant.slaves:
            slave.before = sometimes
    elif severity == MEDIUM:
        plant.slaves[0].behind = lambda: b"\0"
    else:
        for slave in plant.slaves:
            slave.before = lambda: b"\xff"
    return _all(plant, plant.run())


def echo(plant: Plant, severity: str) -> Told:
    """The listener's adapter hears each request again."""
    behind_ms = {MILD: 0.6, MEDIUM: 1.5, SEVERE: 2.5}[severity]
    for slave in plant.slaves:
        if slave.unit != SLOW_UNIT:
            slave.latency_ms = lambda: plant.random.uniform(25, 45)
    frames = plant.run()
    copies = [
        Sent(plant.line.end_ns(one) + round(behind_ms * MS), one.data, one.by)
        for one in frames
        if one.by < 0
    ]
    return _all(plant, frames + copies)


def one_side(plant: Plant, severity: str) -> Told:
    """The listener is on one pair of four wires: the master's, or the slaves'."""
    frames = plant.run()
    requests = severity != MEDIUM
    return _all(plant, [one for one in frames if (one.by < 0) == requests])


def settings(plant: Plant, severity: str) -> Told:
    """The line has other settings than the listener, for a part of the recording or always."""
    frames, mine = plant.run(), plant.settings
    if severity == MILD:
        other, begin, end = Settings(mine.baud // 2), 0.4, 0.6
    elif severity == MEDIUM:
        other, begin, end = Settings(mine.baud, "N"), 0.5, 1.0
    else:
        other, begin, end = Settings(mine.baud * 2), 0.0, 1.0
    begin_ns, end_ns = begin * plant.seconds * SECOND, end * plant.seconds * SECOND
    before: list[Sent] = []
    wrong: list[Sent] = []
    behind: list[Sent] = []
    free_ns = 0
    for one in frames:
        if begin_ns <= one.at_ns < end_ns:
            at_ns = max(one.at_ns, free_ns)
            wrong.append(Sent(at_ns, one.data, one.by))
            free_ns = at_ns + len(one.data) * other.character_ns + 3 * MS
        else:
            (before if one.at_ns < begin_ns else behind).append(one)
    changed = received(heard(wrong, other), other, mine)
    told = heard(before, mine) + changed
    last_ns = told[-1][0] + mine.character_ns
    return told + heard([one for one in behind if one.at_ns > last_ns], mine), mine


def lost_bytes(plant: Plant, severity: str) -> Told:
    """The listener's computer loses one to three bytes in a row of a frame."""
    share = {MILD: 0.04, MEDIUM: 0.12, SEVERE: 0.4}[severity]
    frames = plant.run()
    heard_frames = []
    for one in frames:
        data = one.data
        if plant.random.random() < share:
            lost = plant.random.randint(1, 3)
            place = plant.random.randrange(len(data) - lost)
            character = plant.settings.character_ns
            heard_frames.append(Sent(one.at_ns, data[:place], one.by))
            heard_frames.append(
                Sent(one.at_ns + (place + lost) * character, data[place + lost :], one.by)
            )
        else:
            heard_frames.append(one)
    return _all(plant, heard_frames)


def noise_of_one_unit(plant: Plant, severity: str) -> Told:
    """A long or bad cable to one slave: bits of what it sends flip, for all who hear it."""
    unit = plant.units[1]
    return _disturbed(plant, severity, lambda one: one.by == unit)


def noise_everywhere(plant: Plant, severity: str) -> Told:
    """A drive beside the cable: bits of all frames flip."""
    return _disturbed(plant, severity, lambda _: True)


def noise_of_requests(plant: Plant, severity: str) -> Told:
    """The master's driver is weak: bits of its requests flip."""
    return _disturbed(plant, severity, lambda one: one.by < 0)


def repeated(plant: Plant, severity: str) -> Told:
    """A repeater sends frames again: some responses, all responses, or all frames.

    The stations are slow enough for the copies, or they would collide with the next frame.
    """
    random, character = plant.random, plant.settings.character_ns
    longest_ms = 140 * character / MS
    plant.master.pause_ms = longest_ms + 15
    if severity == SEVERE:
        for slave in plant.slaves:
            if slave.unit != SLOW_UNIT:
                slave.latency_ms = lambda: 8 * character / MS + random.uniform(20, 35)
    copies = []
    for one in (frames := plant.run()):
        is_copied = random.random() < 0.3 if severity == MILD else True
        if is_copied and (severity == SEVERE or one.by > 0):
            gap_ns = round(random.uniform(4.5, 6) * MS)
            copies.append(Sent(plant.line.end_ns(one) + gap_ns, one.data, one.by))
    return _all(plant, frames + copies)


def foreign(plant: Plant, severity: str) -> Told:
    """A battery or a meter of another protocol is asked on the same wires while they are idle."""
    period = {MILD: 10.0, MEDIUM: 4.0, SEVERE: 2.0}[severity]
    is_ascii = plant.random.random() < 0.6
    plant.master.period_ms = 2500
    frames = plant.run()
    character = plant.settings.character_ns
    gaps = [
        (plant.line.end_ns(one), after.at_ns) for one, after in pairwise(frames) if after.by < 0
    ]
    others, next_ns = [], 3 * SECOND
    for begin, end in gaps:
        ask, answer = (_battery if is_ascii else _meter)(plant.random)
        at_ns = begin + 8 * MS
        reply_ns = at_ns + len(ask) * character + 20 * MS
        if at_ns >= next_ns and reply_ns + len(answer) * character + 5 * MS < end:
            others += [Sent(at_ns, ask, 0), Sent(reply_ns, answer, 0)]
            next_ns = at_ns + round(period * SECOND)
    assert len(others) > 10, "the line has no room for another protocol"
    return _all(plant, frames + others)


def _battery(random: Random) -> tuple[bytes, bytes]:
    values = "".join(f"{random.randrange(65536):04X}" for _ in range(random.randint(4, 12)))
    return b"~20014642E00201FD35\r", f"~20014600{len(values):04X}{values}E2C1\r".encode()


def _meter(random: Random) -> tuple[bytes, bytes]:
    address = bytes.fromhex("120034567800")
    ask = bytes.fromhex("fefefefe68") + address + bytes.fromhex("68110433333433")
    answer = bytes.fromhex("fefefefe68") + address + bytes.fromhex("68910833333433")
    answer += bytes((random.randrange(100) + 0x33) & 0xFF for _ in range(4))
    return tuple(one + bytes([sum(one[4:]) & 0xFF, 0x16]) for one in (ask, answer))  # type: ignore[return-value]


def _disturbed(plant: Plant, severity: str, applies: Callable[[Sent], bool]) -> Told:
    share = {MILD: 0.08, MEDIUM: 0.2, SEVERE: 0.5}[severity]

    def disturb(one: Sent) -> None:
        if applies(one) and plant.random.random() < share:
            data = bytearray(one.data)
            for _ in range(plant.random.choice((1, 1, 2, 4))):
                data[plant.random.randrange(len(data))] ^= 1 << plant.random.randrange(8)
            one.is_damaged = bytes(data) != one.data
            one.data = bytes(data)

    plant.line.disturb = disturb
    return _all(plant, plant.run())


def _all(plant: Plant, frames: list[Sent]) -> Told:
    return heard(frames, plant.settings), plant.settings


ILLNESSES: tuple[tuple[str, Callable[[Plant, str], Told]], ...] = (
    ("LINE-LATE", late),
    ("LINE-TWO-MASTERS", two_masters),
    ("LINE-SAME-UNIT", same_unit),
    ("LINE-BIAS", bias),
    ("LINE-ECHO", echo),
    ("LINE-ONE-SIDE", one_side),
    ("LINE-SETTINGS", settings),
    ("LINE-LOST-BYTES", lost_bytes),
    ("LINE-NOISE", noise_of_one_unit),
    ("LINE-NOISE", noise_everywhere),
    ("LINE-NOISE", noise_of_requests),
    ("LINE-REPEATED", repeated),
    ("LINE-FOREIGN", foreign),
)


def cases(first_seed: int, seconds: int = SECONDS) -> Iterator[Case]:
    """Recordings of `seconds` s."""
    seed = first_seed
    for code, make in ILLNESSES:
        for severity in SEVERITIES:
            for beside in BESIDES:
                for timing in TIMINGS:
                    if code == "LINE-ONE-SIDE" and beside != ALONE:
                        continue  # With one direction alone, nothing tells the ordinary trouble.
                    seed += 1
                    yield Case(
                        illness=code,
                        severity=severity,
                        beside=beside,
                        timing=timing,
                        write=partial(_write, seed, make, severity, beside, timing, seconds),
                    )
    for timing in TIMINGS:
        for number in (1, 2):
            seed += 1
            yield Case(
                illness="",
                severity=f"plant {number}",
                beside=ALONE,
                timing=timing,
                write=partial(_write, seed, _healthy, "", ALONE, timing, seconds),
            )


def _healthy(plant: Plant, _severity: str) -> Told:
    return _all(plant, plant.run())


def _write(
    seed: int,
    make: Callable[[Plant, str], Told],
    severity: str,
    beside: str,
    timing: str,
    seconds: int,
    path: Path,
) -> Recording:
    plant = Plant(seed, beside, seconds=seconds)
    told, settings_ = make(plant, severity)
    arguments = write_line(path, told, settings_, timing)
    units = {slave.unit for slave in plant.slaves}
    return Recording(
        arguments=arguments,
        innocent=frozenset(units - plant.sick),
        also=frozenset([WITH[beside]]) if WITH[beside] else frozenset(),
    )
