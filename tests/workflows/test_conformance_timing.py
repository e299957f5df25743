"""Cases of pauses, connections and broadcasts, each with a slave that fails it.

The slaves here are small and have one fault each, which `slave --fault` cannot make.
"""

from __future__ import annotations

import socket
from contextlib import ExitStack, suppress
from errno import ETIMEDOUT
from threading import Event, Thread
from typing import TYPE_CHECKING

import pytest
import serial

from mbtool.core import Endpoint, LinkError, SerialFormat, SerialLink, TcpLink
from mbtool.devices import load_profile
from mbtool.master.wire import TcpWire, open_wire
from mbtool.modbus import rtu_adu
from mbtool.modbus.adu import crc
from mbtool.modbus.tables import Table
from mbtool.slave.device import RegisterImage
from mbtool.slave.families import make_device
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.conformance import Conformance, Result
from tests.end_to_end.programs import PATIENCE_S
from tests.workflows.slave_in_memory import SlaveInMemory

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.devices import Profile

UNIT = 5
SLOW = SerialFormat(baud=1200, parity="N")


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


@pytest.fixture
def profile(tmp_path: Path) -> Profile:
    """A device with one holding register, so that there are few cases."""
    file = tmp_path / "one.toml"
    file.write_text(
        "name = 'one'\ntitle = 'One register'\nvendor = 'none'\nsource = 'this test'\n"
        "transports = ['rtu', 'tcp']\n[functions]\n03 = {}\n06 = {}\n"
        "[[areas]]\nname = 'all'\ntable = 'holding_registers'\nfirst = 0\nlast = 0\naccess = 'rw'\n"
    )
    return load_profile(str(file))


class LineSlave:
    """A slave on a serial line that takes a frame as soon as its CRC is right.

    So no pause of a busy machine divides one. With `takes_broadcasts` it does what unit 0 says,
    with `answers_broadcasts` it answers, too.
    """

    def __init__(
        self,
        port: str,
        profile: Profile,
        *,
        takes_broadcasts: bool = True,
        answers_broadcasts: bool = False,
    ) -> None:
        self._port = serial.Serial(port, SLOW.baud, timeout=0.05)
        self._device = make_device(profile, RegisterImage())
        self._takes, self._answers = takes_broadcasts, answers_broadcasts
        self._ends = Event()
        self._thread = Thread(target=self._run)

    def __enter__(self) -> LineSlave:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()
        self._port.close()

    def _run(self) -> None:
        heard = b""
        while not self._ends.is_set():
            heard += self._port.read(1)
            if len(heard) >= 4 and not crc(heard):
                self._take(heard[0], heard[1:-2])
                heard = b""

    def _take(self, unit: int, pdu: bytes) -> None:
        if unit not in (0, UNIT) or (unit == 0 and not self._takes):
            return
        response = self._device.respond(UNIT, pdu, 0)
        is_read = pdu[0] == 3
        if response is not None and (unit or (self._answers and not is_read)):
            self._port.write(rtu_adu(UNIT, response.pdu))


