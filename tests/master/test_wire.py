"""What a slave sends that nobody asked for, as the test of a slave hears it."""

from __future__ import annotations

import socket
from threading import Thread

from mbtool.core import Endpoint, TcpLink
from mbtool.master.links import READ_BYTES
from mbtool.master.wire import MAX_HEARD, open_wire
from mbtool.modbus import mbap_adu

SECOND_NS = 1_000_000_000
HOLD_NS = 3600 * SECOND_NS


def _flood(server: socket.socket) -> None:
    connection, _ = server.accept()
    with connection:
        try:
            while True:
                connection.sendall(b"\xff" * 1000)
        except OSError:
            return  # The wire has closed it.


def test_a_slave_that_sends_without_end_is_heard_up_to_a_limit() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        flood = Thread(target=_flood, args=(server,))
        flood.start()
        host, port = server.getsockname()
        with open_wire(TcpLink(Endpoint(host, port)), HOLD_NS, None) as wire:
            heard = wire.send([mbap_adu(1, 1, b"\3\0\0\0\1")])
            assert MAX_HEARD < len(heard.raw) <= MAX_HEARD + READ_BYTES
            assert not heard.adus
            again = wire.send([mbap_adu(2, 1, b"\3\0\0\0\1")])
            assert len(again.raw) <= MAX_HEARD + READ_BYTES
        flood.join()
