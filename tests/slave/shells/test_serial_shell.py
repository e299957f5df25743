"""The serial shell on a virtual line, against a script and against mbpoll."""

from __future__ import annotations

import errno
import shutil
import subprocess
import sys
import termios
import time
from typing import TYPE_CHECKING, Any

import pytest
import serial

from mbtool.core import Direction, LinkError, SerialFormat, SerialLink, UsageError
from mbtool.devices import load_profile
from mbtool.modbus import Adu, Response, Table, ascii_adu, rtu_adu
from mbtool.modbus.response import Distortion
from mbtool.ports.serial_opening import port_in_use
from mbtool.serial_line import RtuSplitter
from mbtool.slave.device import RegisterImage, units_on
from mbtool.slave.families import make_device
from mbtool.slave.shells import SerialSlave
from mbtool.slave.shells.serial_shell import MAX_PENDING, _RequestsOnlyModel
from mbtool.sources.virtual_line import VirtualLine
from tests.slave.scripted import PATIENCE_S, Scripted, echo

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="a virtual line needs Linux or macOS"
)

FAST = SerialFormat(115200, 8, "N", 1)
READ = bytes.fromhex("03 0000 0001")
WRITE = bytes.fromhex("06 0000 1234")


def _only_unit_1(script: Callable[[int, bytes], Response | None] = echo) -> Scripted:
    return Scripted(lambda unit, pdu: script(unit, pdu) if unit == 1 else None)


@pytest.fixture(scope="module")
def line() -> Iterator[VirtualLine]:
    with VirtualLine(format=FAST) as line:
        yield line


@pytest.fixture
def master(line: VirtualLine) -> Iterator[serial.Serial]:
    with serial.Serial(line.ports[0], timeout=PATIENCE_S) as port:
        yield port


def _link(line: VirtualLine, format_: SerialFormat = FAST, *, ascii: bool = False) -> SerialLink:  # noqa: A002
    return SerialLink(line.ports[1], format_, ascii=ascii)


def _ask(master: serial.Serial, pdu: bytes = READ) -> None:
    """One request to an echoing slave, and its answer."""
    adu = rtu_adu(1, pdu)
    master.write(adu)
    assert master.read(len(adu)) == adu


def test_answers_a_request(line: VirtualLine, master: serial.Serial) -> None:
    profile = load_profile("idec-ft1a-touch")
    device = make_device(profile, RegisterImage.of(profile))
    device.image.set(Table.HOLDING_REGISTERS, 0, [0x1234])
    link = _link(line)
    with SerialSlave(link, units_on(link, profile, 1, device)):
        master.write(bytes.fromhex("01 03 0000 0001 840A"))
        assert master.read(7) == bytes.fromhex("01 03 02 1234 B533")


def test_with_strict_timing_two_requests_without_a_silence_get_no_answer(
    line: VirtualLine, master: serial.Serial
) -> None:
    scripted, adu = _only_unit_1(), rtu_adu(1, READ)
    with SerialSlave(_link(line), scripted, strict_timing=True):
        master.write(2 * adu)
        master.timeout = 0.2
        for _ in range(round(PATIENCE_S / master.timeout)):
            master.write(adu)
            if master.read(len(adu)):
                break
    assert scripted.asked == [(1, READ)]


def test_strict_timing_is_for_rtu_lines(line: VirtualLine) -> None:
    with pytest.raises(UsageError, match="strict timing is for RTU lines"):
        SerialSlave(_link(line, ascii=True), _only_unit_1(), strict_timing=True)


def test_equal_writes_in_a_row_are_each_a_request(line: VirtualLine, master: serial.Serial) -> None:
    scripted = _only_unit_1()
    with SerialSlave(_link(line), scripted):
        for _ in range(4):
            _ask(master, WRITE)
    assert scripted.asked == [(1, WRITE)] * 4


@pytest.mark.parametrize("asked", ["05 0000 1234", "08 0002 0001", "08 000A 0001", "01 0300 FFFF"])
def test_a_request_that_no_master_makes_is_one_though_it_has_the_form_of_an_answer(
    line: VirtualLine, master: serial.Serial, asked: str
) -> None:
    scripted = _only_unit_1()
    with SerialSlave(_link(line), scripted):
        for _ in range(2):
            _ask(master, bytes.fromhex(asked))
    assert scripted.asked == [(1, bytes.fromhex(asked))] * 2


def test_a_repeated_request_is_heard_where_the_first_got_no_answer(
    line: VirtualLine, master: serial.Serial
) -> None:
    answers: list[Response | None] = [None, None, Response(WRITE)]
    scripted = _only_unit_1(lambda unit, pdu: answers.pop(0))
    with SerialSlave(_link(line), scripted):
        for times in (1, 2):
            master.write(rtu_adu(1, WRITE))
            scripted.await_asked(times)
        _ask(master, WRITE)