class NetworkSlave:
    """A Modbus/TCP slave that serves each connection in a thread of its own.

    It serves only the newest `served` connections, or with `keeps_first` the oldest ones; the
    others stay open and get no answer. After `most` connections in all it accepts no more. A
    connection that is silent for `silence_s` is ignored from then on, or closed if it `closes`.
    """

    def __init__(
        self,
        profile: Profile,
        *,
        served: int = 1000,
        keeps_first: bool = False,
        most: int = 1000,
        silence_s: float = 60.0,
        closes: bool = False,
    ) -> None:
        self._device = make_device(profile, RegisterImage())
        self._served, self._keeps_first, self._most = served, keeps_first, most
        self._silence_s, self._closes = silence_s, closes
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.link = TcpLink(Endpoint("127.0.0.1", self._listener.getsockname()[1]))
        self._open: list[socket.socket] = []
        self._threads = [Thread(target=self._accept)]

    def __enter__(self) -> NetworkSlave:
        self._threads[0].start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for one in list(self._open):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()

    def _accept(self) -> None:
        for _ in range(self._most):
            try:
                connected, _ = self._listener.accept()
            except OSError:
                return
            self._open.append(connected)
            self._threads.append(Thread(target=self._serve, args=(connected,)))
            self._threads[-1].start()
        self._listener.close()

    def _serve(self, connected: socket.socket) -> None:
        is_ignored = False
        with connected, suppress(OSError):
            connected.settimeout(self._silence_s)
            while True:
                try:
                    raw = connected.recv(4096)
                except TimeoutError:
                    if self._closes:
                        break
                    is_ignored = True
                    connected.settimeout(None)
                    continue
                if not raw:
                    break
                if not is_ignored and self._is_served(connected):
                    connected.sendall(self._answers(raw))
        self._open.remove(connected)

    def _is_served(self, connected: socket.socket) -> bool:
        some = self._open[: self._served] if self._keeps_first else self._open[-self._served :]
        return connected in some

    def _answers(self, raw: bytes) -> bytes:
        response = self._device.respond(raw[6], raw[7:12], 0)
        assert response is not None
        return raw[:4] + (len(response.pdu) + 1).to_bytes(2) + raw[6:7] + response.pdu


def on_a_line(stack: ExitStack, profile: Profile, **faults: int) -> Conformance:
    """The test of a slave with these faults."""
    line = stack.enter_context(VirtualLine(ends=2, format=SLOW))
    stack.enter_context(LineSlave(line.ports[0], profile, **faults))  # type: ignore[arg-type]
    link = SerialLink(line.ports[1], SLOW)
    wire = stack.enter_context(open_wire(link, int(PATIENCE_S * 1e9), 0))
    return Conformance(profile, link, wire, UNIT)


def on_a_network(
    stack: ExitStack, profile: Profile, *, silence_s: float = 60, **faults: int
) -> tuple[Conformance, TcpWire]:
    slave = stack.enter_context(
        NetworkSlave(profile, silence_s=silence_s, **faults)  # type: ignore[arg-type]
    )
    wire = stack.enter_context(open_wire(slave.link, 2_000_000_000, 0))
    assert isinstance(wire, TcpWire)
    return Conformance(profile, slave.link, wire, UNIT, silent_ns=300_000_000), wire


def below_and_above(
    profile: Profile, silence_ns: float, *, deaf: int = 0, made_ns: int = 0
) -> list[tuple[Result, str]]:
    """The results of the cases with a pause below and above t1.5 inside a frame."""
    wire = SlaveInMemory(profile, UNIT, silence_ns=silence_ns, deaf=deaf, made_ns=made_ns)
    work = Conformance(profile, SerialLink("/dev/line", SLOW), wire, UNIT)
    cases = list(work.pauses_inside(SLOW))
    assert [one.name for one in cases] == [
        f"a frame with a pause of {word} than t1.5 inside" for word in ("less", "more")
    ]
    return [(one.result, one.problem) for one in cases]


BELOW, BETWEEN, ABOVE = 0.9 * SLOW.t1_5_ns / 2, SLOW.t1_5_ns, 1.1 * SLOW.t3_5_ns
"""Silences (ns) at which a slave divides frames: too early, at t1.5, too late."""


def test_a_slave_that_keeps_t1_5_passes(profile: Profile) -> None:
    assert below_and_above(profile, BETWEEN) == [(Result.PASSED, "")] * 2


def test_a_slave_that_drops_a_frame_with_a_pause_below_t1_5_is_named(profile: Profile) -> None:
    told = "expected 1 value, got no answer"
    assert below_and_above(profile, BELOW)[0] == (Result.FAILED, told)


def test_a_slave_that_is_deaf_after_a_pause_above_t1_5_is_named(profile: Profile) -> None:
    told = "the next 3 right requests got no right answer"
    assert below_and_above(profile, BETWEEN, deaf=3)[1] == (Result.FAILED, told)


