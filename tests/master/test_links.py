"""Links that a master asks on."""

from __future__ import annotations

import socket
import time
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, LinkError, SerialLink, TargetTls, TcpLink, UsageError, parse_link
from mbtool.master.links import MasterLink, ReceivedResponse, SerialMaster, open_master
from mbtool.modbus import Response, mbap_adu, rtu_adu
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.sources.virtual_line import VirtualLine
from tests.slave.scripted import PATIENCE_S, Scripted

if TYPE_CHECKING:
    from collections.abc import Iterator

READ = bytes.fromhex("03 0000 0002")
VALUES = bytes.fromhex("03 04 0007 0008")
VENDOR = bytes.fromhex("42 0013")
SECOND_NS = 1_000_000_000


def _answers(unit: int, pdu: bytes) -> Response | None:
    return Response({READ: VALUES}.get(pdu, pdu)) if unit else None


def _received(master: MasterLink, count: int = 1) -> list[ReceivedResponse]:
    """So many answers, or fails when they do not come."""
    answers: list[ReceivedResponse] = []
    until = time.monotonic() + PATIENCE_S
    while len(answers) < count:
        assert time.monotonic() < until
        answers += master.receive(SECOND_NS)
    return answers


def _answered(master: MasterLink, number: int, pdu: bytes) -> ReceivedResponse:
    """Ask until an answer comes, as masters do: a busy machine may part a frame on its line."""
    until = time.monotonic() + PATIENCE_S
    while True:
        assert time.monotonic() < until
        master.send(number, 1, pdu)
        for answer in master.receive(SECOND_NS):
            return answer


@pytest.fixture
def listening() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        yield server


def _link(server: socket.socket, *, rtu: bool = False) -> TcpLink:
    return TcpLink(Endpoint(*server.getsockname()[:2]), rtu=rtu)


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp"])
def test_a_response_over_tcp_has_the_number_of_its_request(scheme: str) -> None:
    link = parse_link(f"{scheme}:127.0.0.1:0")
    assert isinstance(link, TcpLink)
    with (
        TcpSlave(link, Scripted(_answers)) as slave,
        open_master(parse_link(slave.place), SECOND_NS) as master,
    ):
        for number in (5, 9):
            before_ns = time.monotonic_ns()
            master.send(number, 1, READ)
            (answer,) = _received(master)
            assert (answer.number, answer.pdu) == (number, VALUES)
            assert before_ns < answer.start_ns <= answer.end_ns <= time.monotonic_ns()


@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
@pytest.mark.parametrize("pdu", [READ, VENDOR])
def test_a_response_on_a_serial_line_has_the_number_of_its_request(scheme: str, pdu: bytes) -> None:
    with VirtualLine() as line:
        ours, slaves = (parse_link(f"{scheme}:{port}@115200-8N1") for port in line.ports)
        assert isinstance(slaves, SerialLink)
        with SerialSlave(slaves, Scripted(_answers)), open_master(ours, SECOND_NS) as master:
            assert master.limits.one_at_a_time
            for number in (5, 9):
                answer = _answered(master, number, pdu)
                assert (answer.number, answer.pdu) == (number, VALUES if pdu == READ else VENDOR)


def test_different_timeouts_do_not_change_the_settings_of_the_port() -> None:
    """Parity, which a pseudo-terminal may refuse when it is set a second time."""
    with VirtualLine() as line:
        ours, slaves = (parse_link(f"rtu:{port}@19200-8E1") for port in line.ports)
        assert isinstance(slaves, SerialLink)
        with SerialSlave(slaves, Scripted(_answers)), open_master(ours, SECOND_NS) as master:
            for wait_ns in (0, 1_000, 1_000_000, 9_000_000):
                assert list(master.receive(wait_ns)) == []
            assert _answered(master, 1, READ).pdu == VALUES


def test_responses_in_another_order_are_matched_by_transaction_id(listening: socket.socket) -> None:
    with open_master(_link(listening), SECOND_NS) as master:
        peer, _ = listening.accept()
        with peer:
            for number in range(3):
                master.send(number, 1, READ)
            sent = b""
            while len(sent) < 3 * 12:
                sent += peer.recv(100)
            for place in (2, 0, 1):
                peer.sendall(sent[place * 12 : place * 12 + 2] + mbap_adu(0, 1, VALUES)[2:])
            assert [answer.number for answer in _received(master, 3)] == [2, 0, 1]


def test_a_response_without_a_pending_request_has_no_number(listening: socket.socket) -> None:
    with open_master(_link(listening), SECOND_NS) as master:
        peer, _ = listening.accept()
        with peer:
            peer.sendall(mbap_adu(77, 1, VALUES))
            assert _received(master)[0].number == -1


