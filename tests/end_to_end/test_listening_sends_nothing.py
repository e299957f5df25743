"""Commands that only listen, on a serial line whose other end sees every byte that is sent."""

from __future__ import annotations

import os
import signal
import sys
import tty
from contextlib import suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

import pytest

from tests.cli.program import PATIENCE_S, Program

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks for open files in /proc")

POLL = bytes.fromhex(
    "01 03 0000 0001 840a",
) + bytes.fromhex("01 03 02 0007 f986")
EACH_S = 0.02
ENOUGH = 60
"""So many polls are sent after the port was opened."""


class Line:
    """A pseudo-terminal; the program opens `path`."""

    def __init__(self) -> None:
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self.path = os.ttyname(self._far)
        self.heard = b""
        """What the program has sent."""

    def poll(self) -> None:
        with suppress(BlockingIOError):  # The program does not read yet.
            os.write(self._near, POLL)
        self.listen()

    def listen(self) -> None:
        with suppress(BlockingIOError):
            self.heard += os.read(self._near, 4096)

    def close(self) -> None:
        os.close(self._near)
        os.close(self._far)


@pytest.fixture
def line() -> Iterator[Line]:
    found = Line()
    yield found
    found.close()


def access_modes(pid: int, path: str) -> set[int]:
    """How a process and its children have a file open: os.O_RDONLY, os.O_WRONLY, os.O_RDWR."""
    found = set()
    with suppress(OSError):
        for one in Path(f"/proc/{pid}/fd").iterdir():
            if os.readlink(one) == path:
                flags = Path(f"/proc/{pid}/fdinfo/{one.name}").read_text().split()[3]
                found.add(int(flags, 8) & os.O_ACCMODE)
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for child in children:
            found |= access_modes(int(child), path)
    return found


@pytest.mark.parametrize(
    "command",
    [
        ("sniff", "rtu:{}@19200-8N1"),
        ("sniff", "rtu:{}@auto"),
        ("sniff", "ascii:{}@9600-7E1"),
        ("watch", "rtu:{}@19200-8N1"),
        ("find", "rtu:{}@19200-8N1"),
        ("find", "rtu:{}@auto"),
    ],
    ids=" ".join,
)
def test_a_command_that_listens_can_write_nothing_to_the_port(
    command: tuple[str, ...], line: Line
) -> None:
    near, far = os.openpty()
    words = [word.format(line.path) for word in command]
    with Program(*words, stdin=far, stdout=far, stderr=far) as program:
        os.close(far)
        os.set_blocking(near, False)
        modes: set[int] = set()
        polls = 0
        for _ in range(int(PATIENCE_S / EACH_S)):
            line.poll()
            with suppress(OSError):
                os.read(near, 2**16)  # A terminal that nobody reads would hold it up.
            modes |= access_modes(program.process.pid, line.path)
            polls += bool(modes)
            if polls >= ENOUGH or program.process.poll() is not None:
                break
            Event().wait(EACH_S)
        assert program.process.poll() is None
        program.process.send_signal(signal.SIGINT)
        for _ in range(int(PATIENCE_S / EACH_S)):
            line.listen()
            with suppress(OSError):
                os.read(near, 2**16)
            if program.process.poll() is not None:
                break
            Event().wait(EACH_S)
    os.close(near)
    line.listen()
    assert (line.heard, modes) == (b"", {os.O_RDONLY})


@pytest.mark.parametrize("command", ["doctor", "links"])
def test_a_command_that_looks_at_the_machine_opens_no_port(command: str, line: Line) -> None:
    with Program(command) as program:
        program.process.communicate(timeout=PATIENCE_S)
    line.listen()
    assert line.heard == b""


def test_a_byte_that_is_sent_is_seen(line: Line) -> None:
    with open(line.path, "wb", buffering=0) as port:
        port.write(b"\x01")
        assert access_modes(os.getpid(), line.path) == {os.O_RDWR, os.O_WRONLY}
    line.listen()
    assert line.heard == b"\x01"
