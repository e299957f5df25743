from __future__ import annotations

from itertools import pairwise
from random import Random

import pytest

from tests.benchmarks.adapters import Column, Damage, Wire, damaged, delivered
from tests.benchmarks.bus_traffic import Traffic, bus_traffic


@pytest.fixture(scope="module")
def traffic() -> Traffic:
    return bus_traffic(1, 400)


def wire_of(traffic: Traffic, damage: Damage) -> Wire:
    return damaged(traffic, damage, Random(1))


@pytest.mark.parametrize("damage", Damage)
@pytest.mark.parametrize("column", Column)
def test_an_adapter_delivers_every_byte_in_order(
    traffic: Traffic, column: Column, damage: Damage
) -> None:
    wire = wire_of(traffic, damage)
    reads = delivered(wire, column)
    assert b"".join(data for data, _ in reads) == wire.data
    assert all(data for data, _ in reads)
    assert all(before <= after for (_, before), (_, after) in pairwise(reads))
    if column is not Column.NO_TIMES:
        end = 0
        for data, ts_ns in reads:
            end += len(data)
            assert ts_ns >= wire.times[end - 1]


@pytest.mark.parametrize(
    ("column", "most_bytes", "latest_ns"),
    [
        (Column.BYTES, 1, 0),
        (Column.POLLED, 2, 1_000_000),
        (Column.FTDI, 62, 16_000_000),
        (Column.BURST_32, 32, 255_000_000),
        (Column.BURST_62, 62, 255_000_000),
    ],
)
def test_an_adapter_keeps_to_its_size_and_its_timer(
    traffic: Traffic, column: Column, most_bytes: int, latest_ns: int
) -> None:
    wire = wire_of(traffic, Damage.NONE)
    place = 0
    for data, ts_ns in delivered(wire, column):
        assert len(data) <= most_bytes
        assert ts_ns - wire.times[place] <= latest_ns
        place += len(data)


@pytest.mark.parametrize("damage", Damage)
def test_the_wire_knows_which_frames_are_undamaged(traffic: Traffic, damage: Damage) -> None:
    wire = wire_of(traffic, damage)
    for offset, place in wire.intact.items():
        assert wire.data.startswith(traffic.frames[place].raw, offset)
    assert len(wire.times) == len(wire.data)
    assert wire.times == sorted(wire.times)
    assert bool(wire.mended) is (damage is not Damage.NONE)
    if damage in (Damage.NONE, Damage.STRAY):
        assert sorted(wire.intact.values()) == list(range(len(traffic.frames)))
    else:
        assert len(traffic.frames) * 0.8 < len(wire.intact) < len(traffic.frames)


def test_stray_bytes_are_all_that_is_added(traffic: Traffic) -> None:
    wire = wire_of(traffic, Damage.STRAY)
    kept = bytearray(wire.data)
    for offset, place in sorted(wire.intact.items(), reverse=True):
        del kept[offset : offset + len(traffic.frames[place].raw)]
    assert set(kept) == {0x00, 0xF8, 0xFE, 0xFF}
    assert len(wire.mended) <= len(kept) <= 3 * len(wire.mended)
