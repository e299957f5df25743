"""The plant's RTU line: a master, units, ears; the driver carries each byte itself.

Every end is a pseudo-terminal: one leads to `mbtool slave`, which plays units 1 to 5, and one to
each sniffer. Unit 6 (slow), 7 (dead) and 8 (answers every other time) are played here.
"""

# 115200 baud, 8N1: a character takes 87 us. Pieces of 8 characters are sent at their time, as a
# UART with a FIFO hands them over. Bytes for an ear whose program does not read are dropped once
# the terminal is full, as by a port's driver.

from __future__ import annotations

import contextlib
import os
import select
import time
import tty
from threading import Event, Thread
from typing import TYPE_CHECKING

from tests.soak.asked import (
    NOISES,
    Asked,
    Numbers,
    Touch,
    crc16,
    request_pdu,
    response_length,
    rtu_adu,
    slow_response,
)

if TYPE_CHECKING:
    import random
    from collections.abc import Iterable
    from pathlib import Path

CHARACTER_S = 10 / 115200
PIECE = 8
TIMEOUT_S = 0.5
SLOW, DEAD, MOODY = 6, 7, 8
PAUSE_S = 0.02


class End:
    """A pseudo-terminal under a fixed path; it can be unplugged and plugged in again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._near = -1
        self._far = -1
        self.plug()

    def plug(self) -> None:
        near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(near, False)
        self.path.parent.mkdir(exist_ok=True)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._far))
        self._near = near

    def unplug(self) -> None:
        """Take the terminal away: a program that reads it gets an error."""
        near, self._near = self._near, -1
        self.path.unlink(missing_ok=True)
        os.close(self._far)
        os.close(near)

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._near, data)

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._near], [], [], timeout_s)
        return os.read(self._near, 4096) if ready else b""


class Line(Thread):
    """The master of the line, and the units that no program plays. `stop` ends it."""

    def __init__(self, name: str, folder: Path, ears: Iterable[str], chance: random.Random) -> None:
        super().__init__(daemon=True)
        self.asked: list[Asked] = []
        self.slave = End(folder / "slave")
        self.ears = {who: End(folder / who / name) for who in ears}
        self.noise = 0
        """How many of the next transactions are disturbed."""
        self._name = name
        self._chance = chance
        self._numbers = Numbers()
        self._stopped = Event()

    def stop(self) -> None:
        self._stopped.set()
        self.join()

    def run(self) -> None:
        while not self._stopped.wait(PAUSE_S * (0.5 + self._chance.random())):
            self._ask()

    def _ask(self) -> None:
        number = self._numbers.next()
        unit = number % 8 + 1
        touch = Touch.NONE
        if self.noise:
            self.noise -= 1
            touch = self._chance.choice(NOISES)
        pdu = request_pdu(number // 8)
        request = rtu_adu(unit, pdu)
        on_wire = request
        if touch is Touch.NOISE_BEFORE:
            on_wire = self._chance.randbytes(self._chance.randrange(1, 40)) + request
        elif touch is Touch.DAMAGED_REQUEST:
            on_wire = self._damaged(request)
        asked = Asked(self._name, request, time.time_ns(), touch=touch)
        self.asked.append(asked)
        self._send(on_wire, to_slave=True)
        response = self._response(unit, pdu, touch)
        if response:
            asked.response, asked.answered_ns = response, time.time_ns()

    def _response(self, unit: int, pdu: bytes, touch: Touch) -> bytes:
        is_heard = touch in (Touch.NONE, Touch.DAMAGED_RESPONSE)
        if unit < SLOW:
            return self._from_slave(unit, pdu, touch)
        if unit == DEAD or not is_heard or (unit == MOODY and self._chance.random() < 0.5):
            self._stopped.wait(0.1)
            return b""
        if unit == SLOW:
            self._stopped.wait(self._chance.uniform(0.05, 0.3))
        response = rtu_adu(unit, slow_response(pdu))
        is_damaged = touch is Touch.DAMAGED_RESPONSE
        self._send(self._damaged(response) if is_damaged else response, to_slave=True)
        return b"" if is_damaged else response

    def _from_slave(self, unit: int, pdu: bytes, touch: Touch) -> bytes:
        """Carry what the slave's program answers to the ears, until it is whole or time is up."""
        wanted = response_length(pdu) + 3
        response = b""
        end_s = time.monotonic() + TIMEOUT_S
        while len(response) < wanted and (left_s := end_s - time.monotonic()) > 0:
            data = self.slave.read(left_s)
            if data and touch is Touch.DAMAGED_RESPONSE:
                self._to_ears(self._damaged(data))
            elif data:
                self._send(data, to_slave=False)
            response += data
        is_whole = response[:1] == bytes([unit]) and crc16(response) == 0
        is_good = is_whole and touch is not Touch.DAMAGED_RESPONSE
        return response if response and is_good else b""

    def _damaged(self, data: bytes) -> bytes:
        changed = bytearray(data)
        for _ in range(self._chance.randrange(1, 4)):
            changed[self._chance.randrange(len(changed))] ^= 1 << self._chance.randrange(8)
        return bytes(changed)

    def _send(self, data: bytes, *, to_slave: bool) -> None:
        due_s = time.monotonic()
        for at in range(0, len(data), PIECE):
            piece = data[at : at + PIECE]
            due_s += len(piece) * CHARACTER_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            if to_slave:
                self.slave.send(piece)
            self._to_ears(piece)

    def _to_ears(self, piece: bytes) -> None:
        for ear in self.ears.values():
            ear.send(piece)
