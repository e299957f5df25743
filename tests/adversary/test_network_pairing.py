"""The decoder against simulated plants whose captures lack packets or have them in disorder."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from tests.adversary.judgement import decode, judged
from tests.adversary.known_failures import BLAMED, WRONG
from tests.adversary.network import ALL_LOSSES, MASTERS, name_of, simulate

if TYPE_CHECKING:
    import pytest

    from mbtool.devices import NamedTransaction

TOLD = Path(__file__).with_name("told_of_plants.expected.txt")
SEEDS = 2
REQUESTS = 40

CAPTURE_LOSSES = {"response lost", "request lost", "several lost"}

CELLS = [(master, losses) for master in MASTERS for losses in ALL_LOSSES]

Counts = dict[str, int]
Cell = tuple[str, tuple[str, ...]]


def found_in(master: str, losses: tuple[str, ...]) -> tuple[Counts, str]:
    """What is wrong with the transactions of some captures, and what they tell."""
    totals: Counter[str] = Counter()
    told: list[NamedTransaction] = []
    for seed in range(SEEDS):
        simulated = simulate(master, losses, seed, REQUESTS)
        records = decode(simulated.packets)
        totals.update(judged(records, simulated.truth).counts())
        told += records
    return totals, summary(told)


def summary(records: list[NamedTransaction]) -> str:
    """How many transactions have each outcome with its verdicts, their retries and latencies."""
    kinds = Counter(" ".join([one.outcome, *one.verdicts]) for one in records)
    retries = sum(one.retries for one in records)
    latency_us = sum(one.latency_ns or 0 for one in records) // 1000
    parts = [f"{count} {kind}" for kind, count in sorted(kinds.items())]
    return ", ".join([*parts, f"{retries} retries", f"{latency_us} us"])


def test_a_late_response_and_lost_ones_shift_no_later_pair() -> None:
    """A master with one id that takes a late response for the next one is always one ahead."""
    simulated = simulate("connections", ("several lost", "retransmitted"), 20, 60)
    found = judged(decode(simulated.packets), simulated.truth)
    assert (found.wrong, found.blamed, found.unasked) == ([], [], [])


def test_what_is_told_of_lossy_captures_is_right_and_nearly_complete(
    pytestconfig: pytest.Config,
) -> None:
    found = {cell: found_in(*cell) for cell in CELLS}
    counts = {cell: one[0] for cell, one in found.items()}
    # No response is joined with a request that it does not answer.
    assert {cell for cell, one in counts.items() if one["wrong"]} == known(WRONG)
    # Nobody is blamed for what the capture lacks.
    assert {cell for cell, one in counts.items() if one["blamed"] or one["unasked"]} == known(
        BLAMED
    )
    # A silent slave is not excused where the capture is complete.
    complete = [cell for cell in CELLS if "silent" in cell[1] and not CAPTURE_LOSSES & {*cell[1]}]
    assert complete
    assert [cell for cell in complete if counts[cell]["excused"]] == []
    # All pairs of a capture without loss are joined.
    whole = {master: counts[master, ()] for master in MASTERS}
    assert [one for one in whole.items() if one[1]["missing"] or one[1]["undecidable"]] == []

    total = sum((Counter(one) for one in counts.values()), Counter[str]())
    pairs = total["transactions"] - total["undecidable"]
    assert total["missing"] <= pairs / 1000, [cell for cell in CELLS if counts[cell]["missing"]]
    # Few pairs that can be known are told as ambiguous. Of a pipelining master with one id, most
    # pairs behind two losses cannot be proved.
    assert total["doubtful"] <= pairs / 220
    # A plant of which little can be known would test little.
    assert total["undecidable"] < total["transactions"] / 2000

    # A line for each plant: a change of the pairing shows what it is good for, and where not.
    lines = [f"{master}, {name_of(losses)}: {found[master, losses][1]}" for master, losses in CELLS]
    if pytestconfig.getoption("--update-golden"):
        TOLD.write_text("".join(f"{line}\n" for line in lines))
    assert lines == TOLD.read_text().splitlines()


def known(failures: dict[str, set[str]]) -> set[Cell]:
    """The cells that are known to fail, which all must fail."""
    cells = {
        (master, losses) for master, losses in CELLS if name_of(losses) in failures.get(master, ())
    }
    assert len(cells) == sum(map(len, failures.values()))
    return cells
