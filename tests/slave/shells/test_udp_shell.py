"""The UDP shell on loopback sockets."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, LinkError, TcpLink, UsageError
from mbtool.modbus import Response, mbap_adu, rtu_adu
from mbtool.ports.tcp_listener import AllowedPeers
from mbtool.slave.shells.udp_shell import UdpSlave
from tests.slave.scripted import PATIENCE_S, Scripted, echo

if TYPE_CHECKING:
    from mbtool.modbus import Adu

UDP = TcpLink(Endpoint("127.0.0.1", 0), is_udp=True)
RTU = TcpLink(Endpoint("127.0.0.1", 0), rtu=True, is_udp=True)
READ = bytes.fromhex("03 0000 0001")
SLOW_UNIT = 9


def _master(slave: UdpSlave) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.settimeout(PATIENCE_S)
    sock.connect((slave.endpoint.host, slave.endpoint.port))
    return sock


def test_answers_each_master_at_its_own_port() -> None:
    with UdpSlave(UDP, Scripted(echo)) as slave, _master(slave) as one, _master(slave) as other:
        assert slave.place == f"udp:127.0.0.1:{slave.endpoint.port}"
        for number, master in ((1, one), (2, other), (3, one)):
            master.send(mbap_adu(number, 1, READ))
            assert master.recv(300) == mbap_adu(number, 1, READ)


def test_answers_rtu_frames_in_datagrams() -> None:
    with UdpSlave(RTU, Scripted(echo)) as slave, _master(slave) as master:
        assert slave.place == f"rtu+udp:127.0.0.1:{slave.endpoint.port}"
        master.send(rtu_adu(1, READ))
        assert master.recv(300) == rtu_adu(1, READ)


def test_several_requests_in_one_datagram_get_a_datagram_each() -> None:
    with UdpSlave(UDP, Scripted(echo)) as slave, _master(slave) as master:
        master.send(mbap_adu(1, 1, READ) + mbap_adu(2, 1, READ))
        assert [master.recv(300), master.recv(300)] == [mbap_adu(n, 1, READ) for n in (1, 2)]


@pytest.mark.parametrize(
    "datagram", [b"", b"\0", mbap_adu(1, 1, READ)[:-1], b"\0\1\0\7\0\6\1" + READ, b"hello" * 200]
)
def test_what_is_no_request_gets_no_answer_and_joins_no_other_datagram(datagram: bytes) -> None:
    with UdpSlave(UDP, Scripted(echo)) as slave, _master(slave) as master:
        master.send(datagram)
        master.send(mbap_adu(5, 1, READ))
        assert master.recv(300) == mbap_adu(5, 1, READ)


def test_a_delayed_response_comes_after_a_later_one() -> None:
    def late(unit: int, pdu: bytes) -> Response:
        return Response(pdu, 30_000_000 if unit == SLOW_UNIT else 0)

    with UdpSlave(UDP, Scripted(late)) as slave, _master(slave) as master:
        master.send(mbap_adu(1, SLOW_UNIT, READ))
        master.send(mbap_adu(2, 1, READ))
        assert [master.recv(300)[1], master.recv(300)[1]] == [2, 1]


def test_the_hook_sees_requests_and_answers() -> None:
    seen: list[tuple[Adu, Response | None]] = []
    with (
        UdpSlave(UDP, Scripted(echo), on_exchange=lambda *both: seen.append(both)) as slave,
        _master(slave) as master,
    ):
        master.send(mbap_adu(1, 1, READ))
        master.recv(300)
    ((request, response),) = seen
    assert (str(request.transport), request.pdu) == ("udp", READ)
    assert response is not None


def test_an_address_that_others_can_reach_needs_allow() -> None:
    with pytest.raises(UsageError, match="--allow"):
        UdpSlave(TcpLink(Endpoint("0.0.0.0", 0), is_udp=True), Scripted(echo)).start()


def test_a_stranger_gets_no_answer_and_is_told_once() -> None:
    allowed = AllowedPeers.parse(["10.9.9.0/24"])
    with UdpSlave(UDP, Scripted(echo), allowed=allowed) as slave:
        for _ in range(2):
            slave.take(mbap_adu(1, 1, READ), ("192.0.2.1", 5000))
        assert slave.notes() == ["a master was turned away: 192.0.2.1 is in no network of --allow"]
        assert slave.notes() == []


def test_a_port_in_use_is_said_to_be() -> None:
    with UdpSlave(UDP, Scripted(echo)) as slave:
        again = UdpSlave(TcpLink(slave.endpoint, is_udp=True), Scripted(echo))
        with pytest.raises(LinkError, match="the port is in use"):
            again.start()
