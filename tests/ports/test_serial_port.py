"""Opening a port that is there, and saying why another cannot be opened."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError, SerialFormat
from mbtool.ports.serial_port import IDLE_S, PyserialPort, explain, open_listening

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

EVEN = SerialFormat(19200, 8, "E", 1)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """The near side of a pseudo-terminal, and the name of its far side, which stays open."""
    near, far = os.openpty()
    yield near, os.ttyname(far)
    os.close(near)
    os.close(far)


def test_an_absent_port_is_named_with_those_that_are_there() -> None:
    with pytest.raises(LinkError, match=r"^serial port /dev/tty-no: is not there; .*here"):
        open_listening("/dev/tty-no", EVEN)


def test_a_file_is_no_serial_port(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("no port")
    for path in (file, tmp_path, Path(os.devnull)):
        with pytest.raises(LinkError, match=r"is not a serial port; .*here"):
            open_listening(str(path), EVEN)


def test_a_second_listener_is_refused(pty: tuple[int, str]) -> None:
    port = open_listening(pty[1], EVEN)
    try:
        with pytest.raises(LinkError, match="in use by another program"):
            open_listening(pty[1], EVEN)
    finally:
        port.close()
    open_listening(pty[1], EVEN).close()


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
        with pytest.raises(LinkError, match="lost while reading"):
            port.read(IDLE_S)
    finally:
        port.close()
