"""Masters of other makes poll on a virtual line that `mbtool sniff` hears; `check` must say why
requests fail: pymodbus, minimalmodbus, and libmodbus (in mbpoll).

How many requests failed is what each master says itself.
"""

from __future__ import annotations

import json
import subprocess
from contextlib import ExitStack, contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import pytest
import serial
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

import mbtool as api
from mbtool.modbus import rtu_adu
from tests.end_to_end.programs import mbtool, required

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

BAUD = 19200
REQUEST = 8


class RawSlave:
    """Answers reads of its units after their delay (s), in order, whatever else comes.

    A unit with several delays uses them in turn. Each register has its `value`, from 0 to 255. Its
    driver puts the bytes `before` on the line before each answer.
    """

    def __init__(
        self,
        port: str,
        delays: Mapping[int, float | list[float]],
        value: int = 0,
        before: bytes = b"",
    ) -> None:
        self._value = value
        self._before = before
        self._answers = 0
        self._serial = serial.Serial(port, BAUD, timeout=0.02)
        self._delays = delays
        self.asked_units: set[int] = set()
        self._ends = Event()
        self._thread = Thread(target=self._run)

    def __enter__(self) -> RawSlave:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()
        self._serial.close()

    def _run(self) -> None:
        heard = bytearray()
        while not self._ends.is_set():
            heard += self._serial.read(64)
            while (at := _request_at(heard)) is not None:
                unit, quantity = heard[at], int.from_bytes(heard[at + 4 : at + 6])
                del heard[: at + REQUEST]
                self.asked_units.add(unit)
                if unit in self._delays:
                    self._ends.wait(self._delay(unit))
                    pdu = bytes([3, 2 * quantity]) + bytes([0, self._value]) * quantity
                    self._serial.write(self._before + rtu_adu(unit, pdu))

    def _delay(self, unit: int) -> float:
        delay = self._delays[unit]
        if isinstance(delay, float):
            return delay
        self._answers += 1
        return delay[(self._answers - 1) % len(delay)]


def _request_at(heard: bytearray) -> int | None:
    for at in range(len(heard) - REQUEST + 1):
        one = bytes(heard[at : at + REQUEST])
        if one[1] == 3 and rtu_adu(one[0], one[1:-2]) == one:
            return at
    return None


def poll(port: str, units: list[int], cycles: int, *, timeout: float, pause: float) -> int:
    """Ask each unit in turn; return how many requests pymodbus gave up."""
    client = ModbusSerialClient(port, baudrate=BAUD, timeout=timeout, retries=0)
    assert client.connect()
    failed = 0
    for _ in range(cycles):
        for unit in units:
            try:
                failed += client.read_holding_registers(unit, count=4, device_id=unit).isError()
            except ModbusException:
                failed += 1
        Event().wait(pause)
    client.close()  # type: ignore[no-untyped-call]
    return failed


def poll_by_minimalmodbus(
    port: str, units: list[int], cycles: int, *, timeout: float, pause: float
) -> int:
    minimalmodbus = pytest.importorskip("minimalmodbus")
    instruments = [minimalmodbus.Instrument(port, unit) for unit in units]
    instruments[0].serial.baudrate = BAUD
    instruments[0].serial.timeout = timeout
    failed = 0
    for _ in range(cycles):
        for unit, instrument in zip(units, instruments, strict=True):
            try:
                instrument.read_registers(unit, 4)
            except minimalmodbus.ModbusException:
                failed += 1
        Event().wait(pause)
    instruments[0].serial.close()
    return failed


def poll_by_libmodbus(
    port: str, units: list[int], cycles: int, *, timeout: float, pause: float
) -> int:
    """Run mbpoll for each request; it fails if libmodbus got no answer."""
    program = required("mbpoll", "mbpoll")
    options = ["-m", "rtu", "-b", str(BAUD), "-P", "none", "-t", "4", "-0", "-c", "4", "-1", "-q"]
    failed = 0
    for _ in range(cycles):
        for unit in units:
            ask = [program, *options, "-o", str(timeout), "-a", str(unit), "-r", str(unit), port]
            run = subprocess.run(ask, capture_output=True, text=True, check=False, timeout=30)
            failed += run.returncode != 0
        Event().wait(pause)
    return failed


MASTERS = pytest.mark.parametrize(
    "ask",
    [
        poll,
        poll_by_minimalmodbus,
        pytest.param(poll_by_libmodbus, marks=pytest.mark.peers),
    ],
    ids=["pymodbus", "minimalmodbus", "libmodbus"],
)
LASTING_MASTERS = pytest.mark.parametrize(
    "ask", [poll, poll_by_minimalmodbus], ids=["pymodbus", "minimalmodbus"]
)
"""Masters that keep their port open. A new mbpoll takes late bytes that the port still holds for
the answer to its own request, and so counts no failure."""


@contextmanager
def heard(link: str, log: Path) -> Iterator[None]:
    with mbtool("sniff", link, "-w", str(log)) as program:
        program.said.find("listening on .*")
        yield
        assert program.interrupt() == 130, program.said.text


