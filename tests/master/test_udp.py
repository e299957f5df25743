"""A master that sends datagrams."""

from __future__ import annotations

import socket
from contextlib import contextmanager
from threading import Thread
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, TcpLink, UsageError
from mbtool.master.links import TcpMaster, open_master
from mbtool.master.wire import open_wire
from mbtool.modbus import mbap_adu, rtu_adu
from tests.sources.live_helpers import MASTER_TIMEOUT_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

READ = bytes.fromhex("03 0000 0001")
ONE = bytes.fromhex("03 02 0007")
PATIENCE_S = 20.0
SHORT_NS = 1_000_000_000


@contextmanager
def _slave(answers: Callable[[bytes], list[bytes]], *, rtu: bool = False) -> Iterator[TcpLink]:
    """Answer each datagram with the datagrams that a function returns for it."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.settimeout(PATIENCE_S)

    def run() -> None:
        while True:
            data, master = sock.recvfrom(1000)
            if data == b"end":
                return
            for answer in answers(data):
                sock.sendto(answer, master)

    thread = Thread(target=run)
    thread.start()
    try:
        yield TcpLink(Endpoint(*sock.getsockname()), rtu, is_udp=True)
    finally:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ending:
            ending.sendto(b"end", sock.getsockname())
        thread.join(PATIENCE_S)
        sock.close()


def test_asks_and_is_answered() -> None:
    with (
        _slave(lambda asked: [asked[:2] + mbap_adu(0, 1, ONE)[2:]]) as link,
        open_master(link, MASTER_TIMEOUT_NS) as master,
    ):
        assert str(master.transport) == "udp"
        assert [master.ask(1, READ) for _ in range(3)] == [ONE] * 3


def test_asks_in_rtu_frames() -> None:
    with (
        _slave(lambda _: [rtu_adu(1, ONE)], rtu=True) as link,
        open_master(link, MASTER_TIMEOUT_NS) as master,
    ):
        assert str(master.transport) == "rtu-udp"
        assert [master.ask(1, READ) for _ in range(3)] == [ONE] * 3


def test_a_lost_response_costs_its_request_only() -> None:
    asked: list[bytes] = []

    def answers(data: bytes) -> list[bytes]:
        asked.append(data)
        return [] if len(asked) == 2 else [mbap_adu(len(asked), 1, ONE)]

    with _slave(answers) as link, open_master(link, SHORT_NS) as master:
        assert [master.ask(1, READ) for _ in range(3)] == [ONE, None, ONE]


def test_a_late_response_is_not_taken_for_that_of_the_next_request() -> None:
    other = bytes.fromhex("03 02 0008")
    asked: list[bytes] = []

    def answers(data: bytes) -> list[bytes]:
        asked.append(data)
        late = [mbap_adu(1, 1, ONE)] if len(asked) == 2 else []
        return [] if len(asked) == 1 else [*late, mbap_adu(len(asked), 1, other)]

    with _slave(answers) as link, open_master(link, SHORT_NS) as master:
        assert [master.ask(1, READ) for _ in range(2)] == [None, other]


def test_a_doubled_response_is_not_taken_for_that_of_the_next_request() -> None:
    asked: list[bytes] = []

    def answers(data: bytes) -> list[bytes]:
        asked.append(data)
        value = bytes((3, 2, 0, len(asked)))
        return [mbap_adu(len(asked), 1, value)] * 2

    with _slave(answers) as link, open_master(link, MASTER_TIMEOUT_NS) as master:
        assert [(master.ask(1, READ) or b"")[-1:] for _ in range(4)] == [b"\1", b"\2", b"\3", b"\4"]


def test_a_part_of_a_response_joins_no_other_datagram() -> None:
    whole = mbap_adu(1, 1, ONE)
    with (
        _slave(lambda _: [b"", whole[:5], whole]) as link,
        open_master(link, MASTER_TIMEOUT_NS) as master,
    ):
        assert master.ask(1, READ) == ONE


def test_a_port_at_which_nobody_listens_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        link = TcpLink(Endpoint(*taken.getsockname()), is_udp=True)
    told: list[str] = []
    with open_master(link, SHORT_NS, told.append) as master:
        assert isinstance(master, TcpMaster)
        for _ in range(4):
            assert master.ask(1, READ) is None
        assert master.ended is None
    assert told == [f"mbtool: {link}: its host answers that nobody listens at this port"]


def test_a_conformance_test_needs_another_link() -> None:
    link = TcpLink(Endpoint("127.0.0.1", 502), is_udp=True)
    with pytest.raises(UsageError, match="which UDP cannot"):
        open_wire(link, SHORT_NS, None)
