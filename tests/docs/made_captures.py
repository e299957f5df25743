"""Captures that pages show and that no folder holds: made from bytes, the same in each run.

`<!-- console: made site.csv = trouble -->` in a page calls the function of that name. Each gives
the times of the bytes of a serial line as CSV, as a logic analyser exports them.
"""

from __future__ import annotations

import struct
from random import Random

from mbtool.modbus.adu import crc

BAUD = 9600
CHARACTER_S = 11 / BAUD
"""8E1: a start bit, eight data bits, parity and a stop bit."""
BEGIN_S = 1_773_738_843
"""2026-03-17 09:14:03 UTC."""


class _Line:
    """The bytes of a line so far, and the time at which it is free."""

    def __init__(self) -> None:
        self.rows = ["t_start_s,t_end_s,byte_hex"]
        self.now_s = float(BEGIN_S)

    def frame(self, pdu: str, *, unit: int, is_damaged: bool = False) -> _Line:
        body = bytes([unit]) + bytes.fromhex(pdu)
        frame = bytearray(body + crc(body).to_bytes(2, "little"))
        frame[-1] ^= is_damaged
        for byte in frame:
            end_s = self.now_s + CHARACTER_S
            self.rows.append(f"{self.now_s:.6f},{end_s:.6f},{byte:02X}")
            self.now_s = end_s
        return self

    def wait(self, ms: float) -> _Line:
        self.now_s += ms / 1000
        return self

    def ask(self, pdu: str, *, unit: int) -> _Line:
        return self.wait(5).frame(pdu, unit=unit)

    def text(self) -> str:
        return "\n".join(self.rows) + "\n"


def _registers(*values: int) -> str:
    return f"03 {2 * len(values):02x}" + "".join(f"{one:04x}" for one in values)


def trouble() -> str:
    """A master, two slaves, of which one is slow, and a unit that is not there: 30 cycles."""
    line, chance = _Line(), Random("trouble")
    for cycle in range(30):
        level = 1000 + round(999 * (1 - abs(cycle % 20 - 10) / 10)) + chance.randrange(40)
        line.ask("03 0000 000a", unit=1).wait(15 + 8 * chance.random())
        line.frame(_registers(level, *[0] * 9), unit=1)
        line.ask("03 0014 000a", unit=2).wait(52 + 20 * chance.random())
        line.frame(_registers(0, 0, cycle // 6 * 10, *[0] * 7), unit=2)
        for _ in range(2):
            line.ask("03 001e 000a", unit=5).wait(290)
        line.wait(100)
    line.ask("03 0000 000a", unit=1).wait(20).frame(_registers(*[1990, *[0] * 9]), unit=1)
    return line.text()


def good_day() -> str:
    return _day(is_good=True)


def bad_day() -> str:
    return _day(is_good=False)


def _day(*, is_good: bool) -> str:
    """A panel of unit 5; on the bad day it is slower, and is written to."""
    line, chance = _Line(), Random("day")
    for cycle in range(40):
        late_ms = 8 if is_good else 12
        line.ask("03 0000 0004", unit=5).wait(late_ms + 3 * chance.random())
        line.frame(_registers(100, 200, 300, 400), unit=5)
        line.ask("04 0000 0002", unit=5).wait(20 + 2 * chance.random())
        line.frame("84 02" if cycle == 25 and not is_good else "04 04 09 06 01 f2", unit=5)
        line.ask("03 0009 0001", unit=5).wait(20 + 2 * chance.random())
        line.frame(_registers(7 if is_good else 8), unit=5)
        if not is_good and cycle % 15 == 5:
            line.ask("06 0013 0001", unit=5).wait(20).frame("06 0013 0001", unit=5)
        line.wait(400)
    return line.text()


def heat_meter() -> str:
    """A meter of unit 3: temperatures, power as a float, energy in 32 bits, a set point, texts."""
    line, chance = _Line(), Random("heat meter")
    setpoint = 450
    for cycle in range(90):
        flow, back = 614 + cycle // 3 + chance.randrange(3), 395 + chance.randrange(4)
        power = struct.unpack(">HH", struct.pack(">f", 8.2 + 0.4 * chance.random()))
        energy = 1_178_900 + 17 * cycle
        line.ask("03 0000 000c", unit=3).wait(22 + 4 * chance.random())
        line.frame(
            _registers(
                flow, back, flow - back, 1 + (cycle > 40), *power[::-1],
                energy & 0xFFFF, energy >> 16, setpoint, 0, 0, 21,
            ),
            unit=3,
        )  # fmt: skip
        if cycle == 52:
            setpoint = 480
            line.ask("06 0008 01e0", unit=3).wait(20).frame("06 0008 01e0", unit=3)
        line.wait(900)
    return line.text()


CAPTURES = {
    "trouble": trouble,
    "good-day": good_day,
    "bad-day": bad_day,
    "heat-meter": heat_meter,
}
"""By the name that a page gives."""
