from __future__ import annotations

from random import Random

import pytest

from mbtool.core import Direction
from mbtool.modbus import Outcome
from tests.benchmarks.adapters import Damage, Wire, damaged
from tests.benchmarks.bus_traffic import Traffic, bus_traffic
from tests.benchmarks.figures import Figures, Heard, figures


@pytest.fixture(scope="module")
def traffic() -> Traffic:
    return bus_traffic(2, 200)


@pytest.mark.parametrize("damage", Damage)
def test_who_says_the_truth_is_right_in_all(traffic: Traffic, damage: Damage) -> None:
    wire = damaged(traffic, damage, Random(1))
    one = figures(traffic, wire, truth(traffic, wire))
    assert one.found_share == one.right_share == one.transactions_share == 1
    assert (one.false, one.ambiguous, one.wrong, one.out_of_step_most) == (0, 0, 0, 0)


def test_a_frame_at_another_place_is_false_and_the_true_one_missing(traffic: Traffic) -> None:
    wire = damaged(traffic, Damage.NONE, Random(1))
    heard = truth(traffic, wire)
    offset, raw, direction = heard.frames[5]
    heard.frames[5] = (offset + 1, raw[1:], direction)
    one = figures(traffic, wire, heard)
    assert (one.frames - one.found, one.false, one.in_doubt) == (1, 1, 0)


def test_a_frame_that_is_none_is_in_doubt_where_the_decoder_says_so(traffic: Traffic) -> None:
    wire = damaged(traffic, Damage.NONE, Random(1))
    heard = truth(traffic, wire)
    offset, raw, _ = heard.frames[5]
    heard.frames[5] = (offset, raw[:-1], None)
    one = figures(traffic, wire, heard)
    assert (one.frames - one.found, one.false, one.in_doubt) == (1, 0, 1)
    assert one.in_doubt_per_10000 == 10_000 / one.heard


def test_a_direction_is_right_wrong_or_ambiguous(traffic: Traffic) -> None:
    wire = damaged(traffic, Damage.NONE, Random(1))
    heard = truth(traffic, wire)
    heard.frames = [
        (offset, raw, (Direction.REQUEST, None)[place % 2])
        for place, (offset, raw, _) in enumerate(heard.frames)
    ]
    one = figures(traffic, wire, heard)
    assert one.ambiguous == len(traffic.frames) // 2
    assert one.right > 0
    assert one.wrong > 0
    assert one.right + one.wrong + one.ambiguous == one.found == one.frames


def test_transactions_behind_a_damage_count_until_one_is_right(traffic: Traffic) -> None:
    wire = damaged(traffic, Damage.NONE, Random(1))
    wire.mended = [10]
    heard = truth(traffic, wire)
    assert heard.transactions is not None
    request, response, _ = heard.transactions[10]
    heard.transactions[10] = (request, response, Outcome.MALFORMED)
    del heard.transactions[11]
    assert figures(traffic, wire, heard).out_of_step == [2]


def test_cells_of_several_lines_add_up(traffic: Traffic) -> None:
    wire = damaged(traffic, Damage.NONE, Random(1))
    one = figures(traffic, wire, truth(traffic, wire))
    both = Figures()
    both.add(one)
    both.add(one)
    assert both.frames == 2 * one.frames
    assert both.found_share == 1


def truth(traffic: Traffic, wire: Wire) -> Heard:
    offsets = {place: offset for offset, place in wire.intact.items()}
    return Heard(
        frames=[
            (offset, traffic.frames[place].raw, traffic.frames[place].direction)
            for place, offset in offsets.items()
        ],
        transactions=[
            (
                None if one.request is None else offsets[one.request],
                None if one.response is None else offsets[one.response],
                one.outcome,
            )
            for one in traffic.exchanges
            if all(place in offsets for place in one.frames)
        ],
    )
