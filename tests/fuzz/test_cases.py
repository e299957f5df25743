"""Inputs that a fuzzer found, and the ones that it begins with: no target raises for them."""

from __future__ import annotations

import pytest

from tests.fuzz.__main__ import CASES
from tests.fuzz.seeds import seeds
from tests.fuzz.targets import TARGETS


def test_an_input_that_was_found_once_raises_no_more() -> None:
    for path in CASES.glob("*/*"):
        TARGETS[path.parent.name](path.read_bytes())


@pytest.mark.parametrize("target", TARGETS)
def test_the_first_inputs_of_a_target_raise_nothing(target: str) -> None:
    first = seeds(target)
    assert first
    for data in first[:3]:
        TARGETS[target](data[:4000])
