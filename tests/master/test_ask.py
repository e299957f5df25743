"""Masters that send one request and wait for its response."""

from __future__ import annotations

import socket
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, LinkError, SerialLink, TcpLink
from mbtool.master.links import open_master
from mbtool.modbus import Response, mbap_adu
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.sources.virtual_line import VirtualLine
from tests.slave.scripted import PATIENCE_S, Scripted
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.bench import ANY, FAST
from tests.workflows.evidence import READ, VALUES, WRITE

if TYPE_CHECKING:
    from pathlib import Path

SHORT_NS = 200_000_000


def _only_writes(unit: int, pdu: bytes) -> Response | None:
    return Response(pdu) if pdu == WRITE else None


def _device(unit: int, pdu: bytes) -> Response | None:
    return Response(VALUES if pdu == READ else pdu)


def test_asks_over_tcp() -> None:
    script = Scripted(lambda _unit, _pdu: Response(VALUES))
    with (
        TcpSlave(TcpLink(ANY), script) as slave,
        open_master(TcpLink(slave.endpoint), MASTER_TIMEOUT_NS) as master,
    ):
        assert master.ask(1, READ) == VALUES
        assert master.ask(5, READ) == VALUES
    assert script.asked == [(1, READ), (5, READ)]


def test_no_response_over_tcp_gives_none_and_a_late_response_is_not_taken_for_the_next() -> None:
    with (
        TcpSlave(TcpLink(ANY), Scripted(_only_writes)) as slave,
        open_master(TcpLink(slave.endpoint), SHORT_NS) as master,
    ):
        assert master.ask(1, READ) is None
        assert master.ask(1, WRITE) == WRITE


def test_a_connection_that_is_closed_while_it_waits_gives_none() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        open_master(
            TcpLink(Endpoint("127.0.0.1", server.getsockname()[1])), MASTER_TIMEOUT_NS
        ) as master,
        ThreadPoolExecutor() as pool,
    ):
        with server.accept()[0] as accepted:
            answer = pool.submit(master.ask, 1, READ)
            assert accepted.recv(256) == mbap_adu(1, 1, READ)
        assert answer.result(PATIENCE_S) is None


def test_a_closed_connection_is_opened_again_for_the_next_request() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        open_master(
            TcpLink(Endpoint("127.0.0.1", server.getsockname()[1])), MASTER_TIMEOUT_NS
        ) as master,
        ThreadPoolExecutor() as pool,
    ):
        server.accept()[0].close()
        master.receive(int(PATIENCE_S * 1e9))  # Until it is closed.
        server.settimeout(PATIENCE_S)
        answer = pool.submit(master.ask, 1, READ)
        with server.accept()[0] as accepted:
            assert accepted.recv(256) == mbap_adu(1, 1, READ)
            accepted.sendall(mbap_adu(1, 1, VALUES))
            assert answer.result(PATIENCE_S) == VALUES


def test_the_error_names_the_slave_that_cannot_be_reached() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(LinkError, match=f"127.0.0.1:{port}: cannot be reached"):
        open_master(TcpLink(Endpoint("127.0.0.1", port)), MASTER_TIMEOUT_NS)


def test_asks_on_a_serial_line() -> None:
    with VirtualLine(ends=2, format=FAST) as line:
        slave, master = (SerialLink(port, FAST) for port in line.ports)
        with SerialSlave(slave, Scripted(_device)), open_master(master, MASTER_TIMEOUT_NS) as rtu:
            assert rtu.ask(1, WRITE) == WRITE
            assert rtu.ask(2, READ) == VALUES


def test_no_response_on_a_serial_line_gives_none() -> None:
    with (
        VirtualLine(ends=2, format=FAST) as line,
        open_master(SerialLink(line.ports[1], FAST), SHORT_NS) as rtu,
    ):
        assert rtu.ask(1, READ) is None


def test_a_port_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="absent: is not there"):
        open_master(SerialLink(str(tmp_path / "absent"), FAST), MASTER_TIMEOUT_NS)
