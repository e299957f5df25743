"""The serial shell on a made port, in a process that other processes keep from running."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat, SerialLink
from mbtool.modbus import Response, rtu_adu
from mbtool.slave.shells import SerialSlave, serial_shell
from tests.slave.scripted import Scripted

if TYPE_CHECKING:
    from collections.abc import Callable

LINE = SerialFormat(115200, 8, "N", 1)
REQUESTS = 60
BETWEEN_NS = 20_000_000
CALL_NS = 10_000
AWAY_NS = [20_000_000, 200_000_000, 500_000_000]
"""For so long the process does not run, at moments drawn by chance."""
PDUS = [
    bytes.fromhex(text)
    for text in ("03 0000 0002", "06 0010 0007", "05 0003 FF00", "10 0001 0002 04 000A 0102")
]


class MadePort:
    """A port on which a master asks, and the clock of the process that reads it."""

    def __init__(self, seed: int, stop: Callable[[], None]) -> None:
        self._random, self._stop = random.Random(seed), stop
        self._now_ns = 1_000_000_000
        self._arriving: list[tuple[int, int]] = []
        """The bytes that are not read yet, each after the time in ns at which it arrives."""
        self._left = [PDUS[number % len(PDUS)] for number in range(REQUESTS)]
        self.answered = 0
        self._ask()

    def clock(self) -> int:
        self._pass()
        return self._now_ns

    @property
    def in_waiting(self) -> int:
        self._pass()
        return sum(at_ns <= self._now_ns for at_ns, _ in self._arriving)

    def read(self, size: int) -> bytes:
        self._pass()
        until_ns = self._now_ns + LINE.t3_5_ns
        if self._arriving and self._arriving[0][0] <= until_ns:
            self._now_ns = max(self._now_ns, self._arriving[0][0])
        else:
            self._now_ns = until_ns
        data = bytes(byte for at_ns, byte in self._arriving[:size] if at_ns <= self._now_ns)
        del self._arriving[: len(data)]
        self._pass()
        if self._now_ns > self._give_up_ns:
            self._stop()
        return data

    def write(self, _: bytes) -> None:
        self._pass()
        self.answered += 1
        self._ask()

    def close(self) -> None:
        pass

    def _ask(self) -> None:
        if not self._left:
            self._stop()
            return
        begin_ns = self._now_ns + BETWEEN_NS
        adu = rtu_adu(1, self._left.pop(0))
        self._arriving += [
            (begin_ns + (number + 1) * LINE.character_ns, byte) for number, byte in enumerate(adu)
        ]
        self._give_up_ns = begin_ns + 20 * max(AWAY_NS)

    def _pass(self) -> None:
        self._now_ns += CALL_NS
        if self._random.random() < 0.02:
            self._now_ns += self._random.choice(AWAY_NS)


@pytest.mark.parametrize("seed", range(4))
def test_answers_every_request_though_its_process_does_not_run_for_half_a_second(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    port = MadePort(seed, lambda: slave._stopping.set())
    monkeypatch.setattr(serial_shell, "steady_clock", lambda: port.clock)
    monkeypatch.setattr(serial_shell, "open_port", lambda *_: port)
    slave = SerialSlave(SerialLink("/dev/made", LINE), Scripted(lambda _, pdu: Response(pdu[:5])))
    slave._open()
    slave._run()
    assert port.answered == REQUESTS
