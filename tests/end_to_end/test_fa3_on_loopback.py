"""The connection rules of an FA3 module on real sockets, its timers set through its registers."""

from __future__ import annotations

import ctypes
import select
import socket
import struct
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, TcpLink
from mbtool.devices import load_profile
from mbtool.modbus import mbap_adu
from mbtool.slave.device import RegisterImage, units_on
from mbtool.slave.families import make_device
from mbtool.slave.shells import TcpSlave

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.slave.device import Behaviour

LOOPBACK = TcpLink(Endpoint("127.0.0.1", 0))
PATIENCE_S = 120.0

READ_ALARM = bytes.fromhex("04 0001 0001")
MODEL = bytes.fromhex("42 00")
RESET = bytes.fromhex("41 00")


@contextmanager
def _module(name: str) -> Iterator[tuple[TcpSlave, Behaviour]]:
    profile = load_profile(name)
    device = make_device(profile, RegisterImage.of(profile))
    units = units_on(LOOPBACK, profile, 0, device)
    with TcpSlave(LOOPBACK, units, rules=device.behaviour.rules) as slave:
        yield slave, device.behaviour


class Master(socket.socket):
    """Asks on one connection."""

    def __init__(self, slave: TcpSlave) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self.settimeout(PATIENCE_S)
        try:
            self.connect((slave.endpoint.host, slave.endpoint.port))
        except OSError:
            self.close()
            raise
        self.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def ask(self, pdu: bytes | str, unit: int = 0) -> str:
        pdu = bytes.fromhex(pdu) if isinstance(pdu, str) else pdu
        self.sendall(mbap_adu(0, unit, pdu))
        head = self._receive(7)
        assert (head[:4], head[6]) == (bytes(4), unit)
        return self._receive(int.from_bytes(head[4:6], "big") - 1).hex(" ")

    def await_end(self) -> None:
        """Wait until the module has closed the connection."""
        try:
            while self.recv(4096):
                pass
        except ConnectionError:
            pass

    def hear_nothing_more(self) -> None:
        """Have the kernel drop all that comes, so that not even TCP answers: a cable cut."""
        drop = struct.pack("HBBI", 0x06, 0, 0, 0)  # return 0 bytes of the packet
        code = ctypes.create_string_buffer(drop)
        program = struct.pack("HxxxxxxP", 1, ctypes.addressof(code))
        try:
            self.setsockopt(socket.SOL_SOCKET, 26, program)  # SO_ATTACH_FILTER
        except PermissionError:
            pytest.skip("this system lets only root filter what a socket hears")

    def _receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            part = self.recv(size - len(data))
            assert part, "closed"
            data += part
        return data


def _until(done: Callable[[], bool], master: Master | None = None) -> None:
    """Ask on, if a master is given, until something is so."""
    end = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < end, "it does not come about"
        select.select([], [], [], 0.01)  # Spares the processor.
        if master is not None:
            master.ask(MODEL)


def test_another_protocol_id_gets_no_answer_and_any_module_id_does() -> None:
    with _module("fa3-at1m8x") as (slave, _), Master(slave) as master:
        master.sendall(bytes.fromhex("0000 0001 0003 00 42 00"))
        for unit in (0, 1, 247, 255):
            assert master.ask(MODEL, unit) == "42 00 16"


def test_a_third_connection_closes_the_one_that_was_silent_longest() -> None:
    with _module("fa3-th1m16xc") as (slave, _), Master(slave) as first, Master(slave) as second:
        first.ask(MODEL)
        second.ask(MODEL)
        first.ask(MODEL)
        with Master(slave) as third:
            assert third.ask(MODEL) == "42 00 13"
            second.await_end()
            assert first.ask(MODEL) == "42 00 13"
            assert third.ask(READ_ALARM) == "04 02 00 00"
            assert (slave.turned_away, slave.places) == (0, 2)
            (note,) = slave.notes()
            assert note.startswith("a third connection, from 127.0.0.1: the one from 127.0.0.1 is")
            assert slave.notes() == []


