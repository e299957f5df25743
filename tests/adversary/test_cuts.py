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
    assert counts["contradicted"] + counts["unacknowledged"] <= counts["pairs"] / 500
    assert counts["blamed"] + counts["unasked"] <= counts["pairs"] / 200
    assert counts["parted"] <= counts["proved"] / 150


@pytest.mark.parametrize("master", PLANTS)
def test_few_pairs_of_pipelined_requests_are_wrong_if_every_twentieth_packet_is_lost(
    master: str,
) -> None:
    found = Cuts()
    for seed in PLANT_SEEDS:
        whole = WholeCapture(plant(master, seed))
        for loss_seed in range(2):
            whole.judge(Cut("loss", 0, len(whole.packets), 0.05, None, loss_seed), found)
    counts = found.counts()
    assert counts["proved"] > 400
    assert counts["contradicted"] <= counts["pairs"] / 1000


@pytest.mark.parametrize("master", PLANTS)
def test_a_plant_cut_at_its_ends_has_few_wrong_pairs_and_blames_nobody(master: str) -> None:
    counts: Counter[str] = Counter()
    for seed in PLANT_SEEDS:
        counts.update(cut_capture(WholeCapture(plant(master, seed)), CUTS, seed)["ends"].counts())
    assert counts["contradicted"] <= counts["pairs"] / 500
    assert (counts["blamed"], counts["unasked"]) == (0, 0)


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
