"""The program's first moments, in a process of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

from mbtool.cli import exit_codes

_PROGRAM = """
import os, signal, sys
signal_name, module, *sys.argv[1:] = sys.argv[1:]
signal.signal(signal.SIGINT, signal.default_int_handler)  # A shell's background job ignores it.

class Interrupt:
    # Sends the signal when a module is looked for.
    def find_spec(self, name, path=None, target=None):
        if name == module:
            os.kill(os.getpid(), getattr(signal, signal_name))

sys.meta_path.insert(0, Interrupt())
from mbtool.__main__ import main
main()
"""


def _interrupted(signal_name: str, module: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", _PROGRAM, signal_name, module, "devices"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("signal_name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize(
    ("module", "told"),
    [("mbtool.cli.main", ""), ("typer", ""), ("mbtool.views.profile", "interrupted\n")],
)
def test_a_signal_while_modules_are_loaded_ends_it_and_a_command_that_has_begun_says_so(
    signal_name: str, module: str, told: str
) -> None:
    ran = _interrupted(signal_name, module)
    assert (ran.returncode, ran.stdout, ran.stderr) == (exit_codes.INTERRUPTED, "", told)


def test_without_a_signal_it_runs_the_command() -> None:
    ran = _interrupted("SIGINT", "no.such.module")
    assert (ran.returncode, ran.stderr) == (exit_codes.DONE, "")
    assert "fa3-at1m8x" in ran.stdout


def test_can_be_run_as_a_module() -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "mbtool", "--version"], capture_output=True, text=True, check=True
    )
    assert ran.stdout.startswith("mbtool ")
