from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from tests.benchmarks.slower_slave import REQUESTS, Outcome, measure, recording, told

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("speed", "tolerance", "found"),
    [(Fraction(1), 10_000, 0), (Fraction(1, 3), 50, len(REQUESTS))],
)
def test_a_slower_slave_is_found(
    speed: Fraction, tolerance: float, found: int, tmp_path: Path
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(recording(10))
    assert measure(path, speed, 1, tolerance) == Outcome(speed, 1, [found], 0)


def test_an_outcome_is_told_in_a_line() -> None:
    assert told(Outcome(Fraction(2, 3), 3, [3, 0, 2], 1)) == (
        "slave 1.5 times as slow: 2 of 3 runs find it, 5 of 9 requests; 1 other differences"
    )
