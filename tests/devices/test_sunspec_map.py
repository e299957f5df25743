"""The map of a SunSpec device, found in what it is read."""

from __future__ import annotations

import pytest

from mbtool.devices.sunspec_map import MAX_MODELS, FoundModel, SunSpecMap, mark_in
from tests.devices.sunspec import BASE, DEVICE, MAKER, registers

DEVICE_REGISTERS = registers()
ALL = [word for block in DEVICE_REGISTERS.values() for word in block]
MODELS = [FoundModel(1, 40002, 33), FoundModel(64900, 40037, 8), FoundModel(64999, 40047, 2)]


@pytest.mark.parametrize("size", [1, 2, 3, 10, 125, 400])
def test_the_models_are_found_however_the_registers_are_read(size: int) -> None:
    found = SunSpecMap(BASE)
    for at in range(0, len(ALL), size):
        assert found.is_complete == (at >= len(ALL) - 1)
        found.note(BASE + at, ALL[at : at + size])
    assert (found.models, found.is_complete, found.end) == (MODELS, True, 40051)
    assert (found.maker, found.device) == (MAKER, f"{MAKER} {DEVICE}")


def test_a_map_that_is_read_again_stays_the_same() -> None:
    found = SunSpecMap(BASE)
    for _ in range(2):
        found.note(BASE, ALL)
    assert found.models == MODELS


def test_values_that_are_read_first_are_no_models() -> None:
    found = SunSpecMap(BASE)
    found.note(40047, [1, 2, 3, 4])
    assert found.models == []
    found.note(BASE, ALL[:40])
    assert found.models == MODELS[:2]


@pytest.mark.parametrize("base", [0, 40000, 50000])
def test_the_mark_shows_where_a_map_begins(base: int) -> None:
    assert mark_in(base, ALL[:2]) == base
    assert mark_in(max(base - 3, 0), [9] * min(base, 3) + ALL) == base
    assert mark_in(base, ALL[:1]) is None
    assert mark_in(base + 7, ALL) is None


@pytest.mark.parametrize(
    "words",
    [
        [103, 50],  # The first model is not 1.
        [1, 0xFFFE],  # It ends behind the last address.
        [0xFFFF, 0],
    ],
)
def test_what_can_be_no_map_has_no_models(words: list[int]) -> None:
    found = SunSpecMap(BASE)
    found.note(BASE + 2, words)
    assert (found.models, found.is_complete, found.device) == ([], True, "")


def test_a_map_without_end_is_bounded() -> None:
    found = SunSpecMap(0)
    found.note(2, [1, 0] * 4 * MAX_MODELS)
    assert (len(found.models), found.is_complete) == (MAX_MODELS, True)


def test_a_text_that_is_no_text_is_shown_on_one_line() -> None:
    found = SunSpecMap(BASE)
    found.note(BASE + 2, [1, 66, 0x1B5B, 0x0A41, 0xFF20, 0x4200])
    assert found.device.isprintable()
    assert "A" in found.device
