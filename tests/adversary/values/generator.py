"""Devices whose registers hold values of every type, polled for five minutes, with the truth.

The devices are made from what devices do, and from nothing that mbtool knows of types.
"""

# A device has one word order, as devices have. Its registers lie in blocks; a master reads each
# block at once, or some values alone. What a register holds can only partly be known from outside:
# a 32-bit counter whose high word never moves looks exactly like two registers. `Value.is_known`
# says for each value if its words tell its type.

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from random import Random

SECOND_NS = 1_000_000_000
START_NS = 1_790_000_000 * SECOND_NS
POLLED_S = 300
REGISTERS = 40
ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")
_FORMATS = {
    "uint16": ">H", "int16": ">h", "uint32": ">I", "int32": ">i", "uint64": ">Q", "int64": ">q",
    "float32": ">f", "float64": ">d",
}  # fmt: skip
_LIMITS = {
    "uint16": (0, 2**16 - 1), "int16": (-(2**15), 2**15 - 1),
    "uint32": (0, 2**32 - 1), "int32": (-(2**31), 2**31 - 1),
    "uint64": (0, 2**64 - 1), "int64": (-(2**63), 2**63 - 1),
}  # fmt: skip


@dataclass(slots=True)
class Value:
    """A value of a device: where it is, and what it held at each poll."""

    what: str
    """What it is to a person: temperature, counter, state, text."""
    address: int
    type: str
    order: str
    words: int
    numbers: list[float | str] = field(default_factory=list)
    """The number (or text) in the registers at each poll, before any scale."""
    rows: list[tuple[int, ...]] = field(default_factory=list)
    """The registers at each poll, as they are on the wire."""
    is_alone: bool = False
    """True if the master asks for just these registers."""

    @property
    def is_known(self) -> bool:
        """True if the words tell the type to somebody who sees nothing else."""
        changing = len(set(self.rows))
        if self.what == "text":
            return len(str(self.numbers[0])) >= 8
        if self.type == "bcd16":
            return changing >= 12
        if self.type == "bcd32":
            return changing >= 12 and len({row[0] for row in self.rows}) > 1 < len(
                {row[1] for row in self.rows}
            )
        if self.words == 1:
            return changing >= 3
        if self.what == "clock":
            return True
        if self.type in ("float32", "float64"):
            moving = {number for number in self.numbers if number}
            return len(moving) >= 4
        if changing < 4:
            return False
        if self.is_alone:
            return True
        in_order = [self._from_the_top(row) for row in self.rows]
        tops = {row[0] for row in in_order}
        # The topmost word moves with the others, or it is the sign of a number that moves.
        return len(tops) > 1 or (tops == {0xFFFF} and len({row[-1] for row in in_order}) >= 4)

    def _from_the_top(self, row: tuple[int, ...]) -> tuple[int, ...]:
        return row[::-1] if self.order in ("CDAB", "DCBA") else row


@dataclass(slots=True)
class Device:
    """A device: its values, and what a master reads of it, as (time in ns, address, words)."""

    order: str
    values: list[Value]
    reads: list[tuple[int, int, tuple[int, ...]]]


def on_the_wire(data: bytes, order: str) -> tuple[int, ...]:
    """Words of a big-endian value in one of the four orders."""
    words = [data[at : at + 2] for at in range(0, len(data), 2)]
    if order in ("CDAB", "DCBA"):
        words.reverse()
    if order in ("BADC", "DCBA") and len(words) > 1:
        words = [word[::-1] for word in words]
    return tuple(int.from_bytes(word, "big") for word in words)


def generated(rng: Random) -> Device:
    """A device with REGISTERS registers or a few more, polled for POLLED_S seconds."""
    order = rng.choice(ORDERS)
    period_s = rng.choice((1.0, 2.0, 2.5, 5.0))
    times = [at * period_s for at in range(int(POLLED_S / period_s))]
    values: list[Value] = []
    blocks: list[range] = []
    address = rng.choice((0, 1, 100, 0x1000, 3000))
    left = REGISTERS
    while left > 0:
        first = address
        block_words = rng.randint(8, 24)
        favourite = rng.choice(_MAKERS)
        while address - first < block_words and left > 0:
            make = favourite if rng.random() < 0.6 else rng.choice(_MAKERS)
            for value in make(rng, order):
                value.address = address
                address += value.words
                left -= value.words
                values.append(value)
        blocks.append(range(first, address))
        address += rng.choice((1, 10, 100))
    for value in values:
        _fill(value, rng, times)
    return Device(order, values, list(_reads(values, blocks, times, rng)))


