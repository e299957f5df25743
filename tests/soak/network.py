"""The plant's masters on the network: connections that ask, and floods."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import time
from threading import Event, Thread

from tests.soak.asked import Asked, Numbers, Touch, request_pdu, tcp_adu

TIMEOUT_S = 10.0
PACE_S = (0.3, 1.5)


class TcpMaster(Thread):
    """A master that asks again and again, on one connection, or a new one if that breaks."""

    def __init__(self, link: str, port: int, numbers: Numbers, seed: int) -> None:
        super().__init__(daemon=True)
        self.asked: list[Asked] = []
        self._link = link
        self._port = port
        self._numbers = numbers
        self._chance = random.Random(seed)
        self._stopped = Event()

    def stop(self) -> None:
        self._stopped.set()
        self.join()

    def run(self) -> None:
        while not self._stopped.wait(self._chance.uniform(0.1, 0.5)):
            with contextlib.suppress(OSError), connected(self._port) as connection:
                while not self._stopped.wait(self._chance.uniform(*PACE_S)):
                    self._ask(connection)

    def _ask(self, connection: socket.socket) -> None:
        number = self._numbers.next()
        request = tcp_adu(number, request_pdu(number))
        asked = Asked(self._link, request, time.time_ns(), is_broken=True)
        self.asked.append(asked)
        connection.sendall(request)
        asked.response = response_of(connection)
        asked.answered_ns = time.time_ns()
        asked.is_broken = False


def connected(port: int) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), TIMEOUT_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def response_of(connection: socket.socket) -> bytes:
    """The next ADU. Raises OSError if the connection ends, or nothing comes."""
    head = _exactly(connection, 6)
    (length,) = struct.unpack(">H", head[4:])
    return head + _exactly(connection, length)


def _exactly(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = connection.recv(count - len(data))
        if not more:
            raise ConnectionError("the connection has ended")
        data += more
    return data


def flood(link: str, port: int, numbers: Numbers, count: int) -> list[Asked]:
    """Send so many requests at once on one connection, and read the responses."""
    asked = []
    for _ in range(count):
        number = numbers.next()
        request = tcp_adu(number, request_pdu(number))
        asked.append(Asked(link, request, time.time_ns(), touch=Touch.FLOOD, is_broken=True))
    with contextlib.suppress(OSError), connected(port) as connection:
        data = b"".join(one.request for one in asked)
        sender = Thread(target=_send_all, args=(connection, data), daemon=True)
        sender.start()
        for one in asked:
            one.response = response_of(connection)
            one.answered_ns, one.is_broken = time.time_ns(), False
        sender.join()
    return asked


def _send_all(connection: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        connection.sendall(data)


def flood_of_connections(port: int, count: int) -> None:
    """Open so many connections, say nothing, and close them."""
    opened = []
    for _ in range(count):
        with contextlib.suppress(OSError):
            opened.append(connected(port))
    for one in opened:
        one.close()