@pytest.mark.parametrize(
    "heard",
    [
        [rtu_adu(2, READ), rtu_adu(2, b"\x03\x02\x12\x34")],
        [rtu_adu(2, WRITE), rtu_adu(2, WRITE)],
        [rtu_adu(2, READ), rtu_adu(2, b"\x83\x02")],
        [rtu_adu(1, READ)[:-1] + b"\x00"],
        [rtu_adu(1, READ)[:5]],
        [bytes(range(200))],
    ],
    ids=["read", "write", "exception", "bad CRC", "torn", "noise"],
)
def test_is_silent_about_others_and_noise(
    line: VirtualLine, master: serial.Serial, heard: list[bytes]
) -> None:
    scripted = _only_unit_1()
    # After the last of these, a silence that gives up the beginning of a frame.
    pauses = [0.005] * (len(heard) - 1) + [0.1]
    with SerialSlave(_link(line), scripted):
        for adu, pause in zip(heard, pauses, strict=True):
            master.write(adu)
            master.timeout = pause + len(adu) * FAST.character_ns / 1e9
            assert master.read(1) == b""
        master.timeout = PATIENCE_S
        _ask(master)
    assert [pdu for unit, pdu in scripted.asked if unit == 1] == [READ]


def test_waits_for_silence_before_it_answers() -> None:
    slow = SerialFormat(1200, 8, "N", 1)
    with (
        VirtualLine(format=slow) as line,
        serial.Serial(line.ports[0], timeout=PATIENCE_S) as master,
        SerialSlave(_link(line, slow), _only_unit_1()),
    ):
        began_ns = time.monotonic_ns()
        master.write(rtu_adu(1, READ))
        assert master.read(1) == b"\x01"
        elapsed_ns = time.monotonic_ns() - began_ns
    # Eight characters, t3.5, and the first character of the answer.
    assert elapsed_ns >= 9 * slow.character_ns + slow.t3_5_ns


def test_takes_as_long_as_the_answer_says(line: VirtualLine, master: serial.Serial) -> None:
    scripted = _only_unit_1(lambda unit, pdu: Response(pdu, 60_000_000))
    with SerialSlave(_link(line), scripted):
        began_ns = time.monotonic_ns()
        _ask(master)
        assert time.monotonic_ns() - began_ns >= 60_000_000


def test_an_answer_is_spoilt_as_it_says(line: VirtualLine, master: serial.Serial) -> None:
    spoiling = Distortion(unit_by=1, pieces=2, gap_ns=30_000_000)
    responder = _only_unit_1(lambda _, pdu: Response(pdu, distortion=spoiling))
    with SerialSlave(_link(line), responder):
        begin = time.monotonic()
        master.write(rtu_adu(1, READ))
        assert master.read(len(rtu_adu(1, READ))) == rtu_adu(2, READ)
        assert time.monotonic() - begin >= 0.03


def test_requests_that_wait_are_bounded(line: VirtualLine, master: serial.Serial) -> None:
    scripted = _only_unit_1(lambda unit, pdu: Response(pdu, 3_600_000_000_000))
    heard: list[Adu] = []
    slave = SerialSlave(_link(line), scripted, on_exchange=lambda adu, answer: heard.append(adu))
    with slave:
        for count in range(1, MAX_PENDING + 1):
            master.write(rtu_adu(1, READ))
            scripted.await_asked(count)
        master.write(rtu_adu(1, READ))
        master.timeout = 0.05
        assert master.read(1) == b""
    assert len(heard) == MAX_PENDING


def test_answers_in_ascii() -> None:
    seven_bits = SerialFormat(9600, 7, "E", 1)
    with (
        VirtualLine(format=seven_bits) as line,
        serial.Serial(line.ports[0], timeout=PATIENCE_S) as master,
        SerialSlave(_link(line, seven_bits, ascii=True), _only_unit_1()),
    ):
        adu = ascii_adu(1, READ)
        master.write(ascii_adu(2, READ) + adu)
        assert master.read(len(adu)) == adu


@pytest.mark.parametrize("format_", ["19200-8E1", "9600-8O1", "9600-8N2", "9600-7E1"])
def test_opens_a_pseudo_terminal_with_any_format(
    line: VirtualLine, master: serial.Serial, format_: str
) -> None:
    with SerialSlave(_link(line, SerialFormat.parse(format_)), _only_unit_1()):
        _ask(master)


def test_opens_the_same_pseudo_terminal_again(line: VirtualLine, master: serial.Serial) -> None:
    for _ in range(3):
        with SerialSlave(_link(line, SerialFormat.parse("19200-8E1")), _only_unit_1()):
            _ask(master)


