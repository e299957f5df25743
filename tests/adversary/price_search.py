"""Searches for input that is dear to read: python -m tests.adversary.price_search [--help].

Each target of tests/fuzz is a room with a reader: RTU and ASCII lines, streams, captures, packets,
logs, profiles, text logs and so on. Inputs are changed at random; those with the most function
calls for a byte are kept and changed further. Calls are counted, not timed, so a busy machine finds
the same. The dearest input of each target is written into a folder, to become a case of
tests/adversary/prices.py if it costs more than ordinary input by much.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from tests.fuzz.__main__ import mutated
from tests.fuzz.seeds import seeds
from tests.fuzz.targets import TARGETS
from tests.soak.programs import say

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

MOST_BYTES = 4000
LEAST_BYTES = 400
"""Fewer bytes count as so many, since the fixed cost of an input is not what is looked for."""
KEPT = 40
"""So many of the dearest inputs are changed further."""


def calls(run: Callable[[bytes], None], data: bytes) -> int:
    """The number of function calls that an input takes."""
    count = 0

    def on_call(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(on_call)
    try:
        run(data)
    finally:
        sys.setprofile(None)
    return count


class Search:
    """The search in one target."""

    def __init__(self, name: str, seed: int) -> None:
        self._run = TARGETS[name]
        self._chance = random.Random(f"{name} {seed}")
        self._run(b"")  # What is imported and made once is not counted.
        self._fixed = calls(self._run, b"")
        self.tried = 0
        first = [data[:MOST_BYTES] for data in seeds(name)]
        self._kept = sorted(((self.price(data), data) for data in first), reverse=True)
        self.ordinary = median(
            price * max(len(data), LEAST_BYTES) / len(data) for price, data in self._kept if data
        )
        """Calls for a byte of ordinary input: the median of the first inputs."""

    def price(self, data: bytes) -> float:
        """Calls for a byte."""
        self.tried += 1
        return (calls(self._run, data) - self._fixed) / max(len(data), LEAST_BYTES)

    def step(self) -> None:
        """Change one of the dearest inputs, and keep the result if it is dearer than the last."""
        known = [data for _, data in self._kept]
        data = mutated(self._chance, known)
        if data and self._chance.randrange(3) == 0:  # What is dear once is repeated.
            begin = self._chance.randrange(len(data))
            piece = data[begin : begin + self._chance.randrange(1, 300)]
            data = data[:begin] + piece * self._chance.randrange(2, 20) + data[begin:]
        data = data[:MOST_BYTES]
        price = self.price(data)
        if data not in known and (len(known) < KEPT or price > self._kept[-1][0]):
            self._kept = sorted([*self._kept, (price, data)], reverse=True)[:KEPT]

    @property
    def dearest(self) -> tuple[float, bytes]:
        """The most calls for a byte, and the input that takes them."""
        return self._kept[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="processor time of each target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("build/dear"), help="folder of inputs")
    parser.add_argument("target", nargs="*", metavar="TARGET", help=", ".join(TARGETS))
    given = parser.parse_args()
    if unknown := set(given.target) - set(TARGETS):
        parser.error(f"no target {', '.join(sorted(unknown))}; there are {', '.join(TARGETS)}")
    given.keep.mkdir(parents=True, exist_ok=True)
    for name in given.target or TARGETS:
        search = Search(name, given.seed)
        end_s = time.process_time() + given.minutes * 60
        while time.process_time() < end_s:
            search.step()
        price, data = search.dearest
        (given.keep / name).write_bytes(data)
        say(
            f"{name}: {search.tried} inputs; the dearest, {len(data)} bytes, takes {price:.0f} "
            f"calls for a byte, {price / search.ordinary:.1f} times ordinary input"
        )


if __name__ == "__main__":
    main()
