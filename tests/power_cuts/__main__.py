"""Cuts the power of programs at random moments: python -m tests.power_cuts --cuts 200.

Programs run with a journal of what they write, rename and sync. A simulated disk then keeps what
was synced, and of all else a random part. Ends with exit code 1 if something that was promised is
missing, or if something wrong can be read.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from tests.power_cuts.disk import Disk, Record, records_of
from tests.power_cuts.programs import Cut, Program, Recording, all_programs
from tests.soak.programs import say

if TYPE_CHECKING:
    from collections.abc import Iterator

CUTS_OF_A_RUN = 50


def compiled(folder: Path) -> Path | None:
    """Compile the journal; None where there is no compiler, or no Linux."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or sys.platform != "linux":
        return None
    library = folder / "journal.so"
    source = Path(__file__).with_name("journal.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return library


def cut_often(program: Program, library: Path, cuts: int, seed: int) -> Iterator[str]:
    """Run a program and cut its power so many times; yield what is missing or wrong."""
    chance = random.Random(f"{seed} {program.name}")
    with tempfile.TemporaryDirectory(prefix="power-cuts-") as name:
        work = Path(name).resolve()
        folder, journal = work / "folder", work / "journal"
        folder.mkdir()
        program.prepare(folder)
        before = work / "before"
        shutil.copytree(folder, before)
        inodes = {path.stat().st_ino: path.relative_to(folder) for path in folder.rglob("*")}
        environment = {
            **os.environ,
            "LD_PRELOAD": str(library),
            "POWER_CUTS_FOLDER": str(folder),
            "POWER_CUTS_JOURNAL": str(journal),
        }
        program.run(folder, environment)
