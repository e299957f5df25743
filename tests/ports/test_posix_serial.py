"""A port that is opened read-only."""

from __future__ import annotations

import errno
import os
import select
import struct
import sys
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError, SerialFormat
from mbtool.core.serial_format import ModemLine, ModemLines
from mbtool.ports.serial_opening import open_listening
from tests.sources.live_helpers import PATIENCE_S, stop_marking

if TYPE_CHECKING:
    from collections.abc import Iterator

if sys.platform == "win32":
    pytest.skip("a POSIX port needs Linux or macOS", allow_module_level=True)

import fcntl
import termios

from mbtool.ports.posix_serial import PosixPort

FORMAT = SerialFormat(19200, 8, "E", 1)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    near, far = os.openpty()
    yield near, os.ttyname(far)
    os.close(near)
    os.close(far)


@pytest.mark.parametrize("text", ["19200-8E1", "9600-7E1", "9600-8N2", "115200-8O1", "12345-8N1"])
def test_a_pseudo_terminal_opens_with_any_format(pty: tuple[int, str], text: str) -> None:
    port = PosixPort(pty[1], SerialFormat.parse(text))
    try:
        os.write(pty[0], bytes(range(256)))
        data = b""
        while len(data) < 256:
            piece = port.read(PATIENCE_S)
            assert piece
            data += piece
        assert data == bytes(range(256))
    finally:
        port.close()


def read_bytes(port: PosixPort, count: int) -> bytes:
    data = b""
    while len(data) < count:
        piece = port.read(PATIENCE_S)
        assert piece, f"only {data!r}"
        assert not port.damaged
        data += piece
    return data


@pytest.mark.parametrize("size", [1, 2, 3, 7, 256])
def test_every_byte_value_stays_itself_however_it_is_cut(pty: tuple[int, str], size: int) -> None:
    near, name = pty
    data = bytes(range(256)) + b"\xff\xff\x00\xff\x00\x00\xff\xff\xff"
    port = PosixPort(name, SerialFormat())
    assert port._unmarker is not None
    try:
        for start in range(0, len(data), size):
            piece = data[start : start + size]
            os.write(near, piece)
            assert read_bytes(port, len(piece)) == piece
    finally:
        port.close()


def test_a_full_buffer_of_marks_passes_unchanged(pty: tuple[int, str]) -> None:
    near, name = pty
    data = b"\xff" * 1200 + b"\x00" * 100
    port = PosixPort(name, SerialFormat())
    try:
        os.write(near, data)
        assert read_bytes(port, len(data)) == data
    finally:
        port.close()


def test_a_damaged_byte_is_heard_and_told(pty: tuple[int, str]) -> None:
    near, name = pty
    port = PosixPort(name, SerialFormat())
    try:
        stop_marking(name)
        os.write(near, b"\x01\xff\x00\xf8\x02")
        assert port.read(PATIENCE_S) == b"\x01\xf8\x02"
        assert list(port.damaged) == [1]
        assert port.read(0) == b""
        assert not port.damaged
    finally:
        port.close()


def test_an_escape_that_silence_cuts_off_is_data(pty: tuple[int, str]) -> None:
    near, name = pty
    port = PosixPort(name, SerialFormat())
    try:
        stop_marking(name)
        os.write(near, b"\xff\x00")
        assert port.read(PATIENCE_S) == b"\xff\x00"
    finally:
        port.close()


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for the rate")
@pytest.mark.parametrize("baud", [12345, 19200])
def test_marking_keeps_the_baud_rate(pty: tuple[int, str], baud: int) -> None:
    tcgets2 = 0x802C542A
    port = PosixPort(pty[1], SerialFormat(baud))
    try:
        answer = fcntl.ioctl(port._fd, tcgets2, bytes(44))
        assert struct.unpack("4I20x2I", answer)[4:] == (baud, baud)
        assert termios.tcgetattr(port._fd)[0] & termios.PARMRK
    finally:
        port.close()


