from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns import flows
from mbtool.columns.flows import UNKNOWN, FlowNumbers

if TYPE_CHECKING:
    import pytest


def ends(*values: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    return np.array(values, np.uint64)


def test_a_flow_keeps_its_number_and_its_ends() -> None:
    numbers = FlowNumbers()
    lower, upper = (
        ends(502 << 48 | 1, 502 << 48 | 2, 502 << 48 | 1),
        ends(7 << 48, 7 << 48, 7 << 48),
    )
    first = numbers.numbers(lower, upper).tolist()
    assert first[0] == first[2] != first[1]
    assert numbers.numbers(lower[::-1], upper).tolist() == first[::-1]
    assert numbers.ends[first[1]][:2] == (b"\0\0\0\2", 502)


def test_of_two_flows_with_one_hash_the_second_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flows, "_hash", lambda lower, upper: np.zeros(len(lower), np.uint64))
    numbers = FlowNumbers()
    assert numbers.numbers(ends(1, 2, 1), ends(3, 3, 3)).tolist() == [0, UNKNOWN, 0]
    assert numbers.numbers(ends(2, 1), ends(3, 3)).tolist() == [UNKNOWN, 0]


def test_flows_are_forgotten_beyond_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flows, "MAX_FLOWS", 2)
    numbers = FlowNumbers()
    for value in range(6):
        numbers.make_room()
        numbers.numbers(ends(value), ends(9))
        assert len(numbers.ends) <= 3
