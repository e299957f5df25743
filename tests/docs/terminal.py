"""Runs command lines on a terminal of their own, 80 columns wide, each in a forked process."""

# `mbtool ...` and `python FILE` without anything for a shell run in a fork of this process, which
# has imported all of mbtool once: that costs some tens of milliseconds in place of half a second.
# A variable may stand before them: `TERM=xterm mbtool ...`. Any other line
# runs in bash, where `mbtool` is a script. Output is what the terminal gets, standard output and
# standard error in their order.

from __future__ import annotations

import fcntl
import importlib
import os
import pkgutil
import pty
import re
import runpy
import select
import shlex
import signal
import struct
import sys
import termios
import time
import traceback
from typing import TYPE_CHECKING, NoReturn

import mbtool.cli
import mbtool.views
import mbtool.workflows
from mbtool.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_WITH_NUMPY = {"decode_job", "decode_run"}
PATIENCE_S = 60.0
"""The longest that a command may take; only ends a hang."""
IS_RUNNING = "Ctrl-C"
"""A command that runs until it is stopped says this when it has begun."""
IDLE_S = 0.7
"""While a page is written: no output for so long means that a running command has said all."""
MOST_S = 3.0
_COLUMNS, _ROWS = 80, 40
_ERASED = re.compile(r"[^\n]*\r\x1b\[K")
"""A line that is written anew, as the player's position."""
_COLOUR = re.compile(r"\x1b\[[\d;]*m")
_FOR_THE_SHELL = re.compile(r"[|<>;&$*`]")


def preload() -> None:
    """Import what the commands import when they run, so that no fork has to do it again."""
    # numpy starts threads, which a fork does not have; what needs it imports it in the fork.
    for package in (mbtool.cli, mbtool.workflows, mbtool.views):
        for one in pkgutil.iter_modules(package.__path__):
            if one.name not in _WITH_NUMPY:
                importlib.import_module(f"{package.__name__}.{one.name}")


class Running:
    """One command line on its terminal."""

    def __init__(self, line: str, folder: Path) -> None:
        self.line = line
        self.output = ""
        self.code: int | None = None
        self._process, self._terminal = pty.fork()
        if not self._process:
            _become(line, folder)

    @property
    def whole_lines(self) -> str:
        """The output so far, without a last line that is still being written."""
        return self.output[: self.output.rfind("\n") + 1]

    def read_until(
        self,
        *,
        lines: int | None = None,
        is_begun: bool = False,
        is_enough: Callable[[], bool] = lambda: False,
    ) -> None:
        """Read until the command ends, has printed so many lines or enough, or has begun."""
        end_s = time.monotonic() + PATIENCE_S
        while self.code is None:
            if lines is not None and self.output.count("\n") >= lines:
                return
            if (is_begun and IS_RUNNING in self.output) or is_enough():
                return
            if time.monotonic() > end_s:
                self._send(signal.SIGKILL)
                self.output += f"(killed: it took more than {PATIENCE_S:.0f} s)\n"
                end_s += PATIENCE_S
            self._read(0.2)

    def read_while_it_talks(self) -> None:
        end_s = time.monotonic() + MOST_S
        while self.code is None and time.monotonic() < end_s and self._read(IDLE_S):
            pass

    def interrupt(self) -> None:
        """Send what Ctrl-C sends, and read to the end; the `^C` of the page ends its own line."""
        begun = len(self.output)
        self._send(signal.SIGINT)
        self.read_until()
        self.output = self.output[:begun] + self.output[begun:].removeprefix("\n")

    def _send(self, number: int) -> None:
        os.killpg(self._process, number)

    def _read(self, limit_s: float) -> bool:
        """Read what is there within a time; returns False if nothing was."""
        if not select.select([self._terminal], [], [], limit_s)[0]:
            return False
        try:
            piece = os.read(self._terminal, 1 << 16)
        except OSError:  # Linux: the last process that had the terminal has ended.
            piece = b""
        if piece:
            text = self.output + piece.decode(errors="replace").replace("\r\n", "\n")
            self.output = _COLOUR.sub("", _ERASED.sub("", text))
            return True
        os.close(self._terminal)
        self.code = os.waitstatus_to_exitcode(os.waitpid(self._process, 0)[1])
        return True


def _become(line: str, folder: Path) -> NoReturn:
    """Turn the forked process into the command."""
    code = 99
    try:
        fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", _ROWS, _COLUMNS, 0, 0))
        os.chdir(folder)
        words = shlex.split(line.replace("\\\n", " "), comments=True)
        while re.match(r"[A-Z]+=", words[0]):
            name, _, value = words.pop(0).partition("=")
            os.environ[name] = value
        is_here = words[0] == "mbtool" or (words[0] == "python" and words[1].endswith(".py"))
        if not is_here or _FOR_THE_SHELL.search(re.sub(r"'[^']*'|#.*", "", line)):
            os.execvp("bash", ["bash", "-o", "pipefail", "-c", line])
        sys.argv = words
        sys.stdin, sys.stdout, sys.stderr = (
            open(one, "w" if one else "r", encoding="utf-8", closefd=False)  # noqa: SIM115
            for one in range(3)
        )
        if words[0] == "python":
            sys.argv, sys.path[0] = words[1:], str(folder)
            runpy.run_path(words[1], run_name="__main__")
        else:
            main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 98
    except BaseException:
        # The page has no traceback, so it differs.
        traceback.print_exc()
        code = 97
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)