def test_a_port_without_counters_says_so(pty: tuple[int, str]) -> None:
    port = PosixPort(pty[1], SerialFormat())
    try:
        assert port.counts() is None
    finally:
        port.close()


def test_tuning_forgets_what_arrived_before(pty: tuple[int, str]) -> None:
    near, name = pty
    port = PosixPort(name, SerialFormat())
    try:
        os.write(near, b"\x55")
        assert port.read(PATIENCE_S) == b"\x55"
        os.write(near, b"\xaa")
        port.tune(SerialFormat(9600, 8, "N", 1))
        assert port.read(0) == b""
        assert termios.tcgetattr(port._fd)[4] == termios.B9600
        with pytest.raises(LinkError, match="does not do"):
            port.tune(SerialFormat(99999999999, 8, "N", 1))
    finally:
        port.close()


def test_a_baud_rate_beyond_any_port_is_an_error(pty: tuple[int, str]) -> None:
    with pytest.raises(LinkError, match="does not do 99999999999-8N1"):
        open_listening(pty[1], SerialFormat(99999999999, 8, "N", 1))


def test_nothing_can_be_written(pty: tuple[int, str]) -> None:
    port = PosixPort(pty[1], SerialFormat())
    try:
        with pytest.raises(OSError, match="Bad file descriptor") as caught:
            os.write(port._fd, b"\x00")
        assert caught.value.errno == errno.EBADF
    finally:
        port.close()


def test_what_came_before_the_opening_is_not_heard(pty: tuple[int, str]) -> None:
    near, name = pty
    first = PosixPort(name, SerialFormat())
    os.write(near, b"\x55")
    assert first.read(PATIENCE_S) == b"\x55"
    os.write(near, b"\xaa")
    port = None
    try:
        first.close()
        port = PosixPort(name, SerialFormat())
        assert port.read(0) == b""
    finally:
        if port is not None:
            port.close()


def test_silence_gives_no_bytes(pty: tuple[int, str]) -> None:
    port = PosixPort(pty[1], SerialFormat())
    try:
        assert port.read(0.001) == b""
    finally:
        port.close()


def test_a_port_that_goes_away_is_an_error() -> None:
    near, far = os.openpty()
    port = open_listening(os.ttyname(far), SerialFormat())
    os.close(far)
    os.close(near)
    try:
        with pytest.raises(LinkError, match="lost; is it still plugged in"):
            port.read(PATIENCE_S)
    finally:
        port.close()


def test_a_failed_opening_leaves_no_descriptor(tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.mktemp("port") / "file"
    file.touch()
    before = os.dup(0)
    os.close(before)
    with pytest.raises(LinkError, match="is not a serial port"):
        PosixPort(str(file), SerialFormat())
    after = os.dup(0)
    os.close(after)
    assert after == before


def test_a_port_is_raw_while_it_is_opened_and_echoes_nothing(pty: tuple[int, str]) -> None:
    near, far = pty
    with open(far, "rb", buffering=0) as cooked:
        settings = termios.tcgetattr(cooked.fileno())
        settings[3] |= termios.ECHO | termios.ICANON
        termios.tcsetattr(cooked.fileno(), termios.TCSANOW, settings)
        with closing(PosixPort(far, FORMAT)):
            os.write(near, b"\1\2\3")
            assert select.select([near], [], [], 0) == ([], [], [])


def test_lines_that_a_driver_cannot_switch_are_told(pty: tuple[int, str]) -> None:
    with pytest.raises(LinkError, match="does not switch RTS off; leave out --rts off"):
        PosixPort(pty[1], FORMAT, ModemLines(rts=ModemLine.OFF))


def test_lines_that_are_kept_are_not_dropped_at_the_end(pty: tuple[int, str]) -> None:
    with closing(PosixPort(pty[1], FORMAT, ModemLines(dtr=ModemLine.KEEP))) as port:
        assert not termios.tcgetattr(port._fd)[2] & termios.HUPCL
