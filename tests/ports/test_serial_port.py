"""Opening a port that is there, and saying why another cannot be opened."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import pytest

from mbtool.core import LinkError, SerialFormat, SerialLink
from mbtool.ports.portable_serial import PyserialPort
from mbtool.ports.serial_opening import open_listening, open_passing, open_port
from mbtool.ports.serial_port import IDLE_S, explain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    class Closable(Protocol):
        def close(self) -> None: ...

    Opening = Callable[[str, SerialFormat], Closable]

if sys.platform == "win32":
    pytest.skip("pseudo-terminals need Linux or macOS", allow_module_level=True)

import fcntl

EVEN = SerialFormat(19200, 8, "E", 1)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """The near side of a pseudo-terminal, and the name of its far side, which stays open."""
    near, far = os.openpty()
    yield near, os.ttyname(far)
    os.close(near)
    os.close(far)


def _open_to_speak(port: str, format_: SerialFormat) -> Closable:
    return open_port(SerialLink(port, format_), 0.0)


each_way = pytest.mark.parametrize(
    "open_", [open_listening, open_passing, _open_to_speak], ids=["listen", "pass on", "speak"]
)


@each_way
def test_an_absent_port_is_named_with_those_that_are_there(open_: Opening) -> None:
    with pytest.raises(LinkError, match=r"^serial port /dev/tty-no: is not there; .*here"):
        open_("/dev/tty-no", EVEN)


@pytest.mark.skipif(sys.platform == "win32", reason="no virtual lines on Windows")
def test_an_absent_port_outside_dev_names_the_command_that_lays_a_line() -> None:
    with pytest.raises(LinkError, match=r"is not there; .* while mbtool line \./usb runs; .*here"):
        open_listening("./usb", EVEN)


@each_way
def test_a_file_is_no_serial_port(tmp_path: Path, open_: Opening) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("no port")
    for path in (file, tmp_path, Path(os.devnull)):
        with pytest.raises(LinkError, match=r"is not a serial port; .*here"):
            open_(str(path), EVEN)


@each_way
def test_a_second_user_of_a_port_is_refused(pty: tuple[int, str], open_: Opening) -> None:
    port = open_listening(pty[1], EVEN)
    try:
        with pytest.raises(LinkError, match="is in use by another program; end that one first"):
            open_(pty[1], EVEN)
    finally:
        port.close()
    open_(pty[1], EVEN).close()


@each_way
def test_a_baud_rate_that_the_driver_does_not_do_is_told(
    pty: tuple[int, str], open_: Opening
) -> None:
    with pytest.raises(LinkError, match="its driver does not do 99999999999-8N1; are baud rate"):
        open_(pty[1], SerialFormat(99999999999, 8, "N", 1))


@each_way
def test_an_error_that_the_system_gives_no_reason_for_is_told_as_it_is(
    pty: tuple[int, str], open_: Opening, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.EPIPE, os.strerror(errno.EPIPE))

    monkeypatch.setattr(fcntl, "flock", fail)
    with pytest.raises(LinkError, match=rf"^serial port {pty[1]}: cannot be opened: .*Broken"):
        open_(pty[1], EVEN)


def test_a_port_of_a_group_says_how_to_join_it(tmp_path: Path) -> None:
    file = tmp_path / "port"
    file.touch()
    text = str(explain(str(file), EVEN, PermissionError(errno.EACCES, "Permission denied")))
    assert "permission denied" in text
    assert "usermod -aG" in text or "only root" in text


def test_a_port_that_cannot_be_looked_at_lies_in_a_folder_that_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    forbidden = PermissionError(errno.EACCES, "Permission denied")

    def stat(_path: str) -> os.stat_result:
        raise forbidden

    monkeypatch.setattr("mbtool.ports.serial_port.os.stat", stat)
    text = str(explain("/srv/port", EVEN, forbidden))
    assert text == (
        "serial port /srv/port: permission denied; a folder on the way to it may not be entered: "
        "namei -l /srv/port"
    )


def test_what_the_driver_does_not_do_is_said_with_the_format() -> None:
    text = str(explain("/dev/ttyS0", EVEN, ValueError("Failed to set custom baud rate")))
    assert text == (
        "serial port /dev/ttyS0: its driver does not do 19200-8E1; "
        "are baud rate and character format right?"
    )


@pytest.mark.parametrize(
    "number", [errno.ENOENT, errno.EIO, errno.EBUSY, errno.EINVAL, errno.EPIPE]
)
def test_an_error_is_one_line(number: int) -> None:
    text = str(explain("/dev/null", EVEN, OSError(number, os.strerror(number))))
    assert text.startswith("serial port /dev/null: ")
    assert "\n" not in text


def test_the_portable_port_reads_what_is_there(pty: tuple[int, str]) -> None:
    near, name = pty
    port = PyserialPort(name, SerialFormat(19200, 8, "N", 1))
    try:
        assert port.read(0) == b""
        os.write(near, b"\x01\x03\x00")
        data = b""
        while len(data) < 3:
            data += port.read(IDLE_S)
        assert data == b"\x01\x03\x00"
    finally:
        port.close()


def test_the_portable_port_says_when_it_is_gone() -> None:
    near, far = os.openpty()
    port = PyserialPort(os.ttyname(far), SerialFormat(19200, 8, "N", 1))
    os.close(far)
    os.close(near)
    try:
        with pytest.raises(LinkError, match="lost; is it still plugged in"):
            port.read(IDLE_S)
    finally:
        port.close()