def test_what_termios_refuses_on_a_pseudo_terminal_is_asked_without_parity(
    line: VirtualLine, master: serial.Serial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some C libraries report EINVAL where a terminal keeps no parity; pyserial lets it pass."""
    set_up = termios.tcsetattr

    def refusing(fd: int, when: int, attributes: list[Any]) -> None:
        if attributes[2] & termios.PARENB:
            raise termios.error(errno.EINVAL, "Invalid argument")
        set_up(fd, when, attributes)

    monkeypatch.setattr(termios, "tcsetattr", refusing)
    with SerialSlave(_link(line, SerialFormat.parse("19200-8E1")), _only_unit_1()):
        _ask(master)


def test_the_hook_sees_requests_and_answers(line: VirtualLine, master: serial.Serial) -> None:
    seen: list[tuple[int, bytes, Response | None]] = []
    slave = SerialSlave(
        _link(line),
        _only_unit_1(),
        on_exchange=lambda adu, answer: seen.append((adu.unit, adu.pdu, answer)),
    )
    with slave:
        master.write(rtu_adu(2, WRITE))
        master.timeout = 0.01
        assert master.read(1) == b""
        master.timeout = PATIENCE_S
        _ask(master)
    assert seen == [(2, WRITE, None), (1, READ, Response(READ))]


def test_a_lost_port_ends_it_with_an_error() -> None:
    with VirtualLine(format=FAST) as line:
        slave = SerialSlave(_link(line), _only_unit_1())
        slave.start()
        slave.wait(0)
    with pytest.raises(LinkError, match=r"^serial port .*: lost"):
        slave.wait(PATIENCE_S)
    slave.stop()


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (OSError(errno.EIO, "gone"), "lost; is it still plugged in"),
        (termios.error(errno.EIO, "gone"), "lost; is it still plugged in"),
        (serial.SerialTimeoutException("full"), "takes no bytes"),
    ],
)
def test_what_an_open_port_raises_is_told(error: Exception, says: str) -> None:
    with (
        pytest.raises(LinkError, match=f"^serial port /dev/a: {says}"),
        port_in_use(SerialLink("/dev/a", FAST)),
    ):
        raise error
    with pytest.raises(KeyError), port_in_use(SerialLink("/dev/a", FAST)):
        raise KeyError


def test_stop_frees_the_port(line: VirtualLine, master: serial.Serial) -> None:
    for _ in range(2):
        slave = SerialSlave(_link(line), _only_unit_1())
        slave.start()
        _ask(master)
        slave.stop()
        slave.stop()
        slave.wait()


def test_a_port_in_use_is_said_to_be(line: VirtualLine) -> None:
    link = _link(line)
    with (
        SerialSlave(link, _only_unit_1()),
        pytest.raises(LinkError, match=f"^serial port {link.port}: is in use by another program"),
    ):
        SerialSlave(link, _only_unit_1()).start()


@pytest.mark.parametrize(
    ("name", "says"), [("absent", "is not there"), ("", "is not a serial port")]
)
def test_what_is_no_port_is_said_to_be(tmp_path: Path, name: str, says: str) -> None:
    link = SerialLink(str(tmp_path / name), FAST)
    with pytest.raises(LinkError, match=f"^serial port {link.port}: {says}"):
        SerialSlave(link, _only_unit_1()).start()


def test_a_file_is_no_port(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(LinkError, match="is not a serial port"):
        SerialSlave(SerialLink(str(file), FAST), _only_unit_1()).start()


@pytest.mark.peers
@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
@pytest.mark.parametrize("baud", [9600, 19200, 115200])
def test_mbpoll_reads_and_writes_all_tables(baud: int) -> None:
    profile = load_profile("idec-ft1a-touch")
    device = make_device(profile, RegisterImage.of(profile))
    format_ = SerialFormat(baud, 8, "N", 1)
    with VirtualLine(format=format_) as line:
        link = _link(line, format_)
        with SerialSlave(link, units_on(link, profile, 1, device)):
            device.image.set(Table.INPUT_REGISTERS, 9, [111, 222])
            device.image.set(Table.DISCRETE_INPUTS, 0, [1, 0, 1])
            assert _mbpoll(line, baud, "-t", "3", "-r", "10", "-c", "2") == ["111", "222"]
            assert _mbpoll(line, baud, "-t", "1", "-r", "1", "-c", "3") == ["1", "0", "1"]
            _mbpoll(line, baud, "-t", "4", "-r", "4095", values=["4660", "22136"])
            _mbpoll(line, baud, "-t", "4", "-r", "1", values=["7"])
            _mbpoll(line, baud, "-t", "0", "-r", "5", values=["1"])
            assert _mbpoll(line, baud, "-t", "4", "-r", "4095", "-c", "2") == ["4660", "22136"]
            assert _mbpoll(line, baud, "-t", "0", "-r", "4", "-c", "3") == ["0", "1", "0"]
    assert device.image.get(Table.HOLDING_REGISTERS, 0) == [7]


def _mbpoll(
    line: VirtualLine, baud: int, *options: str, values: list[str] | None = None
) -> list[str]:
    """Poll once as the master; the values that it prints."""
    command = ["mbpoll", "-m", "rtu", "-a", "1", "-b", str(baud), "-P", "none", "-1", "-o", "2"]
    done = subprocess.run(
        [*command, *options, line.ports[0], *(values or [])],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [row.split("\t")[-1].strip() for row in done.stdout.splitlines() if row.startswith("[")]


def test_the_first_write_of_a_line_is_a_request_right_after_the_silence_behind_it() -> None:
    splitter = RtuSplitter(FAST, _RequestsOnlyModel())
    splitter.feed(rtu_adu(1, WRITE), 0)
    (adu,) = splitter.advance(2 * FAST.t3_5_ns)
    assert isinstance(adu, Adu)
    assert adu.direction is Direction.REQUEST