def test_a_frame_from_another_unit_is_not_the_response(listening: socket.socket) -> None:
    with open_master(_link(listening, rtu=True), SECOND_NS) as master:
        peer, _ = listening.accept()
        with peer:
            master.send(5, 1, READ)
            peer.sendall(rtu_adu(2, VALUES) + rtu_adu(1, VALUES))
            assert [answer.number for answer in _received(master, 2)] == [-1, 5]


def test_a_connection_that_was_closed_is_opened_again(listening: socket.socket) -> None:
    with open_master(_link(listening), SECOND_NS) as master:
        first, _ = listening.accept()
        first.close()
        assert list(master.receive(SECOND_NS)) == []
        master.send(1, 1, READ)
        again, _ = listening.accept()
        with again:
            again.sendall(mbap_adu(1, 1, VALUES))
            assert [answer.number for answer in _received(master)] == [1]


def test_without_a_slave_requests_are_lost() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        master = open_master(_link(server), SECOND_NS)
    with master:
        for number in range(3):
            master.send(number, 1, READ)
            assert list(master.receive(1_000_000)) == []
            assert master.lost() == [number]


def test_pending_requests_of_a_connection_that_closes_are_lost(listening: socket.socket) -> None:
    with open_master(_link(listening), SECOND_NS) as master:
        peer, _ = listening.accept()
        with peer:
            for number in (3, 4):
                master.send(number, 1, READ)
            assert master.lost() == []
        until = time.monotonic() + PATIENCE_S
        lost: list[int] = []
        while not lost and time.monotonic() < until:
            master.receive(SECOND_NS)
            lost += master.lost()
        assert lost == [3, 4]


def test_a_refused_connection_is_told_once_and_when_it_is_back() -> None:
    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = _link(server)
        master = open_master(link, SECOND_NS, said.append)
    with master:
        until = time.monotonic() + PATIENCE_S
        while not said and time.monotonic() < until:
            master.send(1, 1, READ)
            master.receive(1_000_000)
        for number in range(3):
            master.send(number, 1, READ)
        assert said == [
            f"mbtool: the connection was lost; {link}: cannot be reached: Connection refused; "
            "does a slave listen there?"
        ]
        with socket.create_server((link.endpoint.host, link.endpoint.port)) as server:
            server.settimeout(PATIENCE_S)
            while len(said) < 2 and time.monotonic() < until:
                master.send(9, 1, READ)
            again, _ = server.accept()
            again.close()
        assert said[1:] == [f"mbtool: {link}: connected again"]


def test_a_slave_that_cannot_be_reached_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = _link(server)
    with pytest.raises(LinkError, match="cannot be reached: Connection refused; does a slave"):
        open_master(link, SECOND_NS)


def test_receive_returns_at_the_timeout(listening: socket.socket) -> None:
    with open_master(_link(listening), SECOND_NS) as master, VirtualLine() as line:
        begin_ns = time.monotonic_ns()
        assert list(master.receive(20_000_000)) == []
        serial = open_master(parse_link(f"rtu:{line.ports[0]}@115200-8N1"), SECOND_NS)
        with serial:
            assert list(serial.receive(20_000_000)) == []
        assert time.monotonic_ns() - begin_ns >= 40_000_000


def test_a_lost_serial_port_is_an_error() -> None:
    line = VirtualLine()
    with line:
        master = open_master(parse_link(f"rtu:{line.ports[0]}@115200-8N1"), SECOND_NS)
        assert isinstance(master, SerialMaster)

    def ask_on() -> None:
        for number in range(100):
            master.send(number, 1, READ)
            master.receive(1_000_000)

    with master, pytest.raises(LinkError, match="lost; is it still plugged in"):
        ask_on()


def test_a_master_cannot_use_an_interface() -> None:
    with pytest.raises(UsageError, match="a master needs rtu:PORT"):
        open_master(parse_link("net:eth0"), SECOND_NS)
    with pytest.raises(UsageError, match="name one"):
        open_master(parse_link("rtu:/dev/a,/dev/b@19200-8N1"), SECOND_NS)


def test_a_name_that_is_not_known_is_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "create_connection", unknown)
    link = TcpLink(Endpoint("absent", 502))
    with pytest.raises(LinkError, match="cannot be reached: no such host; is the name right"):
        open_master(link, SECOND_NS)


@pytest.mark.parametrize("host", ["a..b", ".", "x" * 70])
def test_a_name_that_no_host_can_have_is_told_as_such(host: str) -> None:
    with pytest.raises(LinkError, match="cannot be reached: no such host; is the name right"):
        open_master(TcpLink(Endpoint(host, 502)), SECOND_NS)


def test_a_slave_that_does_not_take_part_in_tls_is_told(
    listening: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.master.links.CONNECT_S", 0.05)
    with pytest.raises(LinkError) as refused:
        open_master(_link(listening), SECOND_NS, tls=TargetTls(ca=None))
    assert str(refused.value).endswith(": TLS: no answer; perhaps it speaks no TLS")
