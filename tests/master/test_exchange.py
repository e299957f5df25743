"""What a master knows of a request and its response."""

from __future__ import annotations

import os
import socket
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from types import SimpleNamespace

import pytest

from mbtool.core import Endpoint, SerialFormat, SerialLink, TcpLink
from mbtool.master import links
from mbtool.master.links import ReceivedResponse, open_master
from mbtool.modbus import Response, mbap_adu, rtu_adu
from mbtool.modbus.adu import Transport
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.sources.virtual_line import VirtualLine
from tests.slave.scripted import PATIENCE_S, Scripted
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.bench import ANY, FAST
from tests.workflows.evidence import READ, VALUES, WRITE

SHORT_NS = 200_000_000


def test_both_adus_are_kept_as_they_were_on_the_wire() -> None:
    script = Scripted(lambda _unit, _pdu: Response(VALUES))
    with (
        TcpSlave(TcpLink(ANY), script) as slave,
        open_master(TcpLink(slave.endpoint), MASTER_TIMEOUT_NS) as master,
    ):
        first, second = master.exchange(1, READ), master.exchange(5, READ)
    assert first.response is not None
    assert first.request.raw == mbap_adu(1, 1, READ)
    assert first.response.raw == mbap_adu(1, 1, VALUES)
    assert (second.request.transaction_id, second.request.unit) == (2, 5)
    assert first.request.end_ns <= first.response.start_ns <= first.response.end_ns
    assert first.unread == ()


def test_rtu_over_tcp_has_no_transaction_id() -> None:
    script = Scripted(lambda _unit, _pdu: Response(VALUES))
    with (
        TcpSlave(TcpLink(ANY, rtu=True), script) as slave,
        open_master(TcpLink(slave.endpoint, rtu=True), MASTER_TIMEOUT_NS) as master,
    ):
        done = master.exchange(1, READ)
    assert (done.request.transport, done.request.transaction_id) == (Transport.RTU_TCP, None)
    assert done.request.raw == rtu_adu(1, READ)


def test_bytes_that_are_no_response_are_kept_beside_it() -> None:
    wrong = b"\xff\x00\xff"  # As a line at another baud rate gives.
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        open_master(
            TcpLink(Endpoint(*server.getsockname()), rtu=True), MASTER_TIMEOUT_NS
        ) as master,
        ThreadPoolExecutor() as pool,
        server.accept()[0] as accepted,
    ):
        waiting = pool.submit(master.exchange, 1, READ)
        assert accepted.recv(256) == rtu_adu(1, READ)
        accepted.sendall(wrong + rtu_adu(1, VALUES))
        done = waiting.result(PATIENCE_S)
    assert done.response is not None
    assert done.response.raw == rtu_adu(1, VALUES)
    assert b"".join(one.raw for one in done.unread) == wrong


def test_a_broadcast_on_a_line_is_not_waited_for() -> None:
    script = Scripted(lambda _unit, _pdu: None)
    with VirtualLine(ends=2, format=FAST) as line:
        slave, ours = (SerialLink(port, FAST) for port in line.ports)
        with SerialSlave(slave, script), open_master(ours, 3600 * 1_000_000_000) as master:
            done = master.exchange(0, WRITE)
            script.await_asked(1)
    assert done.response is None
    assert script.asked == [(0, WRITE)]


def test_a_late_response_is_not_taken_for_that_of_the_next_request() -> None:
    late = Response(VALUES, delay_ns=2 * SHORT_NS)
    script = Scripted(lambda _unit, pdu: late if pdu == READ else Response(pdu))
    with VirtualLine(ends=2, format=FAST) as line:
        slave, ours = (SerialLink(port, FAST) for port in line.ports)
        with SerialSlave(slave, script), open_master(ours, SHORT_NS) as master:
            assert master.exchange(1, READ).response is None
            master.receive(20 * SHORT_NS)  # Until the late one has come.
            answers = (master.exchange(1, WRITE).response for _ in range(20))  # On a busy machine.
            response = next(one for one in answers if one)
    assert response.pdu == WRITE


def test_a_response_that_came_while_this_process_did_not_run_is_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ten_seconds = count(0, 10_000_000_000)  # Pass whenever somebody looks at the clock.
    script = Scripted(lambda _unit, _pdu: Response(VALUES))
    with (
        TcpSlave(TcpLink(ANY), script) as slave,
        open_master(TcpLink(slave.endpoint), MASTER_TIMEOUT_NS) as master,
    ):
        answer = master.exchange(1, READ).response
        assert answer is not None
        monkeypatch.setattr(master, "receive", lambda _: [ReceivedResponse(2, VALUES, 0, 0)])
        monkeypatch.setattr(links, "time", SimpleNamespace(monotonic_ns=ten_seconds.__next__))
        assert master.exchange(1, READ).response is answer


@pytest.mark.parametrize(
    ("strict_ns", "waits"),
    [(None, 50), (1_000_000_000, 20)],
    ids=["a timeout", "a pause of another master"],
)
def test_time_in_which_this_process_did_not_run_counts_in_a_pause_of_another_master_only(
    monkeypatch: pytest.MonkeyPatch, strict_ns: int | None, waits: int
) -> None:
    clock = count(0, 50_000_000)
    monkeypatch.setattr(links, "time", SimpleNamespace(monotonic_ns=clock.__next__))
    patience = links.Patience(1_000_000_000, *([] if strict_ns is None else [strict_ns]))
    assert next(number for number in count(1) if patience.next_ns() <= 0) == waits


def test_a_busy_machine_makes_a_timeout_three_times_as_long_at_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = count(0, 500_000_000)
    monkeypatch.setattr(links, "time", SimpleNamespace(monotonic_ns=clock.__next__))
    patience = links.Patience(1_000_000_000)
    assert next(number for number in count(1) if patience.next_ns() <= 0) == 6


class _Port:
    """A serial port that a process reads which does not run for seconds; see `_jumping`."""

    def __init__(self, response: bytes) -> None:
        self._response = response
        self._near, self._far = os.pipe()
        self._reads = 0

    def fileno(self) -> int:
        return self._near

    @property
    def in_waiting(self) -> int:
        return len(self._response) if self._reads else 1

    def write(self, _: bytes) -> None:
        os.write(self._far, self._response)

    def flush(self) -> None: ...

    def read(self, size: int) -> bytes:
        self._reads += 1
        return os.read(self._near, size)

    def close(self) -> None:
        os.close(self._near)
        os.close(self._far)


@pytest.mark.skipif(os.name != "posix", reason="waits with select")
def test_a_response_that_is_read_in_two_parts_seconds_apart_is_one_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seconds = count(0, 1_000_000_000)  # Pass whenever somebody looks at the clock.
    monkeypatch.setattr(links, "open_port", lambda *_: _Port(rtu_adu(1, VALUES)))
    monkeypatch.setattr(links, "time", SimpleNamespace(monotonic_ns=seconds.__next__))
    with open_master(SerialLink("/dev/ttyUSB0", SerialFormat(19200)), MASTER_TIMEOUT_NS) as master:
        master.send(7, 1, READ)
        assert [(one.number, one.pdu) for one in master.receive(0)] == [(7, VALUES)]
