"""Measures a decoder on plants: a cell for each plant and adapter, over several seeds."""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from tests.benchmarks.plants.catalog import record
from tests.benchmarks.plants.delivery import Adapter
from tests.benchmarks.plants.examples import described, judged, shortest_failure
from tests.benchmarks.plants.judging import PlantFigures
from tests.benchmarks.plants.through_command import differences

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from tests.benchmarks.plants.examples import Decode
    from tests.benchmarks.plants.recording import Recording

A_LINE = 100
"""How many requests a line has at least, so that what a line must show first is a small part."""
LINES = 10
"""From how many lines the requests of a seed come at most."""


@dataclass(slots=True)
class PlantCell:
    """One plant read by one adapter."""

    plant: str
    adapter: Adapter
    decoder: str
    figures: PlantFigures = field(default_factory=PlantFigures)
    differences: list[str] | None = None
    """Where the command and the class disagree on the first line; None if that was not tried."""
    example: str | None = None
    """A short recording on which the decoder is wrong."""


def lines(plant: str, seeds: Iterable[int], requests: int) -> Iterator[tuple[int, Recording]]:
    """The lines of a plant, each with its own seed."""
    count = max(1, min(LINES, requests // A_LINE))
    for seed in seeds:
        for number in range(count):
            line_seed = seed * 1000 + number
            yield line_seed, record(plant, line_seed, -(-requests // count))


def measure_plant(
    cell: PlantCell, seeds: Sequence[int], requests: int, decode: Decode
) -> PlantCell:
    """Fill a cell with the figures of all its lines."""
    for seed, recording in lines(cell.plant, seeds, requests):
        one = judged(recording, cell.adapter, decode)
        one.misses = [f"seed {seed}, {recording.line}: {miss}" for miss in one.misses]
        cell.figures.add(one)
    return cell


def find_example(cell: PlantCell, seeds: Sequence[int], requests: int, decode: Decode) -> None:
    """Look for the first line on which the decoder is wrong, and shorten it."""
    for seed, recording in lines(cell.plant, seeds, requests):
        short = shortest_failure(recording, cell.adapter, decode)
        if short is not None:
            cell.example = f"seed {seed}\n{described(short, cell.adapter, decode)}"
            return


def compare_command(cell: PlantCell, seeds: Sequence[int], requests: int) -> None:
    """Compare the command with the class on the first line."""
    _, recording = next(lines(cell.plant, seeds, requests))
    with TemporaryDirectory() as folder:
        cell.differences = differences(recording, cell.adapter, Path(folder))


def seeds_from_commit(count: int) -> list[int]:
    """Seeds that nobody chose: drawn from the hash of the checked-out commit."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    commit = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    return drawn_seeds(commit, count)


def drawn_seeds(text: str, count: int) -> list[int]:
    """Seeds drawn from a text, the same for the same text."""
    digests = (hashlib.sha256(f"{text} {number}".encode()).digest() for number in range(count))
    return [int.from_bytes(digest[:3], "big") for digest in digests]
