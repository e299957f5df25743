"""Searches for input that is dear to read: python -m tests.adversary.price_search [--help].

Each target of tests/fuzz is a room with a reader: RTU and ASCII lines, streams, captures, packets,
logs, profiles, text logs and so on. Inputs are changed at random; those with the most function
calls, in times of ordinary input, are kept and changed further. Calls are counted, not timed, so a
busy machine finds the same. The dearest input of each target is written into a folder, to become a
case of tests/adversary/prices.py if it costs more than ordinary input by much.
"""

# Ordinary input takes so many calls a byte, or so many a packet and a record: an input may take the
# larger of the two. A packet of few bytes takes as many calls as one of many. The bytes of a serial
# line in packets may also take the calls of an ordinary line.

from __future__ import annotations

import argparse
import random
import sys
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from mbtool.decode.decoder import Decoder
from mbtool.logs.healing import SoundRecords
from mbtool.serial_line import AsciiSplitter, RtuSplitter
from tests.adversary.prices import INPUTS, SHORT_LINE
from tests.adversary.prices import run as decode
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


PARTS = {Decoder.feed.__code__, SoundRecords.read.__code__}
"""What is called once for a packet, and for a record of a log."""
LINES = {RtuSplitter.feed.__code__, AsciiSplitter.feed.__code__}


class Work(NamedTuple):
    """What an input takes."""

    calls: int
    parts: int
    """Packets and records."""
    line_bytes: int
    """Bytes of serial lines."""


def work(run: Callable[[bytes], object], data: bytes) -> Work:
    """Count the function calls that an input takes, and its parts."""
    calls = parts = line_bytes = 0

    def on_call(frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls, parts, line_bytes
        calls += event in ("call", "c_call")
        if event == "call" and frame.f_code in PARTS:
            parts += 1
        elif event == "call" and frame.f_code in LINES:
            line_bytes += len(frame.f_locals["data"])

    sys.setprofile(on_call)
    try:
        run(data)
    finally:
        sys.setprofile(None)
    return Work(calls, parts, line_bytes)


class Search:
    """The search in one target."""

    def __init__(self, name: str, seed: int) -> None:
        self._run = TARGETS[name]
        self._chance = random.Random(f"{name} {seed}")
        self._run(b"")  # What is imported and made once is not counted.
        self._fixed = work(self._run, b"").calls
        self.tried = 0
        first = [data[:MOST_BYTES] for data in seeds(name)]
        for data in first:
            self._run(data)
        took = [(work(self._run, data), len(data)) for data in first if data]
        self._byte = median((one.calls - self._fixed) / size for one, size in took)
        """Calls for a byte of ordinary input: the median of the first inputs."""
        parted = [one for one, _ in took if one.parts and not one.line_bytes]
        self._part = median(
            (one.calls - self._fixed) / one.parts for one in parted or [Work(0, 1, 0)]
        )
        """Calls for a packet or record of ordinary input; 0 or less if it has none."""
        line = INPUTS[SHORT_LINE].make(300)
        self._line_byte = work(lambda data: decode(SHORT_LINE, data), line).calls / len(line)
        self._kept = sorted(((self.price(data), data) for data in first), reverse=True)

    def price(self, data: bytes) -> float:
        """What an input takes, in times of ordinary input."""
        self.tried += 1
        took = work(self._run, data)
        ordinary = max(self._byte * max(len(data), LEAST_BYTES), self._part * took.parts)
        if self._part > 0:
            ordinary += self._line_byte * took.line_bytes
        return (took.calls - self._fixed) / ordinary

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
        """The highest price, in times of ordinary input, and the input that has it."""
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
            f"{name}: {search.tried} inputs; the dearest, {len(data)} bytes, takes {price:.1f} "
            "times the calls of ordinary input"
        )


if __name__ == "__main__":
    main()
