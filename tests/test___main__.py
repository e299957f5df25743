"""The program's first moments, in a process of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_PROGRAM = """
import os, sys, time
number, place, module, *sys.argv[1:] = sys.argv[1:]

def send():
    os.kill(os.getpid(), int(number))

def send_from_a_string():
    exec("send()")

class Object:
    def __del__(self):
        send()

def send_in_a_finalizer():
    Object()
    time.sleep(60)  # Ctrl-C is repeated meanwhile and ends this wait.
    raise SystemExit("Ctrl-C did not end the wait")

class Interrupt:
    # Sends the signal when a module is looked for.
    def find_spec(self, name, path=None, target=None):
        if name == module:
            globals()[place]()

sys.meta_path.insert(0, Interrupt())
from mbtool.__main__ import main
main()
"""
_LINE = (exit_codes.INTERRUPTED, "", "interrupted\n")


def _interrupted(
    number: int,
    module: str,
    place: str = "send",
    form: Sequence[str] = ("-c", _PROGRAM),
    folder: Path | None = None,
) -> tuple[int, str, str]:
    ran = subprocess.run(
        [sys.executable, *form, str(int(number)), place, module, "devices"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        # A shell starts a background job with SIGINT ignored, which the program would inherit.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    return ran.returncode, ran.stdout, ran.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("module", ["mbtool.cli.main", "typer", "mbtool.views.profile"])
def test_a_signal_while_modules_are_loaded_ends_it_with_a_line(number: int, module: str) -> None:
    assert _interrupted(number, module) == _LINE


@pytest.mark.parametrize("module", ["signal", "enum"])
def test_ctrl_c_before_signals_are_handled_ends_it_with_a_line(module: str) -> None:
    assert _interrupted(signal.SIGINT, module) == _LINE


def test_ctrl_c_in_code_from_a_string_does_not_change_the_exit_code(tmp_path: Path) -> None:
    # After such an interruption, python -m would end by SIGINT in place of its exit code.
    (tmp_path / "program.py").write_text(_PROGRAM)
    ran = _interrupted(
        signal.SIGINT, "mbtool.views.profile", "send_from_a_string", ["-m", "program"], tmp_path
    )
    assert ran == _LINE


def test_ctrl_c_that_python_ignores_is_repeated() -> None:
    assert _interrupted(signal.SIGINT, "mbtool.views.profile", "send_in_a_finalizer") == _LINE


def test_without_a_signal_it_runs_the_command() -> None:
    code, output, told = _interrupted(signal.SIGINT, "no.such.module")
    assert (code, told) == (exit_codes.DONE, "")
    assert "fa3-at1m8x" in output


def test_little_is_loaded_before_the_signals_are_handled() -> None:
    program = "import sys, mbtool.__main__; print(*sys.modules)"
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert not {"typing", "threading", "typer", "contextlib"} & set(ran.stdout.split())


def test_can_be_run_as_a_module() -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "mbtool", "--version"], capture_output=True, text=True, check=True
    )
    assert ran.stdout.startswith("mbtool ")


def test_too_little_memory_is_told_in_one_line() -> None:
    program = "import sys, mbtool.__main__; raise MemoryError"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == b"mbtool: this process may use no more memory; see ulimit -v\n"


def test_too_few_open_files_for_a_server_are_told_in_one_line(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    command = ["sniff", "tap:127.0.0.1:0=127.0.0.1:1", "-w", str(tmp_path / "x.mcap")]
    ran = subprocess.run(
        [sys.executable, "-m", "mbtool", *command],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (5, 5)),
    )
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr.count("\n") == 1
