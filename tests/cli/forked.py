"""Runs commands in a broken environment, each in a process forked from this one.

All of mbtool is imported once, so a command costs some tens of milliseconds. Run as a program: the
arguments are a folder for files, and a JSON object that has, by environment, command lines by name.
Prints a JSON object of the same form: for each command its exit code and what it wrote to standard
error.
"""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from typing import TYPE_CHECKING, Any, NoReturn

import mbtool
from mbtool.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

PATIENCE_S = 60.0
IS_RUNNING = b"Ctrl-C"
"""A command that runs until it is stopped says this when it has begun."""
_NOT_IMPORTED = ("__main__", "pytest_plugin", "serial_reader", "serial_relay", "virtual_line_hub")


def _full_output() -> None:
    os.dup2(os.open("/dev/full", os.O_WRONLY), 1)


def _deleted_folder() -> None:
    folder = tempfile.mkdtemp()
    os.chdir(folder)
    os.rmdir(folder)


def _few_files() -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (8, 8))


def _no_file_may_grow() -> None:
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"  # A module would be left cut off.
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))


def _no_process() -> None:
    # No limit binds root, so the call that starts a process is replaced.
    def refused(*_: Any, **__: Any) -> NoReturn:
        raise BlockingIOError(11, os.strerror(11))

    subprocess.Popen.__init__ = refused  # type: ignore[method-assign]


def _strange_variables() -> None:
    os.environ.clear()
    os.environ.update(COLUMNS="x", LINES="-1", LANG="xx", TERM="\x1b", TZ="no", HOME="/no")


ENVIRONMENTS: dict[str, Callable[[], None]] = {
    "full output": _full_output,
    "deleted folder": _deleted_folder,
    "closed input": lambda: os.close(0),
    "closed output": lambda: os.close(1),
    "closed errors": lambda: os.close(2),
    "8 files": _few_files,
    "no file may grow": _no_file_may_grow,
    "no process": _no_process,
    "strange variables": _strange_variables,
}


def run(command: list[str], spoil: Callable[[], None], output: str) -> tuple[int, str]:
    """Run a command; returns its exit code and its standard error."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        _become(command, spoil, output, writing)
    os.close(writing)
    told, end_s, is_stopped = b"", time.monotonic() + PATIENCE_S, False
    while time.monotonic() < end_s:
        if select.select([reading], [], [], 1.0)[0]:
            piece = os.read(reading, 1 << 16)
            told += piece
            if not piece:
                break
        if IS_RUNNING in told and not is_stopped:
            is_stopped = True
            os.kill(child, signal.SIGTERM)
    else:
        os.kill(child, signal.SIGKILL)
    os.close(reading)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), told.decode(errors="replace")


def _become(command: list[str], spoil: Callable[[], None], output: str, errors: int) -> NoReturn:
    code = 99
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
        os.dup2(errors, 2)
        os.closerange(3, 64)
        sys.argv = ["mbtool", *command]
        spoil()
        sys.stdin, sys.stdout, sys.stderr = (_stream(one) for one in range(3))
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 98
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _stream(descriptor: int) -> Any:
    """A standard stream as the interpreter opens it when it starts: None if it is closed."""
    try:
        os.fstat(descriptor)
    except OSError:
        return None
    return open(descriptor, "r" if descriptor == 0 else "w", encoding="utf-8", closefd=False)


if __name__ == "__main__":
    for module in pkgutil.walk_packages(mbtool.__path__, "mbtool."):
        if not module.name.endswith(_NOT_IMPORTED):
            importlib.import_module(module.name)
    folder, commands = sys.argv[1:]
    told: dict[str, dict[str, tuple[int, str]]] = {}
    for name, lines in json.loads(commands).items():
        place = os.path.join(folder, name)
        os.mkdir(place)
        os.chdir(place)
        output = os.path.join(place, "output")
        told[name] = {key: run(line, ENVIRONMENTS[name], output) for key, line in lines.items()}
    print(json.dumps(told))  # noqa: T201 - the result of this program
