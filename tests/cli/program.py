"""Runs the command line: in this process where text counts, in one of its own where signals do."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from threading import Event, Timer
from typing import TYPE_CHECKING, Self

from mbtool.cli.main import run
from mbtool.core import Endpoint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    import pytest

PATIENCE_S = 120.0
_COMMAND = [sys.executable, "-c", "from mbtool.cli.main import main; main()"]


@dataclass(frozen=True)
class Said:
    """What a command said, and how it ended."""

    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()


class CommandLine:
    """Runs commands at a width of 100."""

    def __init__(self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("COLUMNS", "100")
        self._capsys = capsys

    def __call__(self, *arguments: object) -> Said:
        self._capsys.readouterr()
        code = run([str(one) for one in arguments])
        out, err = self._capsys.readouterr()
        return Said(code, out, err)


class Program:
    """A command in a process of its own; a context manager whose exit ends it."""

    def __init__(
        self,
        *arguments: object,
        stdin: int = subprocess.DEVNULL,
        stdout: int = subprocess.PIPE,
        stderr: int = subprocess.PIPE,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.process = subprocess.Popen(
            [*_COMMAND, *map(str, arguments)],
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            text=True,
            env={**os.environ, "COLUMNS": "100", **(environment or {})},
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self.process:
            self.process.kill()

    def await_said(self, word: str) -> str:
        """The first line on standard error that has a word in it."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            if word in line:
                return line
        raise AssertionError(f"ended without saying {word!r}")

    def end(self, signal_number: int | None = None) -> Said:
        """Send a signal, if one is given, and wait for the end."""
        if signal_number is not None:
            self.process.send_signal(signal_number)
        # communicate() would lose what a readline() before it has buffered.
        alarm = Timer(PATIENCE_S, self.process.kill)
        alarm.start()
        try:
            out = self.process.stdout.read() if self.process.stdout is not None else ""
            err = self.process.stderr.read() if self.process.stderr is not None else ""
            return Said(self.process.wait(), out, err)
        finally:
            alarm.cancel()


def said(*arguments: object, environment: Mapping[str, str] | None = None) -> Said:
    """Run a command in a process of its own to its end."""
    with Program(*arguments, environment=environment) as program:
        return program.end()


def endpoint_in(text: str) -> Endpoint:
    """The first loopback address with a port in what a command says."""
    match = re.search(r"127\.0\.0\.1:(\d+)", text)
    assert match is not None, text
    return Endpoint("127.0.0.1", int(match[1]))


@contextmanager
def full_pipe() -> Iterator[tuple[int, int]]:
    """Yield both ends of a pipe that is full: the end to read, and the end to write."""
    reading, writing = os.pipe()
    try:
        _fill(writing)
        yield reading, writing
    finally:
        os.close(reading)
        os.close(writing)


@contextmanager
def full_terminal() -> Iterator[int]:
    """Yield a terminal that takes no more text, as one that is stopped with Ctrl-S."""
    reading, writing = os.openpty()
    try:
        _fill(writing)
        yield writing
    finally:
        os.close(reading)
        os.close(writing)


def _fill(descriptor: int) -> None:
    os.set_blocking(descriptor, False)
    with suppress(BlockingIOError):
        while True:
            os.write(descriptor, bytes(4096))
    os.set_blocking(descriptor, True)


def patient() -> Callable[[], bool]:
    """What tells the reader of a growing log to look again; fails when it would take too long."""
    deadline = time.monotonic() + PATIENCE_S
    pause = Event()

    def wait() -> bool:
        assert time.monotonic() < deadline, "the log does not get what it should have"
        pause.wait(0.05)
        return True

    return wait
