"""Measures judgements of types against devices whose values are known.

A judgement is right if it makes the same numbers of the same registers as the truth, at all times.
So int32 and uint32 are equally right for a number that is never negative.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import Table
from mbtool.values.judging import WordHistory, judge
from mbtool.values.word_readings import numbers_in
from tests.adversary.values.generator import generated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.values.judging import Judged
    from tests.adversary.values.generator import Device, Value


@dataclass(slots=True)
class Figures:
    """How many values were judged, and how."""

    values: int = 0
    known: int = 0
    """Values whose words tell their type."""
    known_right: int = 0
    known_sure: int = 0
    right: int = 0
    judged: int = 0
    sure: int = 0
    sure_wrong: int = 0
    wrong: list[str] = field(default_factory=list)
    """What was known and judged wrongly, and what was sure and wrong, one line each."""


def histories(device: Device) -> list[WordHistory]:
    """What the master's requests show of a device."""
    found: dict[tuple[int, int], WordHistory] = {}
    for at_ns, address, words in device.reads:
        key = address, len(words)
        one = found.get(key)
        if one is None:
            one = found[key] = WordHistory(Table.HOLDING_REGISTERS, address, [], [])
        one.times_ns.append(at_ns)  # type: ignore[attr-defined]
        one.rows.append(words)  # type: ignore[attr-defined]
    return list(found.values())


def measure(seeds: Sequence[object]) -> Figures:
    figures = Figures()
    for seed in seeds:
        device = generated(Random(str(seed)))
        _compare(device, judge(histories(device)), figures, str(seed))
    return figures


def _compare(device: Device, judged: Sequence[Judged], figures: Figures, seed: str) -> None:
    by_address = {one.address: one for one in judged}
    truth = {
        address: value
        for value in device.values
        for address in range(value.address, value.address + value.words)
    }
    for value in device.values:
        one = by_address.get(value.address)
        is_right = one is not None and _is_right(one, value)
        is_known = value.is_known
        figures.values += 1
        figures.right += is_right
        figures.known += is_known
        figures.known_right += is_known and is_right
        figures.known_sure += bool(is_known and is_right and one and one.is_sure)
        if is_known and not is_right:
            figures.wrong.append(f"known: {_told(seed, value, one)}")
    for one in judged:
        figures.judged += 1
        figures.sure += one.is_sure
        value = truth[one.address]
        if one.is_sure and not (value.address == one.address and _is_right(one, value)):
            figures.sure_wrong += 1
            figures.wrong.append(f"sure:  {_told(seed, value, one)}")


def _is_right(one: Judged, value: Value) -> bool:
    if one.words != value.words:
        # The zeros behind a text may be its padding.
        return value.type == "string" and one.reading.type is PointType.STRING
    if value.type == "string" or one.reading.type is PointType.STRING:
        return value.type == one.reading.type.value
    columns = list(zip(*value.rows, strict=True))
    numbers = numbers_in(columns, one.reading)
    return numbers is not None and list(numbers) == value.numbers


def _told(seed: str, value: Value, one: Judged | None) -> str:
    rows = [" ".join(f"{word:04X}" for word in row) for row in value.rows[:4]]
    last = struct.pack(f">{value.words}H", *value.rows[-1]).hex().upper()
    judged = (
        "not at its address"
        if one is None
        else f"{one.reading.type} {one.reading.order} at {one.address} ({one.likelihood:.3f}: "
        f"{one.reason})"
    )
    return (
        f"{seed} {value.what} {value.type} {value.order} at {value.address}: "
        f"{', '.join(rows)} ... {last} -> {judged}"
    )
