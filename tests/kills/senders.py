"""What the killed recordings record: a master and a slave in this process, with a list of times."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from threading import Event, Thread
from typing import TYPE_CHECKING

from tests.soak.asked import crc16, rtu_adu, tcp_adu
from tests.soak.line import End
from tests.soak.plant import free_port

if TYPE_CHECKING:
    from pathlib import Path

BEAT_S = 0.01
"""Faster rates send several requests at once, so often."""
TIMEOUT_S = 20.0
_REQUEST_BYTES, _RESPONSE_BYTES = 17, 12


class Sender(Thread):
    """Sends numbered writes at a rate; `stop` returns the number and time (ns) of each answer."""

    link: str
    """What `sniff` records."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._stopped = Event()
        self._answered: list[tuple[int, int]] = []
        self._rate = 1.0

    def begin(self, rate: float) -> None:
        """Send so many a second from now on, the first one at once."""
        self._rate = rate
        self.start()

    def stop(self) -> list[tuple[int, int]]:
        self._stopped.set()
        if self.ident is not None:
            self.join()
        return self._answered

    def run(self) -> None:
        each_s = max(1 / self._rate, BEAT_S)
        count = max(1, round(self._rate * each_s))
        due_s = time.monotonic()
        with contextlib.suppress(OSError):
            while not self._stopped.wait(max(0.0, due_s - time.monotonic())):
                first = len(self._answered)
                self._exchange(range(first, first + count))
                now_ns = time.time_ns()
                self._answered += [(number, now_ns) for number in range(first, first + count)]
                due_s = max(due_s + each_s, time.monotonic() - each_s)

    def _exchange(self, numbers: range) -> None:
        """Ask with these numbers; return when all answers are here. Raises OSError."""
        raise NotImplementedError


class TapSender(Sender):
    """A master and a slave on either side of a tap."""

    def __init__(self) -> None:
        super().__init__()
        self._slave = socket.create_server(("127.0.0.1", 0))
        self._port = free_port()
        self.link = f"tap:127.0.0.1:{self._port}=127.0.0.1:{self._slave.getsockname()[1]}"
        self._master: socket.socket | None = None
        Thread(target=self._answer, daemon=True).start()

    def stop(self) -> list[tuple[int, int]]:
        answered = super().stop()
        for one in (self._slave, self._master):
            if one is not None:
                one.close()
        return answered

    def _exchange(self, numbers: range) -> None:
        if self._master is None:
            self._master = socket.create_connection(("127.0.0.1", self._port), TIMEOUT_S)
        self._master.sendall(b"".join(tcp_adu(number, _write(number)) for number in numbers))
        left = _RESPONSE_BYTES * len(numbers)
        while left:
            data = self._master.recv(left)
            if not data:
                raise ConnectionError
            left -= len(data)

    def _answer(self) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._slave.accept()
            with connection:
                data = b""
                while more := connection.recv(2**16):
                    data += more
                    whole = len(data) // _REQUEST_BYTES * _REQUEST_BYTES
                    asked = [data[at : at + _REQUEST_BYTES] for at in range(0, whole, 17)]
                    data = data[whole:]
                    connection.sendall(b"".join(map(_response, asked)))


class LineSender(Sender):
    """A master and a slave on a line at 115200 baud, heard through a pseudo-terminal."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._ear = End(folder / "line")
        self.link = f"rtu:{self._ear.path}@115200-8N1"

    def stop(self) -> list[tuple[int, int]]:
        answered = super().stop()
        self._ear.unplug()
        return answered

    def _exchange(self, numbers: range) -> None:
        for number in numbers:
            pdu = _write(number)
            self._ear.send(rtu_adu(1, pdu))
            time.sleep(0.002)
            self._ear.send(rtu_adu(1, pdu[:5]))


def number_of(request: bytes) -> int:
    """The number in the bytes of a request, RTU or TCP."""
    end = len(request) - (2 if crc16(request) == 0 else 0)
    return int(struct.unpack(">I", request[end - 4 : end])[0])


def _write(number: int) -> bytes:
    """Write the number to two registers."""
    return struct.pack(">BHHBI", 0x10, number % 60_000, 2, 4, number)


def _response(request: bytes) -> bytes:
    return request[:4] + b"\0\6" + request[6:12]
