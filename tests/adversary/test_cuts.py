"""What is told of a cut capture, the whole capture says as well."""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import TYPE_CHECKING

import pytest

from tests.adversary.cuts import (
    KINDS,
    PLANTS,
    Cut,
    Cuts,
    WholeCapture,
    captures,
    cut_capture,
    plant,
)
from tests.adversary.removal import packets_of

if TYPE_CHECKING:
    from pathlib import Path

CUTS = 40
LARGE = 400_000
"""Captures of more bytes take too long here; `python -m tests.adversary.cuts` cuts them, too."""
PLANT_SEEDS = range(1, 4)

LIMITS = {
    "ends": (25_000, 25_000, 5_000),
    "loss": (2_500, 1_800, 170),
    "snaplen": (10_000, 8_000, 5_000),
    "loss and snaplen": (1_500, 1_500, 210),
}
"""For each kind of cut: one of how many pairs told as sure may be contradicted, one of how many
requests and responses may be blamed, one of how many proved pairs may be parted. They are as tight
as what is measured allows, with room for one or two more."""


@cache
def small_captures() -> list[Path]:
    return [path for path in captures() if path.stat().st_size <= LARGE]


@cache
def found_in_captures(kind: str) -> Counter[str]:
    counts: Counter[str] = Counter()
    for found in _all_found():
        counts.update(found[kind].counts())
    return counts


@cache
def _all_found() -> list[dict[str, Cuts]]:
    return [
        cut_capture(WholeCapture(packets_of(path), path.name), CUTS, seed=1)
        for path in small_captures()
    ]


@pytest.mark.public_captures
@pytest.mark.parametrize("kind", KINDS)
def test_cut_public_captures_tell_little_that_the_whole_ones_contradict(kind: str) -> None:
    if not small_captures():
        pytest.skip("the public captures are not there")
    counts = found_in_captures(kind)
    assert counts["proved"] > 500
    pairs_a_contradiction, pairs_a_blame, proved_a_parting = LIMITS[kind]
    wrong = counts["contradicted"] + counts["unacknowledged"]
    assert wrong <= counts["pairs"] / pairs_a_contradiction
    assert counts["blamed"] + counts["unasked"] <= counts["pairs"] / pairs_a_blame
    assert counts["parted"] <= counts["proved"] / proved_a_parting


@pytest.mark.parametrize("master", PLANTS)
def test_no_pair_of_pipelined_requests_is_wrong_if_every_twentieth_packet_is_lost(
    master: str,
) -> None:
    found = Cuts()
    for seed in PLANT_SEEDS:
        whole = WholeCapture(plant(master, seed))
        for loss_seed in range(2):
            whole.judge(Cut("loss", 0, len(whole.packets), 0.05, None, loss_seed), found)
    counts = found.counts()
    assert counts["proved"] > 400
    assert counts["contradicted"] == 0


@pytest.mark.parametrize("master", PLANTS)
def test_a_plant_cut_at_its_ends_has_no_wrong_pair_and_blames_nobody(master: str) -> None:
    counts: Counter[str] = Counter()
    for seed in PLANT_SEEDS:
        counts.update(cut_capture(WholeCapture(plant(master, seed)), CUTS, seed)["ends"].counts())
    assert counts["contradicted"] == counts["blamed"] == counts["unasked"] == 0


def test_the_judge_sees_a_pair_that_is_not_one() -> None:
    whole = WholeCapture(plant("cycle", 1))
    first, second = whole._told[:2]
    assert first.ask is not None
    assert first.answer is not None
    assert second.ask is not None
    assert second.answer is not None
    assert not whole._contradicts(first.ask, first.answer)
    assert whole._contradicts(first.ask, second.answer)
    assert not whole._is_acknowledged(second.ask, first.answer)
