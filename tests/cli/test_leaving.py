"""Leaving on a signal."""

from __future__ import annotations

import subprocess
import sys

from mbtool.cli import exit_codes


def test_leaves_without_a_word_and_without_another_line() -> None:
    program = "from mbtool.cli.leaving import leave\ntry:\n leave()\nfinally:\n print(1)"
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stdout, ran.stderr) == (exit_codes.INTERRUPTED, "", "")


def test_little_is_loaded_before_the_signals_are_taken() -> None:
    program = "import sys, mbtool.__main__; print(*sys.modules)"
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert not {"typing", "threading", "typer", "contextlib"} & set(ran.stdout.split())
