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

CUTS, PLANT_CUTS = 40, 20
LARGE = 400_000
"""Captures of more bytes take too long here; `python -m tests.adversary.cuts` cuts them, too."""
PLANT_SEEDS = range(1, 4)

LIMITS = {
    "ends": (25_000, 25_000, 5_000),
    "loss": (2_500, 1_600, 170),
    "snaplen": (10_000, 8_000, 5_000),
    "loss and snaplen": (1_500, 1_500, 210),
}
"""For each kind of cut: one of how many pairs told as sure may be contradicted, one of how many
requests and responses may be blamed, one of how many proved pairs may be parted. They are as tight
as what is measured allows, with room for one or two more."""


@cache
def small_captures() -> list[Path]:
    return [path for path in captures() if path.stat().st_size <= LARGE]


@pytest.mark.public_captures
def test_cut_public_captures_tell_little_that_the_whole_ones_contradict() -> None:
    if not small_captures():
        pytest.skip("the public captures are not there")
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    for path in small_captures():
        found = cut_capture(WholeCapture(packets_of(path), path.name), CUTS, seed=1)
        for kind in KINDS:
            counts[kind].update(found[kind].counts())
    for kind, some in counts.items():
        assert some["proved"] > 500, kind
        pairs_a_contradiction, pairs_a_blame, proved_a_parting = LIMITS[kind]
        wrong = some["contradicted"] + some["unacknowledged"]
        assert wrong <= some["pairs"] / pairs_a_contradiction, (kind, some)
        assert some["blamed"] + some["unasked"] <= some["pairs"] / pairs_a_blame, (kind, some)
        assert some["parted"] <= some["proved"] / proved_a_parting, (kind, some)


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
        counts.update(
            cut_capture(WholeCapture(plant(master, seed)), PLANT_CUTS, seed)["ends"].counts()
        )
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
