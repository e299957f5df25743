"""The simulation and its judgement: a decoder that knows the truth is right, any other is not."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from mbtool.devices import NamedTransaction
from mbtool.modbus.adu import DirectionBy, Transport
from mbtool.modbus.transaction import Outcome
from tests.adversary.judgement import (
    blamed,
    excused,
    missing_pairs,
    unasked,
    wrong_pairs,
)
from tests.adversary.network import ALL_LOSSES, MASTERS, name_of, simulate
from tests.adversary.plant import Answer, Ask, Talk, adu
from tests.adversary.segments import part_of
from tests.adversary.tcp import ACK, MS, PUSH, Seen, Segment
from tests.adversary.truth import Truth

if TYPE_CHECKING:
    from tests.adversary.network import Simulated

READ_TWO = bytes.fromhex("03 006b 0002")
READ_ONE = bytes.fromhex("03 006b 0001")
TWO_VALUES = bytes.fromhex("03 04 0001 0002")


def told(
    ask: Ask | None, answer: Answer | None, outcome: Outcome, truth: Truth
) -> NamedTransaction:
    return NamedTransaction(
        link="10.0.0.9",
        transport=Transport.TCP,
        unit=1,
        function=3,
        function_name="READ_HOLDING_REGISTERS",
        outcome=outcome,
        retries=0,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        request_raw=ask.raw if ask else None,
        request_ns=truth.complete_ns(ask) if ask else None,
        response_raw=answer.raw if answer else None,
        response_ns=truth.complete_ns(answer) if answer else None,
    )


def records_of_the_truth(simulated: Simulated) -> list[NamedTransaction]:
    truth = simulated.truth
    records = []
    for ask in truth.asks:
        answer = ask.answer if ask.answer in truth.kinds else None
        if ask in truth.kinds and answer is not None:
            records.append(told(ask, answer, Outcome.OK, truth))
        elif ask in truth.kinds and ask.answer is None:
            records.append(told(ask, None, Outcome.NO_ANSWER, truth))
    return records


@pytest.mark.parametrize("master", MASTERS)
def test_nothing_is_wrong_with_the_truth(master: str) -> None:
    for losses in ALL_LOSSES:
        simulated = simulate(master, losses, seed=7, requests=30)
        records, truth = records_of_the_truth(simulated), simulated.truth
        assert wrong_pairs(records, truth) == [], name_of(losses)
        assert missing_pairs(records, truth) == [], name_of(losses)
        assert blamed(records, truth) == [], name_of(losses)
        assert unasked(records, truth) == [], name_of(losses)
        assert excused(records, truth) == [], name_of(losses)


def test_a_decoder_that_shifts_all_answers_is_wrong_about_all() -> None:
    truth = simulate("constant 0", (), seed=1, requests=30).truth
    answers = truth.answers
    records = [told(one.ask, other, Outcome.OK, truth) for one, other in pairwise(answers)]
    assert len(wrong_pairs(records, truth)) == 29
    assert len(missing_pairs(records, truth)) == 30


def test_a_decoder_that_joins_nothing_blames_the_slave_for_all() -> None:
    truth = simulate("counting", (), seed=1, requests=30).truth
    records = [told(one, None, Outcome.NO_ANSWER, truth) for one in truth.asks]
    records += [told(None, one, Outcome.UNSOLICITED, truth) for one in truth.answers]
    assert len(blamed(records, truth)) == len(unasked(records, truth)) == 30


def test_the_same_seed_gives_the_same_capture_and_another_seed_another() -> None:
    first, again, other = (
        simulate("connections", ("silent", "swapped"), seed) for seed in (3, 3, 4)
    )
    assert first.packets == again.packets
    assert first.packets != other.packets


@pytest.mark.parametrize("master", MASTERS)
def test_without_loss_each_segment_follows_the_last_and_acknowledges_what_came(master: str) -> None:
    ends: dict[object, int] = {}
    for packet in simulate(master, ("silent", "late"), seed=5).packets:
        part = part_of(packet)
        assert part is not None
        if part.flow in ends and not packet.data[47] & 0x02:
            assert part.sequence == ends[part.flow]
        control = bool(packet.data[47] & 0x03)
        ends[part.flow] = (part.end + control) & 0xFFFFFFFF
        if part.acknowledgement is not None:
            behind = (ends[part.is_sent_back] - part.acknowledgement) & 0xFFFFFFFF
            assert behind < 10_000


def pipelined(first: bytes, second: bytes, *, answered: int, apart_ns: int) -> Truth:
    """Two requests with id 0 after each other, of which the slave answers one."""
    talk = Talk()
    seen = []
    for number, pdu in enumerate((first, second)):
        raw = adu(0, 1, pdu)
        talk.asks.append(Ask(0, raw, 12 * number, number * apart_ns))
        seen.append(Seen(number * apart_ns + 1, segment(raw, 12 * number, from_master=True)))
    ask = talk.asks[answered]
    sent_ns = apart_ns + 5 * MS
    ask.answer = Answer(ask, adu(0, 1, TWO_VALUES), 0, sent_ns, 24)
    talk.answers.append(ask.answer)
    seen.append(Seen(sent_ns + 1, segment(ask.answer.raw, 0, from_master=False)))
    return Truth(talk, seen, {0: 200 * MS}, set())


def segment(payload: bytes, offset: int, *, from_master: bool) -> Segment:
    return Segment(
        connection=0,
        from_master=from_master,
        ports=(40001, 502) if from_master else (502, 40001),
        sequence=offset,
        acknowledgement=0,
        flags=PUSH | ACK,
        payload=payload,
        offset=offset,
        acknowledged=0 if from_master else 24,
    )


@pytest.mark.parametrize("answered", [0, 1])
def test_which_of_two_equal_open_requests_is_answered_cannot_be_known(answered: int) -> None:
    truth = pipelined(READ_TWO, READ_TWO, answered=answered, apart_ns=MS)
    assert truth.candidates == {2: {0, 1}}


def test_the_shape_of_an_answer_tells_its_request() -> None:
    assert pipelined(READ_ONE, READ_TWO, answered=1, apart_ns=MS).unsure == set()


def test_an_answer_soon_after_a_retry_is_the_retrys() -> None:
    assert pipelined(READ_TWO, READ_TWO, answered=1, apart_ns=200 * MS).unsure == set()


def test_a_late_answer_that_looks_like_the_retrys_cannot_be_known() -> None:
    assert pipelined(READ_TWO, READ_TWO, answered=0, apart_ns=200 * MS).candidates == {2: {0, 1}}
