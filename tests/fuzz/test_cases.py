"""Inputs that a fuzzer found, and the ones that it begins with: no target raises for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.fuzz.__main__ import CASES
from tests.fuzz.seeds import seeds
from tests.fuzz.targets import TARGETS

if TYPE_CHECKING:
    from pathlib import Path

FOUND = sorted(path for path in CASES.glob("*/*") if path.is_file())


@pytest.mark.parametrize("path", FOUND, ids=[f"{one.parent.name}/{one.name[:12]}" for one in FOUND])
def test_an_input_that_was_found_once_raises_no_more(path: Path) -> None:
    TARGETS[path.parent.name](path.read_bytes())


@pytest.mark.parametrize("target", TARGETS)
def test_the_first_inputs_of_a_target_raise_nothing(target: str) -> None:
    first = seeds(target)
    assert first
    for data in first[:3]:
        TARGETS[target](data[:4000])
