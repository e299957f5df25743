"""A sniffer in a terminal: Ctrl-Z, and a terminal that is gone."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat, SerialLink
from mbtool.logs import LogReader
from mbtool.sources.virtual_line import VirtualLine
from tests.sources.live_helpers import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LINE = SerialFormat(115200, 8, "N", 1)


class Terminal:
    """A sniffer of a virtual line, in a terminal of its own."""

    def __init__(self, port: str, log: Path, *, ignores_hangup: bool) -> None:
        self._near, far = pty.openpty()
        code = (
            "import fcntl, signal, sys, termios\n"
            "fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
            f"signal.signal(signal.SIGHUP, signal.{'SIG_IGN' if ignores_hangup else 'SIG_DFL'})\n"
            "from mbtool.cli.main import main\n"
            f"sys.argv = ['mbtool', 'sniff', {str(SerialLink(port, LINE))!r}, '-w', {str(log)!r}]\n"
            "main()\n"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=far, stdout=far, stderr=far, start_new_session=True
        )
        os.close(far)
        self.said = ""
        self.wait_for("listening on")

    def type(self, key: bytes) -> None:
        os.write(self._near, key)

    def wait_for(self, text: str) -> None:
        """Read what the sniffer says until a text is in it."""
        while text not in self.said:
            assert select.select([self._near], [], [], PATIENCE_S)[0], self.said
            self.said += os.read(self._near, 4096).decode()

    def hang_up(self) -> None:
        os.close(self._near)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def sniffing_in_terminal(
    log: Path, *, ignores_hangup: bool = False
) -> Iterator[tuple[Terminal, int]]:
    """The sniffer, and a descriptor to write to its line."""
    with VirtualLine(ends=2, format=LINE) as line:
        terminal = Terminal(line.ports[0], log, ignores_hangup=ignores_hangup)
        master = os.open(line.ports[1], os.O_RDWR | os.O_NOCTTY)
        try:
            yield terminal, master
        finally:
            os.close(master)
            terminal.end()


def wait_for_bytes(log: Path, count: int) -> None:
    """Wait until so many bytes of the line are in the log."""
    never = threading.Event()
    for _ in range(int(PATIENCE_S * 20)):
        with LogReader.open(log) as reader:
            if sum(len(getattr(one, "data", b"")) for one in reader.evidence()) >= count:
                return
        never.wait(0.05)
    raise AssertionError("the bytes do not come")


def test_ctrl_z_does_not_stop_a_recording(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    with sniffing_in_terminal(log) as (terminal, master):
        terminal.type(b"\x1a")
        terminal.wait_for("Ctrl-Z does not stop a recording")
        os.write(master, b"12345678")
        wait_for_bytes(log, 8)
        terminal.type(b"\x03")
        assert terminal.process.wait(PATIENCE_S) == 130


def test_a_terminal_that_is_gone_ends_the_recording_with_a_whole_log(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    with sniffing_in_terminal(log) as (terminal, master):
        os.write(master, b"12345678")
        wait_for_bytes(log, 8)
        terminal.hang_up()
        assert terminal.process.wait(PATIENCE_S) == 130
    with LogReader.open(log) as reader:
        assert b"".join(getattr(one, "data", b"") for one in reader.evidence()) == b"12345678"
        assert reader.closed


def test_under_nohup_the_recording_goes_on_without_its_terminal(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    with sniffing_in_terminal(log, ignores_hangup=True) as (terminal, master):
        terminal.hang_up()
        os.write(master, b"12345678")
        wait_for_bytes(log, 8)
        assert terminal.process.poll() is None
        terminal.process.send_signal(signal.SIGTERM)
        assert terminal.process.wait(PATIENCE_S) == 130
