from __future__ import annotations

import pytest

from mbtool.devices import Namer
from mbtool.modbus import Table, Transaction
from mbtool.replay import traffic as room
from mbtool.replay.traffic import (
    MAX_LATENCIES,
    MAX_VALUES,
    NO_ANSWER,
    ObservedValues,
    Sample,
    SlaveTraffic,
    Traffic,
    ValueKey,
)
from tests.replay.recorded import answered, to_all, unanswered


def _only_slave(*transactions: Transaction) -> SlaveTraffic:
    namer = Namer()
    traffic = Traffic.of(namer.name(one) for one in transactions)
    (slave,) = traffic.slaves(frozenset()).values()
    return slave


def test_equal_requests_are_one_however_they_end() -> None:
    slave = _only_slave(
        answered(0, "03 0001 0002", "03 04 0005 0006"),
        answered(10, "03 0001 0002", "83 06"),
        unanswered(20, "03 0001 0002"),
    )
    (asked,) = slave.requests.values()
    assert asked.count == 3
    assert asked.outcomes == {"ok": 1, "exception 06": 1, NO_ANSWER: 1}
    assert asked.reference == "holding 1..2"
    assert len(asked.latencies.values) == 2


def test_values_come_from_reads_and_acknowledged_writes_only() -> None:
    slave = _only_slave(
        answered(0, "03 0001 0002", "03 04 0005 0006"),
        answered(10, "06 0001 0007", "06 0001 0007"),
        answered(20, "06 0001 0008", "86 02"),
        unanswered(30, "06 0001 0009"),
    )
    assert {place: list(held.values) for place, held in slave.registers.items()} == {
        ValueKey(Table.HOLDING_REGISTERS, 1, is_written=False): [5],
        ValueKey(Table.HOLDING_REGISTERS, 2, is_written=False): [6],
        ValueKey(Table.HOLDING_REGISTERS, 1, is_written=True): [7],
    }


def test_a_broadcast_gives_written_values() -> None:
    slave = _only_slave(to_all(0, "06 0001 0007"))
    assert list(slave.registers) == [ValueKey(Table.HOLDING_REGISTERS, 1, is_written=True)]


def test_read_and_write_of_one_request_are_kept_apart() -> None:
    slave = _only_slave(answered(0, "17 0003 0001 0008 0001 02 000B", "17 02 000A"))
    assert {(place.address, place.is_written) for place in slave.registers} == {
        (3, False),
        (8, True),
    }


def test_masks_are_no_values() -> None:
    assert not _only_slave(answered(0, "16 0004 00F2 0025", "16 0004 00F2 0025")).registers


def test_padding_bits_are_no_values() -> None:
    slave = _only_slave(answered(0, "01 0000 0003", "01 01 FD"))
    assert [list(held.values) for held in slave.registers.values()] == [[1], [0], [1]]


def test_a_register_keeps_a_limited_number_of_values_and_the_range_of_all() -> None:
    held = ObservedValues()
    for value in range(MAX_VALUES + 10):
        held.add(value)
    assert (len(held.values), held.is_all) == (MAX_VALUES, False)
    assert (held.least, held.greatest) == (0, MAX_VALUES + 9)


def test_latencies_are_thinned_evenly() -> None:
    sample = Sample()
    for value in range(5 * MAX_LATENCIES):
        sample.add(value)
    assert len(sample.values) < MAX_LATENCIES
    steps = {
        later - sooner for sooner, later in zip(sample.values, sample.values[1:], strict=False)
    }
    assert steps == {8}


@pytest.mark.parametrize("bound", ["MAX_REQUESTS", "MAX_REGISTERS", "MAX_SLAVES"])
def test_traffic_beyond_a_limit_is_not_compared(
    bound: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, bound, 1)
    namer = Namer()
    both = [
        answered(0, "03 0001 0001", "03 02 0005"),
        answered(9, "03 0002 0001", "03 02 0005", unit=2 if bound == "MAX_SLAVES" else 1),
    ]
    traffic = Traffic.of(namer.name(one) for one in both)
    assert (traffic.count, traffic.compared) == (2, 1)
    traffic = Traffic.of(namer.name(one) for one in both[:1])
    assert (traffic.count, traffic.compared) == (1, 1)
