"""Tries mbtool on ports with real drivers, in a guest: python -m tests.real_drivers [CHECK...].

Needs the program real-drivers.py, which boots Debian's kernel under QEMU with an 8250 and an FTDI
adapter: beside this repository in shared/real-drivers, or where MBTOOL_REAL_DRIVERS says. Takes
some minutes, most of it for Python in a machine that is interpreted. Exit code 1 if a check fails.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
_BESIDE = PROJECT.parent / "shared/real-drivers/real-drivers.py"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("check", nargs="*", help="only these of in_guest.py")
    parser.add_argument("--timeout", type=float, default=900.0)
    parser.add_argument("--out", type=Path, help="a folder for the logs, which then stay")
    given = parser.parse_args()
    program = Path(os.environ.get("MBTOOL_REAL_DRIVERS") or _BESIDE)
    if not program.exists():
        sys.exit(f"{program} is not there; name real-drivers.py in MBTOOL_REAL_DRIVERS")
    with tempfile.TemporaryDirectory(prefix="real-drivers-") as folder:
        out = given.out or Path(folder)
        command = (
            f"export PYTHONPATH={PROJECT}; cd {PROJECT}; "
            f"python -m tests.real_drivers.in_guest $OUT {' '.join(given.check)}"
        )
        options = ["--out", str(out), "--timeout", str(given.timeout)]
        done = subprocess.run([str(program), str(PROJECT), *options, "--", command], check=False)
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
