"""Runs a virtual plant with faults, and accounts for every transaction: python -m tests.soak.

A line at 115200 baud with 8 units, some slow or dead, and 20 TCP connections, under sniff, tap,
slave and replay. Ends with exit code 1 if anything is missing or wrong.
"""

# docs/reliability.md says what is counted as what. The plant's own list of what it sent is the
# truth; nothing of mbtool's decoder is used to make it.

from __future__ import annotations

import argparse
import os
import random
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from tests.soak.accounts import FAILURES, Told, Verdict, account, count_messages, decoded, events_of
from tests.soak.faults import Faults
from tests.soak.plant import Plant
from tests.soak.programs import Running, left_over, locked_files, say

if TYPE_CHECKING:
    from collections.abc import Iterator

WARM_UP_S = 120.0
"""By then each kind of fault has happened once; what it took is used again."""
SAMPLE_S = 2.0
BETWEEN_S = (3.0, 8.0)
MOST_GROWTH = 0.05


class Memory:
    """Samples of the memory of programs that run all the time."""

    def __init__(self, programs: dict[str, Running]) -> None:
        self._programs = programs
        self._begin_s = time.monotonic()
        self.samples: dict[str, list[tuple[float, int]]] = {name: [] for name in programs}

    def look(self) -> None:
        at_s = time.monotonic() - self._begin_s
        for name, program in self._programs.items():
            self.samples[name].append((at_s, program.memory))

    def growth(self) -> dict[str, tuple[float, float]]:
        """By program: MiB after WARM_UP_S, and the part by which it has grown at the end."""
        grown = {}
        for name, samples in self.samples.items():
            later = [size for at_s, size in samples if at_s >= WARM_UP_S]
            if len(later) >= 10:
                first, last = statistics.median(later[:5]), statistics.median(later[-5:])
                grown[name] = first / 2**20, last / first - 1
        return grown


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="a new folder for the logs, which then stay")
    given = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="soak-")) if given.keep is None else given.keep
    folder.mkdir(exist_ok=True)
    try:
        is_good = soak(folder, given.minutes * 60, given.seed)
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)
    sys.exit(0 if is_good else 1)


def soak(folder: Path, seconds: float, seed: int) -> bool:
    """Run for so many seconds, print what came of it; True if nothing is amiss."""
    plant = Plant(folder, random.Random(seed))
    try:
        plant.start()
        faults = Faults(plant, random.Random(seed))
        memory = Memory(
            {"steady sniff": plant.steady, "slave": plant.slave, "replay": plant.replay}
        )
        run(faults, memory, random.Random(seed), seconds)
        plant.end()
    finally:
        for one in Running.started:
            one.end()
        plant.disk.close()
    troubles = [*_accounted(plant, faults), *_grown(memory), *_left(plant, folder)]
    for trouble in troubles:
        say(f"TROUBLE {trouble}")
    say("everything is accounted for" if not troubles else f"{len(troubles)} troubles")
    return not troubles


def run(faults: Faults, memory: Memory, chance: random.Random, seconds: float) -> None:
    begin_s = time.monotonic()
    next_s = begin_s + 5
    while (now_s := time.monotonic()) < begin_s + seconds:
        memory.look()
        if now_s >= next_s:
            what = faults.next()
            load = os.getloadavg()[0]
            say(f"{time.monotonic() - begin_s:6.1f} s  {what}  (load {load:.1f})")
            next_s = time.monotonic() + chance.uniform(*BETWEEN_S)
        time.sleep(SAMPLE_S)


def _accounted(plant: Plant, faults: Faults) -> Iterator[str]:
    asked = plant.asked()
    say(f"sent: {len(asked)} requests; {sum(bool(one.response) for one in asked)} were answered")
    for who, lives in plant.lives.items():
        logs = [log for life in lives for log in life.logs]
        say(f"{who}: {len(logs)} logs, {sum(map(count_messages, logs))} messages (stock reader)")
        logged = [one for life in lives for one in decoded(life.logs)]
        told = Told(lives, events_of(logged, ("gap", "discarded")))
        steps = events_of(logged, ("clock-step",))
        if who == "steady" and len(steps) != faults.steps:
            yield f"{faults.steps} steps of the clock, told: {steps}"
        for options in ((), ("--raw",)):
            records = [one for life in lives for one in decoded(life.logs, *options)]
            accounts = account(asked, records, told)
            for link, verdicts in accounts.verdicts.items():
                counts = ", ".join(f"{verdicts[one]} {one}" for one in Verdict if verdicts[one])
                say(f"  {who} {' '.join(options) or 'as logged'}, {link}: {counts}")
                if any(verdicts[one] for one in FAILURES):
                    yield from accounts.failures
            say(f"    times differ from the plant's by {accounts.furthest_ns / 1e9:.2f} s at most")
            yield from (f"invented: {one}" for one in accounts.invented)


def _grown(memory: Memory) -> Iterator[str]:
    for name, (size, grown) in memory.growth().items():
        sizes = " ".join(f"{one / 2**20:.0f}" for _, one in memory.samples[name][::30])
        say(
            f"memory of {name}: {size:.0f} MiB after two minutes, {grown:+.1%} at the end "
            f"(each minute: {sizes})"
        )
        if grown > MOST_GROWTH:
            yield f"{name} has grown by {grown:.1%}"


def _left(plant: Plant, folder: Path) -> Iterator[str]:
    say(f"open files of the steady sniffer: {plant.quiet_files} before, {plant.last_files} after")
    if plant.last_files > plant.quiet_files:
        yield "descriptors are left"
    yield from (f"a process is left: {one}" for one in left_over())
    yield from (f"a lock is left: {one}" for one in locked_files(folder))
    for one in plant.ended:
        # 130: ended by a signal; -9: killed; 3: the disk was full.
        code = one.process.returncode
        if code not in (130, -9, 3) or any("Traceback" in line for line in one.lines):
            yield f"{' '.join(one.command[:2])} ended with {code}: {one.lines[-3:]}"


if __name__ == "__main__":
    main()
