"""Runs the installed `mbtool`, and programs of others, as processes that a test can wait for."""

# What a process prints is collected by a thread for each stream, so no pipe fills up, and a test
# waits for a line instead of for a time. Every wait is bounded and fails with all that was said.

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from threading import Condition, Thread
from typing import IO, TYPE_CHECKING, Any, Self

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

PATIENCE_S = 120.0
MBTOOL = str(Path(sys.executable).with_name("mbtool"))
_ENVIRONMENT = {**os.environ, "NO_COLOR": "1", "COLUMNS": "160", "PYTHONWARNINGS": "error"}


class Program:
    """One process; a context manager whose exit kills what a test has left running."""

    def __init__(self, *command: str) -> None:
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=_ENVIRONMENT,
        )
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self.printed = Lines(self.process.stdout)
        self.said = Lines(self.process.stderr)

    def interrupt(self) -> int:
        """Ctrl-C, and the exit code that it brings."""
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def wait(self, limit_s: float = PATIENCE_S) -> int:
        """The exit code, once the process has ended and all it printed is collected."""
        code = self.process.wait(limit_s)
        self.printed.finish()
        self.said.finish()
        return code

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.wait()


class Lines:
    """The lines of a stream, as they come."""

    def __init__(self, stream: IO[str]) -> None:
        self._lines: list[str] = []
        self._is_over = False
        self._changed = Condition()
        self._thread = Thread(target=self._collect, args=(stream,), daemon=True)
        self._thread.start()

    @property
    def text(self) -> str:
        with self._changed:
            return "".join(self._lines)

    def find(self, pattern: str) -> re.Match[str]:
        """The first match in a line; waits for it."""
        self._until(lambda: any(re.search(pattern, line) for line in self._lines), pattern)
        return next(filter(None, (re.search(pattern, line) for line in self._lines)))

    def take(self, count: int) -> list[str]:
        """All lines so far; waits until there are so many."""
        self._until(lambda: len(self._lines) >= count, f"{count} lines")
        with self._changed:
            return list(self._lines)

    def finish(self) -> None:
        self._thread.join(PATIENCE_S)

    def _until(self, holds: Callable[[], bool], what: str) -> None:
        with self._changed:
            self._changed.wait_for(lambda: holds() or self._is_over, PATIENCE_S)
            assert holds(), f"waited for {what}; there is only:\n{''.join(self._lines)}"

    def _collect(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                with self._changed:
                    self._lines.append(line)
                    self._changed.notify_all()
        with self._changed:
            self._is_over = True
            self._changed.notify_all()


def mbtool(*arguments: str) -> Program:
    """A command of the installed program."""
    return Program(MBTOOL, *arguments)


def run_mbtool(*arguments: str) -> str:
    """What a command that ends by itself prints; fails unless it exits with 0."""
    with mbtool(*arguments) as program:
        code = program.wait()
        assert code == 0, program.said.text
        return program.printed.text


def decoded(path: Path, *options: str) -> list[dict[str, Any]]:
    """What `mbtool decode` reads in a file: a dictionary for each line."""
    lines = run_mbtool("decode", str(path), "--format", "jsonl", *options).splitlines()
    return [json.loads(line) for line in lines]


def sniffing(*arguments: str) -> Program:
    """`mbtool sniff`, once it listens. It prints a line of JSON for each transaction."""
    return _once_it_says("listening on", mbtool("sniff", *arguments, "--format", "jsonl"))


def answering(*arguments: str) -> Program:
    """`mbtool slave` or `mbtool replay`, once it answers."""
    return _once_it_says("Ctrl-C ends", mbtool(*arguments))


def _once_it_says(pattern: str, program: Program) -> Program:
    with ExitStack() as stack:
        stack.enter_context(program)
        program.said.find(pattern)
        stack.pop_all()
    return program


def tcp_port(program: Program) -> int:
    """Where a program that was given port 0 says that it listens."""
    return int(program.said.find(r"(?:tcp|tap):127\.0\.0\.1:([1-9]\d*)")[1])


def required(program: str, package: str) -> str:
    """A program of a Debian package; skips where it is not installed."""
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"needs {program}: apt install {package}")
    return path


def wanted(record: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """Some of the fields of a decoded line; a field that is absent stays absent."""
    return {key: record[key] for key in keys if key in record}
