"""A master of a raw socket."""

from __future__ import annotations

import socket
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import mbtool

PATIENCE_S = 30.0
READ_TWO = "03 0000 0002"  # read holding registers, address 0, quantity 2


@contextmanager
def master_of(slave: mbtool.ObservedShell, unit: int = 1) -> Iterator[Callable[[str], bytes]]:
    """A function that sends a PDU in Modbus/TCP, in hexadecimal, and returns the response's PDU."""
    with socket.create_connection((slave.host, slave.port), PATIENCE_S) as master:
        yield lambda pdu: ask(master, unit, bytes.fromhex(pdu))


def ask(master: socket.socket, unit: int, pdu: bytes) -> bytes:
    send(master, unit, pdu)
    header = _exactly(master, 7)
    return _exactly(master, int.from_bytes(header[4:6]) - 1)


def send(master: socket.socket, unit: int, pdu: bytes) -> None:
    master.sendall(bytes.fromhex("0001 0000") + (len(pdu) + 1).to_bytes(2) + bytes([unit]) + pdu)


def _exactly(master: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = master.recv(count - len(data))
        assert more, "the slave has closed the connection"
        data += more
    return data
