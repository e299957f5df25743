"""Shows which constants matter for reading a serial line: python -m tests.benchmarks.sensitivity.

    --transactions 400   of each cell of the line benchmark
    --seeds 1 2          the benchmark runs once for each
    --only TEXT          only constants whose module or name has this in it
    --jobs N             how many run at the same time
    --json, --markdown   in place of the table

Each numeric constant of mbtool/serial_line is made smaller and larger, one at a time, and the line
benchmark (line.py) runs on the same traffic as without the change: with damages, and with plants.
The table shows by how much the counts differ, added up over all adapters, damages and plants. A
constant whose row says "nothing changes" decides nothing on this traffic.

Constants are found in the sources: upper-case names of modules and classes whose value is a number,
or a tuple of numbers, each of which is varied alone. What is computed from another constant follows
it. Smaller is half and larger is double; but a whole number is at least 1, a share between 0.5 and
1 has its distance from 1 doubled and halved, and 0 becomes -1 and 1.

Each variant runs in a process of its own, in a copy of the tree whose source text has the other
value: so it also holds where other modules have copied it, or have computed something from it.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from tests.mutants import ROOT, Copy
from tests.mutations import ModuleText, Mutation

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

ROOM = "mbtool/serial_line"
NOT_MEASURED = {"ascii": "reads Modbus ASCII", "settings_fit": "finds the settings of a line"}
"""Modules that the line benchmark does not run, with what they do."""
COUNTS = ("found", "false", "wrong", "ambiguous", "transactions")
"""The columns of the table: frames, except for transactions that are told rightly."""
LIMIT_FACTOR, LIMIT_S = 5, 60.0
"""A variant may take LIMIT_FACTOR times as long as no change, and LIMIT_S more."""

Counts = dict[str, int]


@dataclass(frozen=True, slots=True)
class Constant:
    """One number in the sources."""

    module: str
    name: str
    value: float
    smaller: Mutation
    larger: Mutation


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """By how much the counts differ with the smaller and the larger value; None: it failed."""

    constant: Constant
    smaller: Counts | None
    larger: Counts | None

    @property
    def changes(self) -> bool:
        return any(one is None or any(one.values()) for one in (self.smaller, self.larger))

    def as_json(self) -> dict[str, Any]:
        constant = self.constant
        return {
            "constant": constant.name,
            "module": constant.module,
            "value": constant.value,
            "smaller": {"value": float(constant.smaller.after), "effect": self.smaller},
            "larger": {"value": float(constant.larger.after), "effect": self.larger},
        }


def constants(root: Path = ROOT) -> list[Constant]:
    """The numeric constants of the room, in the order of the sources."""
    return [
        constant
        for path in sorted((root / ROOM).glob("*.py"))
        if path.stem not in NOT_MEASURED
        for constant in constants_of(str(path.relative_to(root)), path.read_bytes())
    ]


def constants_of(path: str, source: bytes) -> list[Constant]:
    """The numeric constants of one module and of its classes."""
    text = ModuleText(path, source)
    return list(_constants_in(ast.parse(source).body, text, ""))


def _constants_in(
    statements: Sequence[ast.stmt], text: ModuleText, owner: str
) -> Iterator[Constant]:
    for statement in statements:
        match statement:
            case ast.ClassDef(name=name, body=body):
                yield from _constants_in(body, text, f"{owner}{name}.")
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=ast.expr() as value)
                | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
            ) if name.isupper():
                parts = value.elts if isinstance(value, ast.Tuple) else [value]
                for place, part in enumerate(parts):
                    number = _number(part)
                    if number is not None:
                        index = f"[{place}]" if isinstance(value, ast.Tuple) else ""
                        smaller, larger = (str(one) for one in variants(number))
                        yield Constant(
                            Path(text.path).stem,
                            f"{owner}{name}{index}",
                            number,
                            text.replaced(part, smaller),
                            text.replaced(part, larger),
                        )


def _number(node: ast.expr) -> float | None:
    """The value of an expression that has only numbers in it."""
    for one in ast.walk(node):
        if isinstance(one, ast.Constant):
            if isinstance(one.value, bool) or not isinstance(one.value, int | float):
                return None
        elif not isinstance(one, ast.UnaryOp | ast.BinOp | ast.unaryop | ast.operator):
            return None
    value = eval(compile(ast.Expression(node), "", "eval"))
    return value if isinstance(value, int | float) else None


def variants(value: float) -> tuple[float, float]:
    """The smaller and the larger value to try."""
    if value == 0:
        return -1, 1
    if isinstance(value, int):
        return max(value // 2, 1), 2 * value
    if 0.5 < value < 1:
        return round(1 - 2 * (1 - value), 6), round(1 - (1 - value) / 2, 6)
    return value / 2, value * 2


class Bench:
    """A copy of the tree in which the line benchmark runs."""

    def __init__(self, folder: Path, transactions: int, seeds: Sequence[int]) -> None:
        self._copy = Copy(folder)
        self._transactions = transactions
        self._seeds = seeds

    def counts(self, change: Mutation | None = None, limit_s: float | None = None) -> Counts | None:
        """What the benchmark counts with a change of the sources; None if it fails."""
        if change is None:
            return self._counts(limit_s)
        path = self._copy.root / change.path
        whole = path.read_bytes()
        try:
            self._copy.write(path, change.applied_to(whole))
            return self._counts(limit_s)
        finally:
            self._copy.write(path, whole)

    def _counts(self, limit_s: float | None) -> Counts | None:
        total = dict.fromkeys(COUNTS, 0)
        for seed in self._seeds:
            for kind in ([], ["--plants"]):
                cells = self._cells(seed, kind, limit_s)
                if cells is None:
                    return None
                for cell in cells:
                    for name, count in counts_of(cell).items():
                        total[name] += count
        return total

    def _cells(
        self, seed: int, kind: list[str], limit_s: float | None
    ) -> list[dict[str, Any]] | None:
        """The cells of one run of the line benchmark; None if it fails."""
        command = [sys.executable, "-m", "tests.benchmarks.line", "--json", "--no-peers", *kind]
        command += ["--transactions", str(self._transactions), "--seed", str(seed)]
        try:
            done = subprocess.run(
                command,
                cwd=self._copy.root,
                env={**os.environ, "PYTHONPATH": str(self._copy.root)},
                capture_output=True,
                text=True,
                timeout=limit_s,
                check=True,
            )
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
            return None
        return [json.loads(line) for line in done.stdout.splitlines()]


def counts_of(cell: dict[str, Any]) -> Counts:
    """The columns of the table for one cell of the line benchmark, with a damage or of a plant."""
    if "plant" not in cell:
        return {name: cell[name] for name in COUNTS[:-1]} | {
            "transactions": cell["transactions_right"]
        }
    return {
        "found": cell["frames_found"],
        "false": cell["frames_false"],
        "wrong": cell["sure_amiss"],
        "ambiguous": cell["frames_told"] - cell["sure"] - cell["likely"],
        "transactions": cell["right"],
    }


def measured(
    chosen: Sequence[Constant], transactions: int, seeds: Sequence[int], jobs: int
) -> tuple[Counts, list[Sensitivity]]:
    """The counts without a change, and how each constant changes them."""
    with tempfile.TemporaryDirectory(prefix="sensitivity-") as folder:
        benches: SimpleQueue[Bench] = SimpleQueue()
        for number in range(jobs):
            benches.put(Bench(Path(folder) / str(number), transactions, seeds))
        begun = time.monotonic()
        bench = benches.get()
        base = bench.counts()
        benches.put(bench)
        if base is None:
            sys.exit("the line benchmark fails without any change")
        limit_s = LIMIT_S + jobs * LIMIT_FACTOR * (time.monotonic() - begun)

        def difference(change: Mutation) -> Counts | None:
            bench = benches.get()
            try:
                counts = bench.counts(change, limit_s)
            finally:
                benches.put(bench)
            return counts and {name: counts[name] - base[name] for name in COUNTS}

        with ThreadPoolExecutor(jobs) as pool:
            smaller = pool.map(difference, (one.smaller for one in chosen))
            larger = pool.map(difference, (one.larger for one in chosen))
            found = zip(chosen, smaller, larger, strict=True)
            return base, [Sensitivity(*each) for each in found]


def told(effect: Counts | None) -> str:
    """The counts that differ."""
    if effect is None:
        return "fails"
    return ", ".join(f"{name} {count:+}" for name, count in effect.items() if count) or "-"


def rows(found: Sequence[Sensitivity]) -> list[tuple[str, ...]]:
    """A row for each constant."""
    return [
        (
            one.constant.name,
            one.constant.module,
            f"{one.constant.value:g}",
            *_effects(one),
        )
        for one in found
    ]


def _effects(one: Sensitivity) -> tuple[str, str]:
    if not one.changes:
        return "nothing changes", ""
    smaller, larger = float(one.constant.smaller.after), float(one.constant.larger.after)
    return f"{smaller:g}: {told(one.smaller)}", f"{larger:g}: {told(one.larger)}"


HEADINGS = ("constant", "module", "value", "smaller", "larger")


def markdown(found: Sequence[Sensitivity]) -> str:
    """The table as docs/ has it."""
    lines = [HEADINGS, ("---",) * len(HEADINGS)]
    lines += [(f"`{name}`", *others) for name, *others in rows(found)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def main(arguments: Sequence[str] | None = None) -> None:
    assert __doc__ is not None
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.sensitivity", description=__doc__.partition(":")[0]
    )
    parser.add_argument("--transactions", type=int, default=400, metavar="N")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2], metavar="SEED")
    parser.add_argument("--only", default="", metavar="TEXT")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="a line of JSON for each constant")
    form.add_argument("--markdown", action="store_true", help="a table for docs/rs485.md")
    asked = parser.parse_args(arguments)
    chosen = [one for one in constants() if asked.only in f"{one.module}.{one.name}"]
    if not chosen:
        parser.error(f"--only {asked.only}: no constant has such a name")
    base, found = measured(chosen, asked.transactions, asked.seeds, asked.jobs)
    out = sys.stdout
    if asked.json:
        out.writelines(json.dumps(one.as_json()) + "\n" for one in found)
        return
    in_all = ", ".join(f"{name} {count}" for name, count in base.items())
    without = "; ".join(f"{module}, which {does}" for module, does in NOT_MEASURED.items())
    if asked.markdown:
        out.write(markdown(found) + f"\nWithout a change: {in_all}. Not measured: {without}.\n")
        return
    table = Table(*HEADINGS, box=None, pad_edge=False)
    for row in rows(found):
        table.add_row(*row)
    Console(width=180).print(table)
    out.write(f"without a change: {in_all}; not measured: {without}\n")


if __name__ == "__main__":
    main()
