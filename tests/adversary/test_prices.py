"""What odd input costs grows no faster than the input, and is a small multiple of ordinary cost."""

from __future__ import annotations

import sys
from functools import cache
from typing import TYPE_CHECKING

import pytest

from tests.adversary.prices import INPUTS, LINE, SHORT_LINE, run

if TYPE_CHECKING:
    from types import FrameType

USUAL = 600
"""A small input, with more requests than can be pending. Below four times this size, the cost still
rises until all bounds are reached."""
MOST_TIMES = 10


@cache
def counted(name: str, size: int) -> tuple[int, int]:
    """The number of function calls that an input takes, and its size in bytes."""
    data = INPUTS[name].make(size)
    run(name, INPUTS[name].make(1))  # What is imported and made once is not counted.
    count = 0

    def on_call(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(on_call)
    try:
        run(name, data)
    finally:
        sys.setprofile(before)
    return count, len(data)


SIZES = {"line: random bytes": 8_000, "line: random functions": 3_200}
SERIAL = {name: SIZES.get(name, 800) for name, one in INPUTS.items() if one.basis == LINE}
"""Each input of a serial line, with a size of at least 8 KB: enough to know if the line is in
doubt, which makes most inputs cheaper and random functions dearer."""
DEAR = {
    "line: set points without echoes": 13,
    "line: pairs of an unknown function": 14,
    "line: heads before writes": 21,
}
"""Inputs whose bytes cost more than MOST_TIMES those of a line with long frames."""
DEAR_PACKETS = {"losses of both directions": 50}
"""Inputs whose bytes cost more than MOST_TIMES those of ordinary packets."""
NETWORK = [name for name, one in INPUTS.items() if one.basis == "ordinary"]


@pytest.mark.parametrize("name", NETWORK)
def test_calls_grow_no_faster_than_the_input_and_are_at_most_ten_times_the_ordinary_ones(
    name: str,
) -> None:
    few, few_bytes = counted(name, 4 * USUAL)
    many, many_bytes = counted(name, 8 * USUAL)
    assert many / few <= 1.2 * many_bytes / few_bytes
    ordinary, ordinary_size = counted("ordinary", 4 * USUAL)
    assert few / few_bytes <= DEAR_PACKETS.get(name, MOST_TIMES) * ordinary / ordinary_size


@pytest.mark.parametrize("name", SERIAL)
def test_calls_for_a_line_grow_no_faster_than_the_input_and_have_a_bound(name: str) -> None:
    """A search on a line in long doubt keeps one explanation, so that its price has a bound."""
    few, few_bytes = counted(name, SERIAL[name])
    many, many_bytes = counted(name, 2 * SERIAL[name])
    assert many / few <= 1.2 * many_bytes / few_bytes
    ordinary, ordinary_size = counted(SHORT_LINE, 1000)
    assert many / many_bytes <= MOST_TIMES * ordinary / ordinary_size
    ordinary, ordinary_size = counted(LINE, 1000)
    assert many / many_bytes <= DEAR.get(name, MOST_TIMES) * ordinary / ordinary_size
