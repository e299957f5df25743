"""The TCP shell on loopback sockets."""

from __future__ import annotations

import errno
import select
import socket
import threading
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest
from pymodbus.client import ModbusTcpClient

from mbtool.core import Endpoint, LinkError, TcpLink, UsageError
from mbtool.devices import load_profile
from mbtool.modbus import Response, Table, mbap_adu, rtu_adu
from mbtool.ports.tcp_listener import AllowedPeers
from mbtool.slave.device import RegisterImage, units_on
from mbtool.slave.device.connection_policy import ConnectionPolicy
from mbtool.slave.families import make_device
from mbtool.slave.shells import Bounds, TcpSlave
from mbtool.slave.shells.tcp_shell import READ_BYTES
from tests.slave.scripted import PATIENCE_S, Scripted, echo

if TYPE_CHECKING:
    from mbtool.modbus import Adu

LOOPBACK = TcpLink(Endpoint("127.0.0.1", 0))
RTU = TcpLink(Endpoint("127.0.0.1", 0), rtu=True)

READ = bytes.fromhex("03 0000 0001")
SLOW_UNIT = 9


def _connect(slave: TcpSlave) -> socket.socket:
    endpoint = slave.endpoint
    return socket.create_connection((endpoint.host, endpoint.port), PATIENCE_S)


