"""Plants whose writes are slow, repeated or unanswered, with the truth beside them."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from tests.benchmarks.adapters import Column
from tests.serial_line.plants import (
    DEAD_UNITS,
    LINE,
    RETRIED_WRITES,
    SLOW_AND_RETRIED,
    SLOW_WRITES,
    Plant,
    read_all,
)

PLANTS = {
    "slow writes": SLOW_WRITES,
    "dead units": DEAD_UNITS,
    "retried writes": RETRIED_WRITES,
    "slow and retried writes": SLOW_AND_RETRIED,
}
EXACT = (Column.BYTES, Column.POLLED, Column.FTDI)


@pytest.mark.parametrize("column", EXACT)
@pytest.mark.parametrize("name", PLANTS)
def test_silences_tell_responses_from_retries(name: str, column: Column) -> None:
    told = read_all(PLANTS[name], column, range(3), exchanges=300)
    assert told.found == told.frames
    assert told.wrong <= 0.002 * told.frames, told.misses
    assert told.ambiguous <= 0.02 * told.frames


@pytest.mark.parametrize("name", PLANTS)
def test_without_times_hardly_any_direction_is_sure_and_wrong(name: str) -> None:
    told = read_all(PLANTS[name], Column.NO_TIMES, range(3), exchanges=300)
    assert told.found == told.frames
    assert told.wrong <= 0.002 * told.frames, told.misses


@pytest.mark.parametrize("name", PLANTS)
def test_times_make_nothing_worse(name: str) -> None:
    """At most one frame of 1,800: the first retry may come before anything was learned."""
    without = read_all(PLANTS[name], Column.NO_TIMES, range(3), exchanges=300)
    for column in EXACT:
        with_times = read_all(PLANTS[name], column, range(3), exchanges=300)
        assert with_times.wrong <= without.wrong + 1, column


@pytest.mark.parametrize("jitter", [0, 15])
@pytest.mark.parametrize("timeout", [100, 200, 700])
def test_retry_of_a_write_is_told_by_the_timeout_that_retries_of_reads_show(
    timeout: int, jitter: int
) -> None:
    """Some responses come just before the timeout, so that no other rule could tell them."""
    plant = Plant(
        timeout=timeout,
        jitter=jitter,
        write_loss=0.2,
        read_loss=0.1,
        write_latency=(5, 0.9 * min(timeout, 200)),
    )
    told = read_all(plant, Column.BYTES, range(3), exchanges=300)
    assert told.wrong <= 0.002 * told.frames, told.misses
    assert told.ambiguous <= 0.02 * told.frames


def test_plant_says_what_it_sends() -> None:
    traffic = SLOW_WRITES.traffic(1, 50)
    assert len(traffic.exchanges) == 50
    for one in traffic.exchanges:
        assert one.request is not None
        assert one.response is not None
        request, response = traffic.frames[one.request], traffic.frames[one.response]
        assert (request.direction, response.direction) == (Direction.REQUEST, Direction.RESPONSE)
        if request.raw[1] in (0x05, 0x06):
            assert response.raw == request.raw
            assert 95_000_000 <= response.start_ns - request.end_ns <= 105_000_000
    assert traffic.line is LINE