def _reads(
    values: list[Value], blocks: list[range], times: list[float], rng: Random
) -> Iterator[tuple[int, int, tuple[int, ...]]]:
    by_block = [[one for one in values if one.address in block] for block in blocks]
    alone = [own for own in by_block if rng.random() < 0.2 and all(one.words <= 4 for one in own)]
    for own in alone:
        for one in own:
            one.is_alone = one.words > 1
    for at, time_s in enumerate(times):
        at_ns = START_NS + int(time_s * SECOND_NS)
        for own in by_block:
            for part in [[one] for one in own] if own in alone else [own]:
                at_ns += rng.randint(20, 60) * 1_000_000
                words = tuple(word for one in part for word in one.rows[at])
                yield at_ns, part[0].address, words


# What values do. A signal gives the value at a time in seconds.


def _temperature(rng: Random) -> Callable[[float], float]:
    mean, swing = rng.uniform(-15, 90), rng.uniform(0.2, 6)
    noise, period = rng.choice((0, 0.05, 0.3)), rng.uniform(200, 2000)
    return lambda t: mean + swing * math.sin(t / period * 6.283) + rng.gauss(0, noise)


def _power(rng: Random) -> Callable[[float], float]:
    mean, noise = rng.choice((0, 300, -1500, 4000)), rng.choice((20, 150, 900))
    return lambda t: mean + noise * math.sin(t / 60) + rng.gauss(0, noise)


def _voltage(rng: Random) -> Callable[[float], float]:
    mean, noise = rng.choice((230.0, 400.0, 24.0, 49.98)), rng.choice((0.02, 0.3))
    return lambda t: mean + rng.gauss(0, noise)


def _level(rng: Random) -> Callable[[float], float]:
    begin, slope = rng.uniform(5, 90), rng.uniform(-0.05, 0.05)
    return lambda t: begin + slope * t


def _constant(rng: Random) -> Callable[[float], float]:
    value = rng.choice((0.0, 1.0, 50.0, 21.5, 1500.0, rng.uniform(0, 1000)))
    return lambda t: value


_SIGNALS = (_temperature, _power, _voltage, _level, _constant)


_TYPES = {
    "narrow": ("int16", "int16", "uint16"),
    "wide": ("int32", "int32", "uint32", "int64", "uint64"),
    "float": ("float32", "float32", "float64"),
}