def _receive(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        assert part, f"closed after {len(data)} of {size} bytes"
        data += part
    return data


def _ask(connection: socket.socket, unit: int = 1, transaction_id: int = 0) -> None:
    """One request to an echoing slave, and its answer."""
    adu = mbap_adu(transaction_id, unit, READ)
    connection.sendall(adu)
    assert _receive(connection, len(adu)) == adu


def _await_end(connection: socket.socket) -> None:
    """Wait until the other side has closed the connection."""
    try:
        while connection.recv(4096):
            pass
    except ConnectionError:
        pass


def _delayed(delay_ns: int) -> Scripted:
    """Echoes; the slow unit takes its time."""
    return Scripted(lambda unit, pdu: Response(pdu, delay_ns if unit == SLOW_UNIT else 0))


def test_pymodbus_reads_and_writes_a_device() -> None:
    profile = load_profile("fa3-at1m8x")
    device = make_device(profile, RegisterImage.of(profile))
    device.image.set(Table.INPUT_REGISTERS, 2, [12000, 4000])
    with TcpSlave(LOOPBACK, units_on(LOOPBACK, profile, 0, device)) as slave:
        client = ModbusTcpClient("127.0.0.1", port=slave.endpoint.port, timeout=PATIENCE_S)
        with client:
            assert not client.write_coil(0x0009, True).isError()  # Y9: conversion starts.
            assert client.read_input_registers(2, count=2, device_id=1).registers == [12000, 4000]
            assert not client.write_registers(0x0105, [0, 0x2010]).isError()
            assert client.read_holding_registers(0x0105, count=2).registers == [0, 0x2010]
            assert not client.write_coils(0x10, [True, False, True]).isError()
            assert client.read_coils(0x10, count=3).bits[:3] == [True, False, True]
            assert client.read_holding_registers(0x0010).exception_code == 2


def test_answers_carry_the_transaction_id_and_unit_of_their_request() -> None:
    with TcpSlave(LOOPBACK, Scripted(echo)) as slave, _connect(slave) as connection:
        _ask(connection, unit=1, transaction_id=0x1234)
        _ask(connection, unit=255, transaction_id=0)


def test_rtu_over_tcp_travels_with_a_crc() -> None:
    with TcpSlave(RTU, Scripted(echo)) as slave, _connect(slave) as connection:
        adu = rtu_adu(1, READ)
        connection.sendall(adu)
        assert _receive(connection, len(adu)) == adu


def test_a_request_may_come_in_pieces_and_several_at_once() -> None:
    adus = b"".join(mbap_adu(number, 1, READ) for number in range(5))
    with TcpSlave(LOOPBACK, Scripted(echo)) as slave, _connect(slave) as connection:
        for place in range(len(adus)):
            connection.sendall(adus[place : place + 1])
        assert _receive(connection, len(adus)) == adus
        connection.sendall(adus)
        assert _receive(connection, len(adus)) == adus


def test_another_protocol_id_gets_no_answer() -> None:
    foreign = bytes.fromhex(
        "0001"  # transaction id
        "0001"  # protocol id
        "0006"  # length
        "01"  # unit id
        "03 0000 0001"  # read holding registers
    )
    scripted = Scripted(echo)
    with TcpSlave(LOOPBACK, scripted) as slave, _connect(slave) as connection:
        connection.sendall(foreign)
        _ask(connection)
    assert len(scripted.asked) == 1


def test_silence_of_the_responder_is_silence() -> None:
    silent_once = Scripted(lambda unit, pdu: None if unit == SLOW_UNIT else Response(pdu))
    with TcpSlave(LOOPBACK, silent_once) as slave, _connect(slave) as connection:
        connection.sendall(mbap_adu(1, SLOW_UNIT, READ))
        _ask(connection, transaction_id=2)


def test_noise_harms_only_its_own_connection() -> None:
    with (
        TcpSlave(LOOPBACK, Scripted(echo)) as slave,
        _connect(slave) as noisy,
        _connect(slave) as other,
    ):
        noisy.sendall(bytes(range(256)) * 40)
        _ask(other)
        noisy.close()
        _ask(other)


def test_a_delay_holds_up_its_own_connection_only() -> None:
    scripted = _delayed(300_000_000)
    with (
        TcpSlave(LOOPBACK, scripted) as slave,
        _connect(slave) as slow,
        _connect(slave) as other,
    ):
        adu = mbap_adu(1, SLOW_UNIT, READ)
        slow.sendall(adu)
        scripted.await_asked(1)
        _ask(other)
        assert not select.select([slow], [], [], 0)[0]
        assert _receive(slow, len(adu)) == adu


def test_answers_keep_the_order_of_their_requests() -> None:
    adus = mbap_adu(1, SLOW_UNIT, READ) + mbap_adu(2, 1, READ) + mbap_adu(3, SLOW_UNIT, READ)
    with (
        TcpSlave(LOOPBACK, _delayed(50_000_000)) as slave,
        _connect(slave) as connection,
    ):
        connection.sendall(adus)
        assert _receive(connection, len(adus)) == adus


def test_connections_are_bounded() -> None:
    with (
        TcpSlave(LOOPBACK, Scripted(echo), bounds=Bounds(connections=2)) as slave,
        _connect(slave) as first,
        _connect(slave) as second,
        _connect(slave) as third,
    ):
        _ask(first)
        _ask(second)
        _await_end(third)
        _ask(first)
        assert (slave.turned_away, slave.places) == (1, 2)


def test_a_connection_that_ends_leaves_its_place_to_another() -> None:
    with TcpSlave(LOOPBACK, Scripted(echo), bounds=Bounds(connections=1)) as slave:
        with _connect(slave) as first:
            _ask(first)
        for _ in range(1000):  # Until the end of the first has reached the slave.
            with _connect(slave) as second:
                try:
                    _ask(second)
                except (ConnectionError, AssertionError):
                    continue
                return
        pytest.fail("no place becomes free")


def test_an_idle_connection_is_closed() -> None:
    with (
        TcpSlave(LOOPBACK, Scripted(echo), bounds=Bounds(idle_s=0.05)) as slave,
        _connect(slave) as connection,
    ):
        _await_end(connection)


def test_pieces_of_a_request_do_not_keep_a_connection_open() -> None:
    with (
        TcpSlave(LOOPBACK, Scripted(echo), bounds=Bounds(idle_s=0.1)) as slave,
        _connect(slave) as connection,
    ):
        connection.settimeout(0.02)
        connection.sendall(b"\x00\x01\x00\x00\x00\xfe")
        for _ in range(1000):
            try:
                connection.sendall(b"\x01")
                if not connection.recv(1):
                    return
            except TimeoutError:
                continue
            except ConnectionError:
                return
        pytest.fail("the connection stays open")


def test_requests_that_wait_are_bounded() -> None:
    bound = 2
    scripted = _delayed(3_600_000_000_000)
    with (
        TcpSlave(LOOPBACK, scripted, bounds=Bounds(waiting=bound)) as slave,
        _connect(slave) as greedy,
        _connect(slave) as other,
    ):
        greedy.sendall(mbap_adu(1, SLOW_UNIT, READ) * 5000)
        scripted.await_asked(bound)
        for _ in range(50):
            _ask(other)
        asked = [unit for unit, _ in scripted.asked].count(SLOW_UNIT)
        assert bound <= asked <= bound + READ_BYTES // 8


def test_a_peer_that_takes_no_answers_is_not_read_from() -> None:
    # Function, byte count and 250 bytes for a request of 12.
    full = Scripted(lambda unit, pdu: Response(b"\x03\xfa" + bytes(250)))
    with TcpSlave(LOOPBACK, full) as slave, _connect(slave) as greedy:
        greedy.setblocking(False)
        requests = mbap_adu(1, 1, READ) * 1000
        sent = 0
        while select.select([], [greedy], [], 0.5)[1]:
            sent += greedy.send(requests)
            assert sent < 100_000_000, "it is read from without end"
        with _connect(slave) as other:
            other.sendall(mbap_adu(1, 1, READ))
            assert len(_receive(other, 259)) == 259


def test_the_hook_sees_requests_and_answers() -> None:
    seen: list[tuple[Adu, Response | None]] = []
    slave = TcpSlave(
        LOOPBACK, Scripted(echo), on_exchange=lambda adu, answer: seen.append((adu, answer))
    )
    with slave, _connect(slave) as connection:
        _ask(connection, unit=7)
    ((adu, answer),) = seen
    assert (adu.unit, adu.pdu, answer) == (7, READ, Response(READ))


def test_stop_closes_connections_and_frees_the_port() -> None:
    slave = TcpSlave(LOOPBACK, Scripted(echo))
    slave.start()
    with _connect(slave) as connection:
        _ask(connection)
        slave.stop()
        _await_end(connection)
    slave.stop()
    slave.wait()
    with TcpSlave(TcpLink(slave.endpoint), Scripted(echo)) as again, _connect(again) as connection:
        _ask(connection)


def test_wait_returns_when_another_thread_stops_it() -> None:
    slave = TcpSlave(LOOPBACK, Scripted(echo))
    slave.start()
    slave.wait(0)
    stopper = threading.Timer(0.01, slave.stop)
    stopper.start()
    slave.wait(PATIENCE_S)
    stopper.join()
    with pytest.raises(ConnectionError):
        _connect(slave)


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_a_slave_that_other_machines_can_reach_wants_to_know_which(host: str) -> None:
    link = TcpLink(Endpoint(host, 0))
    with pytest.raises(UsageError, match=r"other machines can reach .*--allow"):
        TcpSlave(link, Scripted(echo)).start()


@pytest.mark.parametrize(("host", "peer"), [("0.0.0.0", "127.0.0.1"), ("::", "127.0.0.1")])
def test_a_slave_on_all_addresses_answers_this_machine(host: str, peer: str) -> None:
    link = TcpLink(Endpoint(host, 0))
    allowed = AllowedPeers.parse(["10.0.0.0/8"])
    with TcpSlave(link, Scripted(echo), allowed=allowed) as slave:
        assert slave.endpoint.host == host
        with socket.create_connection((peer, slave.endpoint.port), PATIENCE_S) as connection:
            _ask(connection)


class _Nobody(AllowedPeers):
    """No machine at all, so that a connection from this one is refused."""

    def __contains__(self, host: object) -> bool:
        return False


def test_a_master_that_is_not_allowed_is_closed_at_once_and_reported_once() -> None:
    rules = ConnectionPolicy(places=1)
    with TcpSlave(LOOPBACK, Scripted(echo), allowed=_Nobody(), rules=rules) as slave:
        for _ in range(3):
            with _connect(slave) as connection:
                _await_end(connection)
        assert slave.notes() == ["a master was turned away: 127.0.0.1 is in no network of --allow"]
        assert (slave.turned_away, rules.peers) == (0, [])


class _ClosedForAWhile(ConnectionPolicy):
    """Wants no connection until a moment."""

    until_ns = 0

    @property
    def closed_until_ns(self) -> int:
        return self.until_ns


def test_another_that_listens_while_no_connection_is_taken_is_told() -> None:
    rules = _ClosedForAWhile()

    def close(_: int, pdu: bytes) -> Response:
        rules.until_ns, rules.changed = slave.clock() + round(PATIENCE_S * 1e9), True
        return Response(pdu)

    slave = TcpSlave(LOOPBACK, Scripted(close), rules=rules)
    with slave, socket.socket() as other, _connect(slave) as connection:
        connection.sendall(mbap_adu(0, 1, READ))
        _await_end(connection)
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        while other.getsockname()[1] != slave.endpoint.port:
            with suppress(OSError):  # Until it has closed its own.
                other.bind(("127.0.0.1", slave.endpoint.port))
        other.listen()
        rules.until_ns = 0
        slave._loop.call_soon_threadsafe(slave._woken.set)
        with pytest.raises(LinkError, match="the port is in use"):
            slave.wait(PATIENCE_S)


def test_who_is_accepted_as_the_device_closes_its_port_is_closed_too() -> None:
    rules = _ClosedForAWhile()
    held, released = threading.Event(), threading.Event()

    def close(unit: int, pdu: bytes) -> Response:
        if unit == SLOW_UNIT:  # So that the loop finds the two things after it at once.
            held.set()
            assert released.wait(PATIENCE_S)
        else:
            rules.until_ns, rules.changed = slave.clock() + round(PATIENCE_S * 1e9), True
        return Response(pdu)

    slave = TcpSlave(LOOPBACK, Scripted(close), rules=rules)
    with slave, _connect(slave) as first, _connect(slave) as second:
        first.sendall(mbap_adu(0, SLOW_UNIT, READ))
        assert held.wait(PATIENCE_S)
        second.sendall(mbap_adu(0, 1, READ))
        with _connect(slave) as third:
            released.set()
            for connection in (first, second, third):
                _await_end(connection)
        assert slave.turned_away == 0


def test_a_shell_that_is_stopped_before_it_serves_frees_the_port() -> None:
    slave = TcpSlave(LOOPBACK, Scripted(echo))
    slave._is_stopping = True
    slave.start()
    slave.wait(PATIENCE_S)
    with socket.socket() as other:
        other.bind((slave.endpoint.host, slave.endpoint.port))


def test_who_connects_while_it_ends_is_not_waited_for() -> None:
    slave = TcpSlave(LOOPBACK, Scripted(echo))
    with slave:
        with _connect(slave) as connection:
            _ask(connection)
        slave._is_stopping = True
        with _connect(slave) as connection:
            _await_end(connection)
        assert not slave.connections


def test_rules_of_a_device_count_instead_of_bounds() -> None:
    rules = ConnectionPolicy(places=1)
    bounds = Bounds(connections=5)
    with (
        TcpSlave(LOOPBACK, Scripted(echo), bounds=bounds, rules=rules) as slave,
        _connect(slave) as first,
        _connect(slave) as second,
    ):
        _ask(first)
        _await_end(second)
        assert (slave.places, slave.turned_away) == (1, 1)
        assert slave.notes() == []


def test_that_no_more_files_can_be_opened_is_said_once() -> None:
    context = {"exception": OSError(errno.EMFILE, "Too many open files")}
    with TcpSlave(LOOPBACK, Scripted(echo)) as slave, _connect(slave) as connection:
        _ask(connection)
        for _ in range(9):
            slave._loop.call_soon_threadsafe(slave._loop.call_exception_handler, context)
        _ask(connection)
        assert slave.notes() == [
            "no more connections for now: Too many open files; ulimit -n allows more"
        ]
