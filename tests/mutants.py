"""Changes the code in small ways and lists the changes that no test notices.

    python -m tests.mutants [ROOM ...] [--count 60] [--seed TEXT] [--jobs N] [--least PERCENT]

A mutation is one small change of one module: `<` becomes `<=`, 7 becomes 8, `and` becomes `or`, a
statement is left out (mutations.py lists all kinds). The program draws `--count` mutations from the
given rooms, applies each alone, and runs the tests of its room. A mutation is killed if a test
fails or if the tests take LIMIT_FACTOR times as long as without it; otherwise it survives.

The same seed draws the same mutations from the same sources; without --seed it is the hash of the
checked-out commit. All is done in temporary copies of the tree, one for each of the jobs that run
at the same time; the checkout is never changed.

A mutation that changes nothing that any caller can see is listed with the reason in
mutants_equivalent.toml, and is left out of the share.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from itertools import count
from pathlib import Path
from queue import SimpleQueue
from random import Random
from typing import TYPE_CHECKING

from tests.captures import FOLDER, public_folder
from tests.mutations import Mutation, enum_members, mutations_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = ROOT / "tests" / "mutants_equivalent.toml"
LIMIT_FACTOR, LIMIT_S = 4, 30.0
"""The tests of a mutant may take LIMIT_FACTOR times as long as without it, and LIMIT_S more."""
MEMORY_BYTES = 4 << 30
"""A mutant that wants more memory is killed: a loop that no longer ends fills a list."""

# Tests outside of tests/ROOM that are about the room.
ALSO = {
    "modbus": ("tests/properties/test_pdus.py",),
    "framing": ("tests/properties/test_streams.py",),
    "serial_line": (
        "tests/properties/test_lines.py",
        "tests/properties/test_ascii_lines.py",
        "tests/golden/test_captures.py",
    ),
    "decode": (
        "tests/properties/test_conversations.py",
        "tests/golden/test_captures.py",
        "tests/columns/test_state.py",
        "tests/adversary/test_network_pairing.py",
        "tests/adversary/test_removal.py",
    ),
    "packets": ("tests/columns/test_state.py", "tests/properties/test_captures.py"),
}

_NOT_COPIED = shutil.ignore_patterns(
    ".git", ".venv", ".hypothesis", ".mypy_cache", ".ruff_cache", ".pytest_cache", "__pycache__"
)
_RUN_TESTS = (
    "import resource, sys, pytest;"
    f"resource.setrlimit(resource.RLIMIT_AS, ({MEMORY_BYTES}, {MEMORY_BYTES}));"
    "sys.exit(pytest.main(sys.argv[1:]))"
)
_OPTIONS = (
    *("-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0"),
    # pytest would load mbtool's own plugin, and with it modules that a copy lacks or has changed.
    *("-p", "no:mbtool.pytest_plugin"),
)


class Fate(StrEnum):
    """What became of a mutation."""

    KILLED = "killed"
    SURVIVED = "survived"
    EQUIVALENT = "equivalent"


@dataclass(frozen=True, slots=True)
class Result:
    """A mutation and its fate."""

    mutation: Mutation
    fate: Fate

    @property
    def room(self) -> str:
        return room_of(self.mutation.path)


def room_of(path: str) -> str:
    """The room of a module: `modbus` for mbtool/modbus/pdu.py."""
    return path.split("/")[1]


def room_tests(path: str, root: Path = ROOT) -> list[str]:
    """The test files of a module's room. Those whose name matches or that import it are first."""
    room, module = room_of(path), Path(path).stem
    own = f"tests/{room}/test_{module}.py"
    files = sorted(str(one.relative_to(root)) for one in (root / "tests" / room).rglob("test_*.py"))

    def rank(file: str) -> tuple[bool, bool]:
        return file != own, f"mbtool.{room}.{module} " not in (root / file).read_text("utf-8")

    return [*sorted(files, key=rank), *(one for one in ALSO.get(room, ()) if (root / one).exists())]


def all_mutations(rooms: Iterable[str], root: Path = ROOT) -> list[Mutation]:
    """Every mutation of the modules of some rooms, in the order of their places."""
    enums = enum_members(root.glob("mbtool/**/*.py"))
    return [
        mutation
        for room in rooms
        for path in sorted((root / "mbtool" / room).rglob("*.py"))
        for mutation in mutations_of(str(path.relative_to(root)), path.read_bytes(), enums)
    ]


def drawn(mutations: Sequence[Mutation], seed: str, size: int) -> list[Mutation]:
    """A random sample; the same for the same seed."""
    return Random(seed).sample(mutations, min(size, len(mutations)))


def equivalents(path: Path = EQUIVALENT) -> dict[tuple[str, str, str, str], str]:
    """Why some mutations change nothing, by file, source line, text before and text after."""
    listed = tomllib.loads(path.read_text("utf-8")).get("mutation", []) if path.exists() else []
    return {
        (one["file"], one["line"].strip(), one["before"], one["after"]): one["reason"]
        for one in listed
    }


