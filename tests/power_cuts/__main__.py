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

from tests.power_cuts.disk import Disk, records_of
from tests.power_cuts.programs import Cut, Program, Recording, all_programs
from tests.soak.programs import say

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


def cut_often(program: Program, library: Path, cuts: int, seed: int) -> list[str]:
    """Run a program and cut its power so many times; return what is missing or wrong."""
    chance = random.Random(f"{seed} {program.name}")
    with tempfile.TemporaryDirectory(prefix="power-cuts-") as name:
        work = Path(name).resolve()
        folder, journal = work / "folder", work / "journal"
        folder.mkdir()
        program.prepare(folder)
        disk, final = Disk(folder), Disk(folder)
        environment = {
            **os.environ,
            "LD_PRELOAD": str(library),
            "POWER_CUTS_FOLDER": str(folder),
            "POWER_CUTS_JOURNAL": str(journal),
        }
        program.run(folder, environment)
        records = records_of(journal.read_bytes())
        for record in records:
            final.note(record)
        moments = sorted(
            [len(records), *(chance.randint(0, len(records)) for _ in range(cuts - 1))]
        )
        told: list[bytes] = []
        wrong = []
        done = 0
        for number, moment in enumerate([*moments, len(records)]):
            for record in records[done:moment]:
                disk.note(record)
                if record.kind == "S":
                    told.append(record.data)
            done = moment
            image = work / f"image-{number}"
            places = disk.cut(chance, image)
            ns = records[min(moment, len(records) - 1)].ns
            cut = Cut(disk, final, places, image, ns, told, is_over=moment == len(records))
            wrong += [f"cut at {moment} of {len(records)}: {one}" for one in program.wrong(cut)]
            shutil.rmtree(image)
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cuts", type=int, default=200, help="of each program")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    is_good = True
    with tempfile.TemporaryDirectory() as name:
        library = compiled(Path(name))
        if library is None:
            sys.exit("there is no C compiler, or this is not Linux")
        for program in all_programs():
            wrong = []
            runs = range(0, given.cuts, CUTS_OF_A_RUN)
            for first in runs:
                count = min(CUTS_OF_A_RUN, given.cuts - first)
                wrong += cut_often(program, library, count, given.seed + first)
            say(f"{program.name}: {given.cuts} cuts in {len(runs)} runs, {len(wrong)} wrong")
            if isinstance(program, Recording):
                say(
                    f"  {program.promised} items were promised; a sync began at most "
                    f"{program.longest_ns / 1e9:.2f} s after a write"
                )
            for one in wrong[:10]:
                say(f"  WRONG {one}")
            is_good = is_good and not wrong
    sys.exit(0 if is_good else 1)


if __name__ == "__main__":
    main()