def troubles_of(log: Path) -> list[dict[str, Any]]:
    with mbtool("check", str(log), "--format", "json") as program:
        program.wait()
        told: list[dict[str, Any]] = json.loads(program.printed.text)["troubles"]
    return told


@LASTING_MASTERS
def test_a_slave_slower_than_the_time_out_is_late(ask: Callable[..., int], tmp_path: Path) -> None:
    log = tmp_path / "late.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=3))
        stack.enter_context(RawSlave(line.ports[1], {1: 0.005, 2: 0.3}))
        stack.enter_context(heard(line.link(2), log))
        failed = ask(line.ports[0], [2, 1], 10, timeout=0.2, pause=0.2)
    assert failed >= 8
    (trouble,) = (one for one in troubles_of(log) if one["severity"] == "error")
    assert (trouble["code"], trouble["unit"]) == ("LINE-LATE", 2)
    assert 8 <= trouble["count"] <= failed + 2  # Late answers may spoil polls of unit 1, too.


@LASTING_MASTERS
def test_a_recording_of_23_requests_with_6_late_answers_is_not_green(
    ask: Callable[..., int], tmp_path: Path
) -> None:
    log = tmp_path / "short.mcap"
    delays = [0.35 if number in (3, 7, 11, 14, 17, 20) else 0.01 for number in range(23)]
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=3))
        stack.enter_context(RawSlave(line.ports[1], {1: 0.01, 2: delays}))
        stack.enter_context(heard(line.link(2), log))
        failed = ask(line.ports[0], [2, 1], 23, timeout=0.25, pause=0.15)
    assert failed >= 6
    trouble = troubles_of(log)[0]
    assert (trouble["code"], trouble["unit"], trouble["severity"]) == ("LINE-LATE", 2, "error")
    assert 6 <= trouble["count"] <= failed + 1


@LASTING_MASTERS
def test_a_byte_before_each_answer_is_told_with_its_place(
    ask: Callable[..., int], tmp_path: Path
) -> None:
    log = tmp_path / "bias.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=3))
        stack.enter_context(RawSlave(line.ports[1], {1: 0.01, 2: 0.02}, before=b"\xff"))
        stack.enter_context(heard(line.link(2), log))
        ask(line.ports[0], [1, 2], 10, timeout=0.2, pause=0.02)
    (trouble,) = (one for one in troubles_of(log) if one["code"] == "LINE-BIAS")
    assert "a byte FFH that nobody sends stands before answers" in trouble["cause"]
    assert "a slave's driver is switched on too early" in trouble["cause"]


@MASTERS
def test_a_dead_unit_is_silent_and_the_others_are_well(
    ask: Callable[..., int], tmp_path: Path
) -> None:
    log = tmp_path / "dead.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=3))
        stack.enter_context(RawSlave(line.ports[1], {1: 0.005, 3: 0.01}))
        stack.enter_context(heard(line.link(2), log))
        failed = ask(line.ports[0], [1, 2, 3], 8, timeout=0.2, pause=0.02)
    (trouble,) = (one for one in troubles_of(log) if one["severity"] == "error")
    assert (trouble["code"], trouble["unit"]) == ("UNIT-SILENT", 2)
    assert 0 < trouble["count"] <= failed  # On a busy machine requests to others fail as well.


@MASTERS
def test_a_well_line_is_green(ask: Callable[..., int], tmp_path: Path) -> None:
    log = tmp_path / "well.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=3))
        stack.enter_context(RawSlave(line.ports[1], {1: 0.005, 2: 0.01}))
        stack.enter_context(heard(line.link(2), log))
        failed = ask(line.ports[0], [1, 2], 15, timeout=1.0, pause=0.02)
    assert failed == 0
    assert [one for one in troubles_of(log) if one["severity"] == "error"] == []


def test_two_masters_that_disturb_each_other_are_told(tmp_path: Path) -> None:
    log = tmp_path / "two.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=4))
        stack.enter_context(RawSlave(line.ports[1], {1: 0.01, 2: 0.03, 3: 0.03}))
        stack.enter_context(heard(line.link(2), log))
        other = Thread(
            target=poll, args=(line.ports[3], [3], 60), kwargs={"timeout": 0.15, "pause": 0.05}
        )
        other.start()
        failed = poll(line.ports[0], [1, 2], 40, timeout=0.15, pause=0.07)
        other.join()
    assert failed
    assert "LINE-TWO-MASTERS" in [one["code"] for one in troubles_of(log)]


@LASTING_MASTERS
def test_two_slaves_with_one_address_are_told(ask: Callable[..., int], tmp_path: Path) -> None:
    log = tmp_path / "same.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=4))
        stack.enter_context(RawSlave(line.ports[1], {1: 0.01, 2: 0.01}, value=7))
        stack.enter_context(RawSlave(line.ports[3], {2: 0.05}, value=9))
        stack.enter_context(heard(line.link(2), log))
        ask(line.ports[0], [2, 1], 15, timeout=0.5, pause=0.15)
    trouble = troubles_of(log)[0]
    assert (trouble["code"], trouble["unit"]) == ("LINE-SAME-UNIT", 2)