def test_a_slave_that_takes_a_frame_with_a_pause_above_t1_5_gets_a_note(profile: Profile) -> None:
    result, problem = below_and_above(profile, ABOVE)[1]
    assert result is Result.NOTE
    assert problem.startswith("expected no answer, got 1 value: it takes two parts")


def test_a_pause_that_the_machine_made_too_long_is_not_judged(profile: Profile) -> None:
    told = "this machine could not make the pause exactly; not judged"
    for result, problem in below_and_above(profile, BETWEEN, made_ns=2 * SLOW.t3_5_ns):
        assert result is Result.NOTE
        assert problem.startswith(told)


@pytest.mark.parametrize(
    ("faults", "result", "problem"),
    [
        ({}, Result.PASSED, ""),
        ({"takes_broadcasts": False}, Result.FAILED, "expected 1 to be read back, got 0"),
        ({"answers_broadcasts": True}, Result.FAILED, "expected no answer, got 06 00 00 00 01"),
    ],
)
def test_a_write_as_broadcast_is_done_and_not_answered(
    stack: ExitStack,
    profile: Profile,
    monkeypatch: pytest.MonkeyPatch,
    faults: dict[str, int],
    result: Result,
    problem: str,
) -> None:
    if "answers_broadcasts" in faults:
        # Until the answer comes, however long a busy machine takes.
        monkeypatch.setattr("mbtool.master.wire.QUIET_NS", int(PATIENCE_S * 1e9))
    case = on_a_line(stack, profile, **faults).broadcast(Table.HOLDING_REGISTERS, 0, 0)
    assert case.result is result
    assert case.problem.startswith(problem)


def test_a_slave_that_serves_many_connections_passes(stack: ExitStack, profile: Profile) -> None:
    work, wire = on_a_network(stack, profile)
    assert work.connections(wire).problem == ""
    assert work.after_silence(wire).problem == ""


def test_a_connection_that_is_open_and_no_longer_served_is_named(
    stack: ExitStack, profile: Profile
) -> None:
    work, wire = on_a_network(stack, profile, served=7)
    case = work.connections(wire)
    told = "the first of 8 stays open, and a request on it got no answer"
    assert (case.result, case.problem) == (Result.FAILED, told)


def test_a_slave_that_accepts_more_connections_than_it_serves_gets_a_note(
    stack: ExitStack, profile: Profile
) -> None:
    work, wire = on_a_network(stack, profile, served=3, keeps_first=True)
    case = work.connections(wire)
    assert case.result is Result.NOTE
    assert case.problem.startswith("number 4 of 8 stays open, and a request on it got no answer")


def test_a_slave_that_is_lost_after_many_connections_is_named(
    stack: ExitStack, profile: Profile
) -> None:
    work, wire = on_a_network(stack, profile, most=8)
    case = work.connections(wire)
    assert case.result is Result.FAILED
    assert "afterwards tcp:127.0.0.1:" in case.problem


def test_a_connection_that_is_deaf_after_a_silence_is_named(
    stack: ExitStack, profile: Profile
) -> None:
    work, wire = on_a_network(stack, profile, silence_s=0.1)
    case = work.after_silence(wire)
    told = "after 300 ms of silence expected 1 value, got no answer"
    assert (case.result, case.problem) == (Result.FAILED, told)


def test_a_connection_that_is_closed_after_a_silence_gets_a_note(
    stack: ExitStack, profile: Profile
) -> None:
    work, wire = on_a_network(stack, profile, silence_s=0.1, closes=True)
    case = work.after_silence(wire)
    told = "it closes a connection that is silent for 300 ms"
    assert (case.result, case.problem) == (Result.NOTE, told)


def test_keep_alive_probes_without_an_answer_are_told(
    stack: ExitStack, profile: Profile, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, wire = on_a_network(stack, profile)

    def no_answer(*_: object) -> bytes:
        raise TimeoutError(ETIMEDOUT, "Connection timed out")

    monkeypatch.setattr("mbtool.master.wire.socket.socket.recv", no_answer)
    with pytest.raises(LinkError, match="no answer to the keep-alive probes of TCP"):
        wire.stay_silent(300_000_000)