@pytest.mark.skipif(sys.platform != "linux", reason="to be deaf to TCP takes a Linux socket filter")
def test_a_master_that_answers_no_alive_check_is_disconnected_with_alarm_0e30() -> None:
    with _module("fa3-th1m16y") as (slave, _), Master(slave) as alive, Master(slave) as dead:
        dead.ask(MODEL)
        alive.ask("10 00F2 0003 06 0001 0001 0001")
        dead.hear_nothing_more()
        _until(lambda: len(slave.connections) == 1, alive)
        assert alive.ask(READ_ALARM) == "04 02 0e 30"
        # While it disconnects, the module rejects that master; here it comes from one address.
        with Master(slave) as again:
            again.await_end()
        assert alive.ask("43 00") == "43 00"
        assert alive.ask(READ_ALARM) == "04 02 00 00"


@pytest.mark.skipif(not hasattr(socket, "TCP_KEEPIDLE"), reason="no TCP_KEEPIDLE here")
def test_the_alive_check_of_all_connections_follows_the_registers_within_their_ranges() -> None:
    def settings(slave: TcpSlave) -> set[tuple[int, ...]]:
        options = (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
        socks = [each._transport.get_extra_info("socket") for each in slave.connections]
        return {tuple(sock.getsockopt(6, option) for option in options) for sock in socks}

    with _module("fa3-th1m16xc") as (slave, _), Master(slave) as first, Master(slave) as second:
        first.ask(MODEL)
        second.ask(MODEL)
        assert settings(slave) == {(600, 10, 3)}
        first.ask("10 00F2 0003 06 0000 FFFF 0000")
        assert first.ask("03 00F2 0003") == "03 06 00 00 ff ff 00 00"
        assert settings(slave) == {(1, 60, 1)}
        second.ask("06 00F2 3840")
        second.ask(MODEL)
        assert settings(slave) == {(14400, 60, 1)}


def test_a_request_that_stays_split_is_disconnected_with_alarm_0e40() -> None:
    with _module("fa3-at1m8x") as (slave, _), Master(slave) as whole, Master(slave) as split:
        whole.ask("06 00F5 0000")  # Below its range: one second.
        begun = time.monotonic()
        split.sendall(mbap_adu(0, 0, MODEL)[:5])
        split.await_end()
        assert time.monotonic() - begun >= 1.0
        assert whole.ask(READ_ALARM) == "04 02 0e 40"
        assert whole.ask("44 00") == "44 00"
        assert whole.ask(READ_ALARM) == "04 02 0e 40"
        assert whole.ask("43 00") == "43 00"
        assert whole.ask(READ_ALARM) == "04 02 00 00"


def test_a_reset_closes_all_connections_and_takes_none_for_two_seconds() -> None:
    with _module("fa3-at1m8y") as (slave, _), Master(slave) as first, Master(slave) as second:
        second.ask("06 0003 0007")
        begun = time.monotonic()
        first.sendall(mbap_adu(0, 0, RESET))
        first.await_end()
        second.await_end()
        while True:
            assert time.monotonic() < begun + PATIENCE_S
            try:
                again = Master(slave)
            except ConnectionRefusedError:
                select.select([], [], [], 0.02)  # Spares the processor.
                continue
            break
        assert time.monotonic() - begun >= 2.0
        with again:
            assert again.ask(MODEL) == "42 00 17"
            assert again.ask("03 0003 0001") == "03 02 00 00"


def test_a_slave_that_is_closed_for_a_reset_can_be_stopped() -> None:
    with _module("fa3-at1m8y") as (slave, _), Master(slave) as master:
        master.sendall(mbap_adu(0, 0, RESET))
        master.await_end()
    slave.wait(PATIENCE_S)
    with TcpSlave(TcpLink(slave.endpoint), slave.responder) as again, Master(again) as master:
        assert master.ask(MODEL) == "42 00 17"


def test_outputs_clear_with_the_last_connection_and_come_back_with_the_next() -> None:
    with _module("fa3-th1m16y") as (slave, behaviour):

        def on() -> list[str]:
            return [output.name for output in behaviour.outputs() if output.value]

        with Master(slave) as first:
            assert first.ask("05 0001 FF00") == "05 00 01 ff 00"
            with Master(slave) as second:
                second.ask(MODEL)
            assert on() == ["Y1"]
        _until(lambda: on() == [])
        with Master(slave) as again:
            again.ask(MODEL)
            assert on() == ["Y1"]
