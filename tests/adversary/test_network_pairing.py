"""The decoder against simulated plants whose captures lack packets or have them in disorder."""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.adversary.judgement import decode, judged
from tests.adversary.known_failures import BLAMED, WRONG
from tests.adversary.network import ALL_LOSSES, MASTERS, name_of, simulate

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

TOLD = Path(__file__).with_name("told_of_plants.expected.txt")
SEEDS = 2
REQUESTS = 40

CAPTURE_LOSSES = {"response lost", "request lost", "several lost"}

CELLS = [(master, losses) for master in MASTERS for losses in ALL_LOSSES]

Counts = dict[str, int]


@cache
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


def counted(master: str, losses: tuple[str, ...]) -> Counts:
    return found_in(master, losses)[0]


def summary(records: list[NamedTransaction]) -> str:
    """How many transactions have each outcome with its verdicts, their retries and latencies."""
    kinds = Counter(" ".join([one.outcome, *one.verdicts]) for one in records)
    retries = sum(one.retries for one in records)
    latency_us = sum(one.latency_ns or 0 for one in records) // 1000
    parts = [f"{count} {kind}" for kind, count in sorted(kinds.items())]
    return ", ".join([*parts, f"{retries} retries", f"{latency_us} us"])


def cells(known: dict[str, set[str]]) -> list[object]:
    """All masters with all losses; those that are known to fail must fail."""
    known_to_fail = pytest.mark.xfail(strict=True, reason="see known_failures.py")
    return [
        pytest.param(
            master,
            losses,
            id=f"{master}-{name_of(losses)}",
            marks=[known_to_fail] if name_of(losses) in known.get(master, ()) else [],
        )
        for master, losses in CELLS
    ]


@pytest.mark.parametrize(("master", "losses"), cells(WRONG))
def test_no_response_is_joined_with_a_request_that_it_does_not_answer(
    master: str, losses: tuple[str, ...]
) -> None:
    assert counted(master, losses)["wrong"] == 0


@pytest.mark.parametrize(("master", "losses"), cells(BLAMED))
def test_nobody_is_blamed_for_what_the_capture_lacks(master: str, losses: tuple[str, ...]) -> None:
    counts = counted(master, losses)
    assert (counts["blamed"], counts["unasked"]) == (0, 0)


@pytest.mark.parametrize(
    ("master", "losses"),
    [cell for cell in CELLS if "silent" in cell[1] and not CAPTURE_LOSSES & {*cell[1]}],
)
def test_a_silent_slave_is_not_excused_where_the_capture_is_complete(
    master: str, losses: tuple[str, ...]
) -> None:
    assert counted(master, losses)["excused"] == 0


@pytest.mark.parametrize("master", MASTERS)
def test_all_pairs_of_a_capture_without_loss_are_joined(master: str) -> None:
    counts = counted(master, ())
    assert (counts["missing"], counts["undecidable"]) == (0, 0)


def test_a_late_response_and_lost_ones_shift_no_later_pair() -> None:
    """A master with one id that takes a late response for the next one is always one ahead."""
    simulated = simulate("connections", ("several lost", "retransmitted"), 20, 60)
    found = judged(decode(simulated.packets), simulated.truth)
    assert (found.wrong, found.blamed, found.unasked) == ([], [], [])


def test_all_but_one_in_a_thousand_pairs_are_joined() -> None:
    counts = [counted(*cell) for cell in CELLS]
    pairs = sum(one["transactions"] - one["undecidable"] for one in counts)
    assert sum(one["missing"] for one in counts) <= pairs / 1000, [
        (cell, counted(*cell)["missing"]) for cell in CELLS if counted(*cell)["missing"]
    ]


def test_few_pairs_that_can_be_known_are_told_as_ambiguous() -> None:
    counts = [counted(*cell) for cell in CELLS]
    pairs = sum(one["transactions"] - one["undecidable"] for one in counts)
    # Of a pipelining master with one id, most pairs behind two losses cannot be proved.
    assert sum(one["doubtful"] for one in counts) <= pairs / 220


def test_nearly_everything_can_be_known() -> None:
    """A plant of which little can be known would test little."""
    counts = [counted(*cell) for cell in CELLS]
    assert (
        sum(one["undecidable"] for one in counts)
        < sum(one["transactions"] for one in counts) / 2000
    )


def test_what_is_told_of_the_plants_is_as_expected(pytestconfig: pytest.Config) -> None:
    """A line for each plant: a change of the pairing shows what it is good for, and where not."""
    lines = [
        f"{master}, {name_of(losses)}: {found_in(master, losses)[1]}" for master, losses in CELLS
    ]
    if pytestconfig.getoption("--update-golden"):
        TOLD.write_text("".join(f"{line}\n" for line in lines))
    assert lines == TOLD.read_text().splitlines()