class Copy:
    """A temporary copy of the tree, in which one mutation after another is tried."""

    _times = count(1_000_000_000)
    """Each write gets a modification time of its own, so that Python never takes old byte code."""

    def __init__(self, folder: Path, root: Path = ROOT) -> None:
        self.root = folder
        shutil.copytree(root, folder, ignore=_NOT_COPIED, dirs_exist_ok=True)

    def tests_pass(self, tests: Sequence[str], limit_s: float | None = None) -> bool:
        """Run some test files. False if a test fails or the time is over."""
        command = [sys.executable, "-c", _RUN_TESTS, *_OPTIONS, *tests]
        environment = {
            **os.environ,
            "PYTHONPATH": str(self.root),
            "PYTHONDONTWRITEBYTECODE": "",
            FOLDER: str(public_folder()),
        }
        with subprocess.Popen(
            command,
            cwd=self.root,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        ) as process:
            try:
                return process.wait(limit_s) == 0
            except subprocess.TimeoutExpired:
                return False
            finally:  # Also ends what the tests have started.
                _end_session(process.pid)

    def survives(self, mutation: Mutation, tests: Sequence[str], limit_s: float) -> bool:
        """Apply a mutation, run the tests, and put the module back. True if all tests pass."""
        path = self.root / mutation.path
        whole = path.read_bytes()
        try:
            self.write(path, mutation.applied_to(whole))
            return self.tests_pass(tests, limit_s)
        finally:
            self.write(path, whole)

    def write(self, path: Path, data: bytes) -> None:
        """Change a module of this copy."""
        path.write_bytes(data)
        moment = next(self._times)
        os.utime(path, (moment, moment))


def _end_session(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


def limits_s(rooms: Iterable[str], copy: Copy) -> dict[str, float]:
    """How long the tests of each room may take. Exits if they fail without a mutation."""
    limits = {}
    for room in rooms:
        begun = time.monotonic()
        if not copy.tests_pass(room_tests(f"mbtool/{room}/", copy.root)):
            sys.exit(f"{room}: its tests fail without any mutation")
        limits[room] = LIMIT_S + LIMIT_FACTOR * (time.monotonic() - begun)
    return limits


def tried(mutations: Sequence[Mutation], jobs: int, root: Path = ROOT) -> Iterator[Result]:
    """Try mutations, several at the same time; the results come as they are known."""
    known = equivalents()
    for mutation in mutations:
        if mutation.key in known:
            yield Result(mutation, Fate.EQUIVALENT)
    wanted = [mutation for mutation in mutations if mutation.key not in known]
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copies: SimpleQueue[Copy] = SimpleQueue()
        for number in range(jobs):
            copies.put(Copy(Path(folder) / str(number), root))
        copy = copies.get()
        limits = limits_s(sorted({room_of(one.path) for one in wanted}), copy)
        copies.put(copy)

        def one(mutation: Mutation) -> Result:
            copy = copies.get()
            try:
                limit_s = limits[room_of(mutation.path)] * jobs
                lives = copy.survives(mutation, room_tests(mutation.path, copy.root), limit_s)
            finally:
                copies.put(copy)
            return Result(mutation, Fate.SURVIVED if lives else Fate.KILLED)

        with ThreadPoolExecutor(jobs) as pool:
            for done in as_completed([pool.submit(one, mutation) for mutation in wanted]):
                yield done.result()


def report(results: Sequence[Result]) -> str:
    """The share of killed mutations in each room and in all."""
    fates = Counter((room, one.fate) for one in results for room in (one.room, "all"))
    rooms = [*sorted({one.room for one in results}), "all"]
    lines = [f"{'room':14}{'killed':>8}{'survived':>10}{'equivalent':>12}{'share':>9}"]
    for room in rooms:
        killed, survived, equivalent = (fates[room, fate] for fate in Fate)
        share = f"{100 * killed / (killed + survived):.1f} %" if killed + survived else "-"
        lines.append(f"{room:14}{killed:8}{survived:10}{equivalent:12}{share:>9}")
    return "\n".join(lines) + "\n"


def killed_percent(results: Sequence[Result]) -> float:
    """Of those that are not equivalent."""
    fates = Counter(one.fate for one in results)
    counted = fates[Fate.KILLED] + fates[Fate.SURVIVED]
    return 100 * fates[Fate.KILLED] / counted if counted else 100.0


def _commit() -> str:
    command = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def main(arguments: Sequence[str] | None = None) -> int:
    assert __doc__ is not None
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutants", description=__doc__.partition("\n")[0]
    )
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=f"default: {' '.join(ALSO)}")
    parser.add_argument("--count", type=int, default=60, metavar="N")
    parser.add_argument("--seed", help="any text; default: the hash of the commit")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument(
        "--least", type=float, default=0.0, metavar="PERCENT", help="exit with 1 below this share"
    )
    options = parser.parse_args(arguments)
    rooms = options.rooms or list(ALSO)
    for room in rooms:
        if not (ROOT / "mbtool" / room).is_dir():
            parser.error(f"{room}: no such room in mbtool/")
    seed = options.seed or _commit()
    everything = all_mutations(rooms)
    mutations = drawn(everything, seed, options.count)
    print(f"{len(mutations)} of {len(everything)} mutations, seed {seed}", flush=True)  # noqa: T201
    results = []
    for result in tried(mutations, options.jobs):
        results.append(result)
        if result.fate is Fate.SURVIVED:
            print(f"survived: {result.mutation}", flush=True)  # noqa: T201
    print(report(results), end="")  # noqa: T201
    return 0 if killed_percent(results) >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
