"""The programs under test, as processes: what they say, their memory, their open files."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Mapping

MARK = "MBTOOL_SOAK"
"""An environment variable by which processes of this run are found, also those left over."""
RUN = uuid.uuid4().hex
PATIENCE_S = 60.0
_HERE = Path(__file__).parent


class Running:
    """One process of mbtool. Standard error is kept; standard output goes where `stdout` says."""

    started: ClassVar[list[Running]] = []
    """All of them."""

    def __init__(
        self,
        *command: str,
        clock: Path | None = None,
        stdout: int | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        environment = {
            **os.environ,
            **(environment or {}),
            MARK: RUN,
            "NO_COLOR": "1",
            "COLUMNS": "120",
        }
        if clock is not None:
            path = f"{_HERE / 'clock'}:{environment.get('PYTHONPATH', '')}"
            environment |= {"SOAK_CLOCK": str(clock), "PYTHONPATH": path}
        self.command = command
        self.begun_ns = time.time_ns()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "mbtool", *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL if stdout is None else stdout,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            process_group=0,
        )
        self.lines: list[str] = []
        self._said = Event()
        self._reader = Thread(target=self._collect, daemon=True)
        self._reader.start()
        self.started.append(self)

    def _collect(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line.rstrip())
            self._said.set()
        self._said.set()

    def await_line(self, *words: str) -> None:
        """Wait until a line has one of the words. Raises RuntimeError if none comes."""
        end = time.monotonic() + PATIENCE_S
        while not any(word in line for line in list(self.lines) for word in words):
            if self.process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"{self.command}: {self.lines[-5:]}")
            self._said.wait(0.2)
            self._said.clear()

    def end(self, signal_: int = signal.SIGINT) -> int:
        """Send a signal and wait; return the exit code. Kills what does not end."""
        if self.process.poll() is None:
            self.process.send_signal(signal_)
        return self.wait()

    def wait(self, patience_s: float = PATIENCE_S) -> int:
        try:
            code = self.process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self.lines.append(f"did not end within {patience_s} s")
            self.process.kill()
            code = self.process.wait()
        self._reader.join(5)
        return code

    @property
    def memory(self) -> int:
        """Resident memory of the process and its children, in bytes; 0 once it has ended."""
        return sum(_resident(pid) for pid in (self.process.pid, *_children(self.process.pid)))

    @property
    def open_files(self) -> int:
        """How many descriptors the process has open."""
        try:
            return len(os.listdir(f"/proc/{self.process.pid}/fd"))
        except OSError:
            return 0


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def left_over() -> list[str]:
    """The processes of this run that are still there, as text."""
    found = []
    wanted = f"{MARK}={RUN}".encode()
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal() and int(folder.name) != os.getpid():
            try:
                if wanted in (folder / "environ").read_bytes().split(b"\0"):
                    command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                    found.append(f"{folder.name} {command}")
            except OSError:
                continue
    return found


def locked_files(folder: Path) -> list[str]:
    """The files of a folder that some process holds a lock on."""
    locks = Path("/proc/locks").read_text(encoding="ascii").split()
    inodes = {place.rpartition(":")[2] for place in locks if place.count(":") == 2}
    return [str(one) for one in folder.rglob("*") if str(one.lstat().st_ino) in inodes]


def _children(pid: int) -> list[int]:
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    except OSError:
        return []
    return [int(child) for child in text.split()]


def _resident(pid: int) -> int:
    try:
        text = Path(f"/proc/{pid}/statm").read_text(encoding="ascii")
    except OSError:
        return 0
    return int(text.split()[1]) * os.sysconf("SC_PAGE_SIZE")
