"""`mbtool watch` on a virtual line, in a terminal of 80x24."""

from __future__ import annotations

import os
import pty
import select
import shlex
import signal
import subprocess
import tempfile
import tty
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

import mbtool
from mbtool.logs import LogReader
from mbtool.modbus import rtu_adu
from tests.end_to_end.programs import MBTOOL, PATIENCE_S, decoded, required

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

READ = rtu_adu(1, bytes.fromhex("03 0000 0002"))
LOOK_S = 0.1


def until(condition: Callable[[], bool], told: Callable[[], object]) -> None:
    pause = Event()
    for _ in range(round(PATIENCE_S / LOOK_S)):
        if condition():
            return
        pause.wait(LOOK_S)
    raise AssertionError(told())


class LineMaster:
    """Asks the same question on an end of the line, and waits for each answer."""

    def __init__(self, port: str) -> None:
        self._port = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._port)

    def ask(self, times: int) -> None:
        for _ in range(times):
            os.write(self._port, READ)
            answer = b""
            while len(answer) < 9:
                assert select.select([self._port], [], [], PATIENCE_S)[0]
                answer += os.read(self._port, 256)

    def close(self) -> None:
        os.close(self._port)


@contextmanager
def polled_line() -> Iterator[tuple[LineMaster, str]]:
    """A device on a line, its master, and the LINK of an end to listen on."""
    with (
        mbtool.line(ends=3) as line,
        mbtool.Slave("idec-ft1a-touch", on=line.link(1), image={"HR400001": [4660, 17]}),
    ):
        master = LineMaster(line.ports[0])
        yield master, line.link(2)
        master.close()


class Terminal:
    """A terminal of 80x24 in tmux, in which a shell runs one command."""

    def __init__(self, folder: Path, command: str) -> None:
        self._tmux = [required("tmux", "tmux"), "-S", str(folder / "tmux"), "-f", "/dev/null"]
        shell = f"export XDG_CONFIG_HOME={folder}; {command}; echo ended $?; stty -a; sleep 1000"
        self._do("new-session", "-d", "-x", "80", "-y", "24", "sh", "-c", shell)

    def press(self, *keys: str) -> None:
        self._do("send-keys", *keys)

    @property
    def lines(self) -> list[str]:
        return self._do("capture-pane", "-p").split("\n")[:24]

    def until(self, text: str) -> None:
        until(lambda: any(text in line for line in self.lines), lambda: "\n".join(self.lines))

    def close(self) -> None:
        self._do("kill-server")

    def _do(self, *arguments: str) -> str:
        done = subprocess.run([*self._tmux, *arguments], capture_output=True, text=True, check=True)
        return done.stdout


def test_the_screen_shows_the_line_and_the_terminal_is_given_back(tmp_path: Path) -> None:
    required("tmux", "tmux")
    log = tmp_path / "seen.mcap"
    with polled_line() as (master, link), tempfile.TemporaryDirectory() as folder:
        words = [MBTOOL, "watch", link, "-w", str(log), "--device", "1=idec-ft1a-touch"]
        terminal = Terminal(Path(folder), shlex.join(words))
        try:
            terminal.until("1 polls")
            master.ask(5)
            terminal.until("5 transactions")
            (poll,) = (line for line in terminal.lines if "HR400001..400002" in line)
            assert poll.split()[:6] == [
                "1",
                "03",
                "HR400001..400002",
                "4660",
                "17",
                poll.split()[5],
            ]
            assert max(map(len, terminal.lines)) <= 80
            terminal.press("3", "Enter")
            terminal.until("direction by")
            terminal.press("q")
            terminal.until("ended 0")
            terminal.until("icanon")
            (modes,) = (line for line in terminal.lines if "icanon" in line)
            assert "-icanon" not in modes
            assert not any("1 polls" in line for line in terminal.lines)
        finally:
            terminal.close()
    assert len(decoded(log)) == 5


@contextmanager
def watching(folder: Path, *words: str) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """`watch` on a pseudo-terminal that sends it no SIGHUP, and the other end, which nobody reads.

    The context's body closes that end, or the context does.
    """
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "XDG_CONFIG_HOME": str(folder)}
    process = subprocess.Popen(
        [MBTOOL, "watch", *words], stdin=theirs, stdout=theirs, stderr=theirs,
        env=environment, start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    try:
        yield process, ours
    finally:
        process.kill()
        process.wait()
        with suppress(OSError):
            os.close(ours)


def test_a_terminal_that_takes_nothing_costs_no_evidence_and_a_signal_ends_watch(
    tmp_path: Path,
) -> None:
    log = tmp_path / "seen.mcap"
    with polled_line() as (master, link), watching(tmp_path, link, "-w", str(log)) as (process, _):
        until(log.exists, lambda: "no log")
        master.ask(40)
        process.send_signal(signal.SIGTERM)
        until(lambda: len(decoded(log)) == 40, lambda: len(decoded(log)))
        assert process.wait(PATIENCE_S) == 130


def test_a_terminal_that_is_gone_ends_watch_also_without_a_signal(tmp_path: Path) -> None:
    log = tmp_path / "seen.mcap"
    with (
        polled_line() as (master, link),
        watching(tmp_path, link, "-w", str(log)) as (
            process,
            ours,
        ),
    ):
        seen = b""
        while b"polls" not in seen:
            assert select.select([ours], [], [], PATIENCE_S)[0]
            seen += os.read(ours, 65536)
        master.ask(4)
        until(lambda: len(decoded(log)) == 4, lambda: len(decoded(log)))
        os.close(ours)
        assert process.wait(PATIENCE_S) == 130
    with LogReader.open(log) as reader:
        assert sum(1 for _ in reader.evidence())
        assert reader.closed
