"""A serial server sends all that it hears on a line to whoever connects; a tap stands between."""

from __future__ import annotations

import socket
import threading
from typing import TYPE_CHECKING

import pytest

from mbtool.modbus.adu import rtu_adu
from tests.end_to_end.programs import decoded, sniffing, tcp_port

if TYPE_CHECKING:
    from pathlib import Path

ASKED = 12
PAUSE_S = 0.05
READ = rtu_adu(17, bytes.fromhex("03 006B 0003"))
ANSWER = rtu_adu(17, bytes.fromhex("03 06 022B 0000 0064"))


def serve(listener: socket.socket) -> None:
    """Send requests and responses of a line, each in a segment of its own."""
    connection, _ = listener.accept()
    never = threading.Event()
    with connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for _ in range(ASKED):
            for frame in (READ, ANSWER):
                connection.sendall(frame)
                never.wait(PAUSE_S)


@pytest.mark.parametrize("said", ["--port", "--rtu-port"])
def test_a_tap_reads_the_line_that_a_serial_server_sends(said: str, tmp_path: Path) -> None:
    log = tmp_path / "line.mcap"
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        server = threading.Thread(target=serve, args=(listener,), daemon=True)
        server.start()
        options = (said, "any" if said == "--port" else str(port))
        tap = f"tap:127.0.0.1:0=127.0.0.1:{port}"
        with sniffing(tap, *options, "-w", str(log)) as sniffer:
            with socket.create_connection(("127.0.0.1", tcp_port(sniffer))) as client:
                heard = b"".join(iter(lambda: client.recv(4096), b""))
            sniffer.printed.take(ASKED)
            assert sniffer.interrupt() == 130
        server.join()
    assert heard == (READ + ANSWER) * ASKED
    told = decoded(log)
    assert [(one["outcome"], one["transport"], one["unit"]) for one in told] == [
        ("ok", "rtu", 17)
    ] * ASKED
    assert [one["response_values"] for one in told] == [[0x022B, 0, 0x64]] * ASKED
