"""Prints how well types of generated devices are judged.

`python -m tests.adversary.values [--devices 20] [--seed TEXT]`; by default, the hash of the last
commit draws the devices.
"""

from __future__ import annotations

import argparse
import subprocess

from tests.adversary.values.measuring import measure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=20)
    parser.add_argument("--seed")
    parser.add_argument("--wrong", action="store_true", help="Print every wrong judgement.")
    chosen = parser.parse_args()
    seed = (
        chosen.seed
        or subprocess.run(
            ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True
        ).stdout.strip()
    )
    found = measure([f"{seed}-{number}" for number in range(chosen.devices)])
    print(f"seed {seed}, {chosen.devices} devices, {found.values} values")
    print(
        f"can be known: {found.known}; right {_share(found.known_right, found.known)}, of them "
        f"sure {_share(found.known_sure, found.known)}"
    )
    print(f"all values: right {_share(found.right, found.values)}")
    print(
        f"judged: {found.judged}, sure {found.sure}; sure and wrong {found.sure_wrong} "
        f"{_share(found.sure_wrong, found.judged)}"
    )
    if chosen.wrong:
        print(*found.wrong, sep="\n")


def _share(some: int, of: int) -> str:
    return f"{some} ({100 * some / of:.1f} %)" if of else "0"


main()
