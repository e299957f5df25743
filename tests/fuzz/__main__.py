"""Fuzzes what reads files, wires and texts: python -m tests.fuzz --minutes N [TARGET...].

With atheris (`pip install atheris`) coverage guides it; without, inputs are mutated at random. An
input that raises is written to tests/fuzz/cases/TARGET/, where a test runs it from then on.
"""

# Each target runs in a process of its own, as atheris never returns. There mbtool is imported only
# by atheris, which notes what code an input reaches. New inputs that reach more
# code are kept in the folder that --corpus names, and tried first the next time.

from __future__ import annotations

import argparse
import hashlib
import importlib
import importlib.util
import os
import random
import re
import resource
import subprocess
import sys
import time
from pathlib import Path

from tests.soak.programs import say

CASES = Path(__file__).parent / "cases"
MAX_BYTES = {
    "rtu": 120,  # Each byte of a line costs a search.
    "ascii": 400,
    "where": 400,
    "link": 200,
    "faults": 2000,
    "image": 2000,
    "csv": 2000,
    "text-log": 4000,
}
TIMEOUT_S = 20
MEMORY_MIB = 2048


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="for each target")
    parser.add_argument("--corpus", type=Path, default=Path(".fuzz"))
    parser.add_argument("--plain", action="store_true", help="without atheris")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("target", nargs="*", metavar="TARGET")
    given = parser.parse_args()
    from_atheris = not given.plain and importlib.util.find_spec("atheris") is not None
    if given.inside:
        (_guided if from_atheris else _plain)(given.target[0], given.corpus, given.minutes * 60)
        return
    targets = _all_targets()
    names = given.target or targets
    unknown = set(names) - set(targets)
    if unknown:
        parser.error(f"no target {', '.join(sorted(unknown))}; there are {', '.join(targets)}")
    if not from_atheris:
        say("without atheris: inputs are mutated at random, and coverage is not looked at")
    is_good = all(_fuzz(name, given) for name in names)
    sys.exit(0 if is_good else 1)


def _all_targets() -> list[str]:
    from tests.fuzz.targets import TARGETS

    return list(TARGETS)


def _fuzz(name: str, given: argparse.Namespace) -> bool:
    """Fuzz one target in a process; print what came of it; True if nothing was found."""
    from tests.fuzz.seeds import seeds

    corpus = given.corpus / name
    corpus.mkdir(parents=True, exist_ok=True)
    (CASES / name).mkdir(parents=True, exist_ok=True)
    for seed in seeds(name):
        _keep(corpus, seed)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "tests.fuzz", "--inside", f"--minutes={given.minutes}"]
    plain = ["--plain"] if given.plain else []
    done = subprocess.run(
        [*command, *plain, f"--corpus={corpus}", name], stderr=subprocess.PIPE, text=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    runs = re.findall(r"stat::number_of_executed_units: (\d+)", done.stderr)
    reached = re.findall(r"cov: (\d+)", done.stderr)
    say(
        f"{name}: {runs[-1] if runs else 'unknown'} inputs in {used_s / 60:.1f} minutes of "
        f"processor time, {len(list(corpus.iterdir()))} kept"
        + (f", {reached[-1]} branches reached" if reached else "")
        + ("" if done.returncode == 0 else f"; FOUND (exit code {done.returncode})")
    )
    if done.returncode:
        say("\n".join(done.stderr.splitlines()[-40:]))
    return done.returncode == 0


def _guided(name: str, corpus: Path, seconds: float) -> None:
    """Fuzz with atheris; never returns."""
    atheris = importlib.import_module("atheris")
    with atheris.instrument_imports(include=["mbtool"]):
        from tests.fuzz.targets import TARGETS
    arguments = [
        f"-max_total_time={max(1, int(seconds))}",
        f"-max_len={MAX_BYTES.get(name, 8000)}",
        f"-timeout={TIMEOUT_S}",
        f"-rss_limit_mb={MEMORY_MIB}",
        f"-artifact_prefix={CASES / name}/",
        f"-report_slow_units={10 * TIMEOUT_S}",  # On a busy machine any input is slow at times.
        "-print_final_stats=1",
        str(corpus),
    ]
    atheris.Setup([sys.argv[0], *arguments], TARGETS[name])
    atheris.Fuzz()


def _plain(name: str, corpus: Path, seconds: float) -> None:
    """Mutate what is in the corpus at random; the first input that raises ends it."""
    from tests.fuzz.targets import TARGETS

    chance = random.Random(time.time_ns())
    known = [path.read_bytes() for path in sorted(corpus.iterdir())] or [b""]
    end_s = time.monotonic() + seconds
    runs = 0
    while time.monotonic() < end_s:
        data = mutated(chance, known)[: MAX_BYTES.get(name, 8000)]
        runs += 1
        try:
            TARGETS[name](data)
        except Exception:
            say(f"found: {_keep(CASES / name, data)}")
            raise
    sys.stderr.write(f"stat::number_of_executed_units: {runs}\n")


def mutated(chance: random.Random, known: list[bytes]) -> bytes:
    data = bytearray(chance.choice(known))
    for _ in range(chance.choice((1, 1, 2, 4, 16))):
        at = chance.randrange(len(data) + 1)
        what = chance.randrange(5)
        if what == 0:
            data[at : at + chance.randrange(9)] = chance.randbytes(chance.randrange(9))
        elif what == 1:
            del data[at : at + chance.randrange(1, 64)]
        elif what == 2:
            other = chance.choice(known)
            begin = chance.randrange(len(other) + 1)
            data[at:at] = other[begin : begin + chance.randrange(64)]
        elif what == 3 and at < len(data):
            data[at] ^= 1 << chance.randrange(8)
        elif at < len(data):
            data[at] = chance.choice((0, 1, 0x20, 0x7F, 0x80, 0xFF))
    return bytes(data)


def _keep(folder: Path, data: bytes) -> Path:
    path = folder / hashlib.sha1(data, usedforsecurity=False).hexdigest()
    path.write_bytes(data)
    return path


if __name__ == "__main__":
    os.environ.setdefault("PYTHONHASHSEED", "0")
    main()