def _measurements(kind: str) -> Callable[[Random, str], list[Value]]:
    def make(rng: Random, order: str) -> list[Value]:
        made = []
        for _ in range(rng.randint(1, 4)):
            type_ = rng.choice(_TYPES[kind])
            made.append(
                Value("measurement", 0, type_, order, struct.calcsize(_FORMATS[type_]) // 2)
            )
        return made

    return make


def _counters(rng: Random, order: str) -> list[Value]:
    type_ = rng.choice(("uint32", "uint32", "uint16", "uint64", "float32", "bcd16", "bcd32"))
    words = 1 if type_ in ("uint16", "bcd16") else 4 if type_ == "uint64" else 2
    return [Value("counter", 0, type_, order, words) for _ in range(rng.randint(1, 3))]


def _states(rng: Random, order: str) -> list[Value]:
    what = rng.choice(("state", "flags"))
    return [Value(what, 0, "uint16", order, 1) for _ in range(rng.randint(1, 3))]


def _texts(rng: Random, order: str) -> list[Value]:
    return [Value("text", 0, "string", "ABCD", rng.randint(4, 10))]


def _clocks(rng: Random, order: str) -> list[Value]:
    if rng.random() < 0.5:
        return [Value("clock", 0, "uint32", order, 2)]
    return [Value(f"clock {part}", 0, "uint16", order, 1) for part in range(6)]


_MAKERS = (
    _measurements("narrow"), _measurements("narrow"), _measurements("wide"),
    _measurements("float"), _measurements("float"), _counters, _states, _texts, _clocks,
)  # fmt: skip


def _fill(value: Value, rng: Random, times: list[float]) -> None:
    """Let a value live through all polls."""
    if value.what == "text":
        name = "".join(rng.choice("ABCDEFGHKLMNPRSTUVW0123456789-") for _ in range(value.words * 2))
        text = name[: rng.randint(value.words * 2 - 3, value.words * 2)]
        data = text.encode().ljust(value.words * 2, b"\0")
        row = on_the_wire(data, "ABCD")
        value.numbers, value.rows = [text] * len(times), [row] * len(times)
        return
    numbers = list(_numbers(value, rng, times))
    value.numbers = list(numbers)
    value.rows = [on_the_wire(_encoded(value.type, one), value.order) for one in numbers]
    if value.type == "float32":
        value.numbers = [struct.unpack(">f", struct.pack(">f", one))[0] for one in numbers]


def _encoded(type_: str, number: float) -> bytes:
    if type_ in ("bcd16", "bcd32"):
        return bytes.fromhex(f"{int(number):0{4 if type_ == 'bcd16' else 8}d}")
    return struct.pack(_FORMATS[type_], number if type_.startswith("float") else int(number))


def _numbers(value: Value, rng: Random, times: list[float]) -> Iterator[float]:
    if value.what == "counter":
        yield from _counted(value, rng, times)
    elif value.what == "state":
        yield from _of_states(rng, times)
    elif value.what == "flags":
        yield from _of_flags(rng, times)
    elif value.what == "clock":
        yield from (START_NS // SECOND_NS + int(time_s) for time_s in times)
    elif value.what.startswith("clock "):
        yield from _clock_part(int(value.what[-1]), times)
    else:
        yield from _measured(value, rng, times)


def _measured(value: Value, rng: Random, times: list[float]) -> Iterator[float]:
    signal = rng.choice(_SIGNALS)(rng)
    is_float = value.type.startswith("float")
    scale = {1: rng.choice((1.0, 10.0, 100.0)), 2: rng.choice((1e2, 1e3, 1e4, 1e5))}.get(
        value.words, rng.choice((1e3, 1e6, 1e8))
    )
    decimals = rng.choice((1, 2, 3, None)) if is_float else None
    for time_s in times:
        number = signal(time_s)
        if is_float:
            yield number if decimals is None else round(number, decimals)
        else:
            low, high = _LIMITS[value.type]
            yield min(max(round(number * scale), low), high)


def _counted(value: Value, rng: Random, times: list[float]) -> Iterator[float]:
    most = {"uint16": 60_000, "bcd16": 9_000, "bcd32": 9_000_000, "float32": 1e6}.get(
        value.type, 10 ** rng.uniform(3, 8)
    )
    number = rng.uniform(0, most)
    step = rng.choice((0.2, 3, 40, 700, 5000))
    if value.type in ("uint16", "bcd16"):
        step = min(step, 3)
    limit = {"uint16": 2**16, "bcd16": 10**4, "bcd32": 10**8}.get(value.type, 2**32)
    for _ in times:
        number += rng.uniform(0.5, 1.5) * step
        yield round(number, 1) if value.type == "float32" else int(number) % limit


def _of_states(rng: Random, times: list[float]) -> Iterator[float]:
    states = rng.sample(range(12), rng.randint(2, 5))
    state = states[0]
    for _ in times:
        if rng.random() < 0.08:
            state = rng.choice(states)
        yield state


def _of_flags(rng: Random, times: list[float]) -> Iterator[float]:
    bits = rng.sample(range(16), rng.randint(3, 8))
    word = sum(1 << bit for bit in bits if rng.random() < 0.5)
    for _ in times:
        if rng.random() < 0.15:
            word ^= 1 << rng.choice(bits)
        yield word


def _clock_part(part: int, times: list[float]) -> Iterator[float]:
    for time_s in times:
        now = datetime.fromtimestamp(START_NS // SECOND_NS + int(time_s), UTC)
        yield (now.year, now.month, now.day, now.hour, now.minute, now.second)[part]
