"""How long a connection's pairing waits, how much it holds, and what losses do to it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from mbtool.core import Direction
from mbtool.decode.network_pairing import DOUBTFUL, NetworkPairing
from mbtool.decode.stream_progress import AduPlace
from mbtool.decode.transactions import Ends
from mbtool.modbus.adu import Verdict, mbap_adu
from mbtool.modbus.transaction import Outcome, Transaction
from tests.decode.test_connections import ANSWER as VALUE
from tests.decode.test_connections import READ as READ_ONE
from tests.decode.test_connections import REQUEST, RESPONSE, connection
from tests.decode.test_pairing import (
    ANSWER,
    MS,
    READ,
    WRITE,
    asked,
    network,
    outcomes,
    polled,
    told,
)
from tests.modbus.reading import transactions

OK, NO_ANSWER, UNSOLICITED, LOST = (
    Outcome.OK,
    Outcome.NO_ANSWER,
    Outcome.UNSOLICITED,
    Outcome.NOT_CAPTURED,
)
READ_TWO, TWO_VALUES = "03 0000 0002", "03 04 0001 0002"


def fed(pairing: NetworkPairing, *adus: object) -> list[Transaction]:
    return [each for one in adus for each in pairing.feed(one)]  # type: ignore[arg-type]


def undecided() -> NetworkPairing:
    """A slave that took 5 ms so far answers one of two equal requests, from 1205 ms to 1206 ms."""
    pairing = network()
    polled(pairing)
    assert fed(pairing, asked(READ, 1000, 3), asked(READ, 1200, 3), told(ANSWER, 1205, 3)) == []
    return pairing


def test_a_response_is_held_back_for_three_seconds_until_it_is_told_as_ambiguous() -> None:
    pairing = undecided()
    assert pairing.advance(4206 * MS) == []
    (one,) = pairing.advance(4206 * MS + 1)
    assert (one.outcome, one.retries, one.confidence) == (OK, 1, DOUBTFUL)
    assert (one.request_ns, one.verdicts) == (1201 * MS, [Verdict.AMBIGUOUS])
    (other,) = pairing.close()
    assert (other.request_ns, other.outcome, other.retries) == (1001 * MS, NO_ANSWER, 0)


def test_at_most_32_responses_are_held_back() -> None:
    pairing = network()
    polled(pairing)
    done = fed(pairing, asked(READ, 1000, 3), asked(READ, 1200, 3))
    for held in range(1, 33):
        done += fed(pairing, told(ANSWER, 1195 + 10 * held, 3), asked(READ, 1197 + 10 * held, 3))
        assert done == []
    assert len(fed(pairing, told(ANSWER, 1525, 3))) == 33


@pytest.mark.parametrize(("silent_ns", "is_sure"), [(30 * MS, False), (30 * MS + 1, True)])
def test_a_silence_behind_a_choice_makes_the_pairs_sure_again(
    silent_ns: int, is_sure: bool
) -> None:
    """No response is expected after 30 ms, if they took 5 ms so far."""
    pairing = undecided()
    assert len(pairing.advance(5000 * MS)) == 1
    (one,) = fed(pairing, asked(READ, 5000, 3), told(ANSWER, 5005, 3))
    assert Verdict.AMBIGUOUS not in one.verdicts
    pairing = undecided()
    pairing._decide([])
    start_ns = 1206 * MS + silent_ns
    request = replace(asked(READ, 0, 3), start_ns=start_ns, end_ns=start_ns + MS)
    (one,) = fed(pairing, request, told(ANSWER, 1242, 3))
    assert (Verdict.AMBIGUOUS not in one.verdicts) is is_sure


def test_a_response_that_fits_only_its_own_request_makes_the_pairs_sure_again() -> None:
    pairing = undecided()
    pairing._decide([])
    said = (
        (told(ANSWER, 1208, 3),),  # The other of the two responses.
        (asked(READ, 1210, 3), told(ANSWER, 1215, 3)),
        (asked(READ_TWO, 1220, 3), told(TWO_VALUES, 1225, 3)),
        (asked(READ_TWO, 1230, 3), told(TWO_VALUES, 1235, 3)),
    )
    done = [fed(pairing, *adus)[0] for adus in said]
    assert [one.outcome for one in done] == [Outcome.LATE, OK, OK, OK]
    assert [Verdict.AMBIGUOUS in one.verdicts for one in done] == [True, True, False, False]


def test_at_most_64_requests_are_kept_behind_which_others_were_answered() -> None:
    pairing = network()
    polled(pairing)
    done: list[Transaction] = []
    for number in range(65):
        at_ms = 2000 + 400 * number
        done += fed(pairing, asked(WRITE, at_ms, 3), asked(READ, at_ms + 200, 3))
        done += fed(pairing, told(ANSWER, at_ms + 205, 3))
        assert outcomes(done).count(NO_ANSWER) == (number == 64)
    assert outcomes(done).count(OK) == 65
    assert outcomes(pairing.close()) == [NO_ANSWER] * 64


@pytest.mark.parametrize(("lost", "requests"), [(0, 1), (5, 1), (12, 1), (23, 1), (24, 2), (36, 3)])
@pytest.mark.parametrize("end", [None, 500])
def test_lost_bytes_of_requests_are_as_many_requests_as_reads_would_be(
    lost: int, requests: int, end: int | None
) -> None:
    pairing = network()
    polled(pairing)
    assert pairing.note_loss(Direction.REQUEST, lost, 1000 * MS, end) == []
    done = fed(pairing, *(told(ANSWER, 1005 + 5 * number, 3) for number in range(requests + 1)))
    # One response more is none of theirs, but the capture may lack its request as well.
    assert outcomes(done) == [LOST] * (requests + 1)
    assert {one.request_raw for one in done} == {None}
    assert outcomes(fed(pairing, told(ANSWER, 61_001, 3))) == [UNSOLICITED]
    assert pairing.close() == []


@pytest.mark.parametrize(
    ("lost", "outcome"), [(11, LOST), (9, LOST), (0, LOST), (10, NO_ANSWER), (22, NO_ANSWER)]
)
def test_lost_bytes_of_responses_excuse_a_request_whose_response_they_can_be(
    lost: int, outcome: Outcome
) -> None:
    pairing = network()
    polled(pairing)
    fed(pairing, asked(READ, 1000, 3))
    at_once = pairing.note_loss(Direction.RESPONSE, lost, 1005 * MS)
    assert outcomes(at_once) == ([LOST] if lost in (9, 11) else [])
    assert outcomes([*at_once, *pairing.close()]) == [outcome]


def test_requests_with_ids_of_their_own_wait_though_responses_are_lost() -> None:
    pairing = network()
    for number in range(1, 6):
        fed(pairing, asked(READ, 100 * number, number), told(ANSWER, 100 * number + 5, number))
    fed(pairing, asked(READ, 1000, 8), asked(READ_TWO, 1001, 9))
    assert pairing.note_loss(Direction.RESPONSE, 11, 1005 * MS) == []
    assert outcomes(fed(pairing, told(TWO_VALUES, 1006, 9))) == [OK]
    assert outcomes(pairing.close()) == [LOST]


@pytest.mark.parametrize(
    ("place", "has_matching", "outcome"),
    [
        (None, False, OK),
        (None, True, UNSOLICITED),
        (AduPlace(50 + 9 + 4, 112), True, OK),  # Acknowledgements show that they are neighbours.
        (AduPlace(50 + 9 + 5, 112), True, UNSOLICITED),
    ],
)
def test_a_response_with_another_id_is_taken_unless_this_slave_repeats_ids(
    place: AduPlace | None, has_matching: bool, outcome: Outcome
) -> None:
    pairing = network()
    if has_matching:
        for number in (1, 2, 3):
            fed(pairing, asked(READ, 100 * number, number), told(ANSWER, 100 * number + 5, number))
    pairing.feed(asked(READ, 1000, 7), place and AduPlace(112, 50))
    response = replace(told(ANSWER, 1005, 9), raw=bytes(13))
    (one,) = pairing.feed(response, place)
    assert one.outcome == outcome
    assert (Verdict.OTHER_TRANSACTION_ID in one.verdicts) is (outcome is OK)


def test_a_response_with_another_id_is_not_taken_while_an_earlier_request_may_wait() -> None:
    """Requests before the capture, and requests that it lacks, may still be answered."""
    own, other = replace(told(ANSWER, 1048, 7), raw=bytes(13)), told(ANSWER, 1001, 9)
    joined = NetworkPairing(Ends("net"), joined=True)
    lossy = network()
    polled(lossy)
    lossy.note_loss(Direction.REQUEST, 12, 500 * MS)
    fed(lossy, told(ANSWER, 501, 3))
    for pairing in (joined, lossy):
        pairing.feed(asked(READ, 1000, 7), AduPlace(112, 50))
        done = pairing.feed(replace(other, raw=bytes(13)), AduPlace(50 + 9 + 4, 112))
        done += pairing.feed(own, AduPlace(50 + 2 * (9 + 4), 112))
        done += pairing.close()
        assert sorted(outcomes(done)) == sorted([LOST, OK])
        assert all(Verdict.OTHER_TRANSACTION_ID not in one.verdicts for one in done)


def test_a_response_with_another_id_is_not_taken_where_responses_are_lost() -> None:
    pairing = network()
    fed(pairing, asked(READ, 1000, 7))
    pairing.note_loss(Direction.RESPONSE, 0, 1002 * MS)
    assert outcomes(fed(pairing, told(ANSWER, 1005, 9))) == [UNSOLICITED]


def test_each_unanswered_request_counts_once_as_a_retry() -> None:
    pairing = network()
    polled(pairing)
    done = fed(pairing, asked(READ, 2000, 3), asked(READ, 3000, 3), asked(WRITE, 4000, 3))
    done += fed(pairing, told(WRITE, 4005, 3), asked(READ, 5000, 3), told(ANSWER, 5005, 3))
    done += fed(pairing, asked(READ, 6000, 3), told(ANSWER, 6005, 3))
    done += pairing.close()
    answered = [(one.function, one.retries) for one in done if one.outcome is OK]
    assert answered == [(6, 0), (3, 2), (3, 0)]
    assert [one.retries for one in done if one.outcome is NO_ANSWER] == [0, 0]


@pytest.mark.parametrize(("is_lost", "retries"), [(False, 1), (True, 0)])
def test_a_request_whose_response_may_be_lost_is_no_retry(is_lost: bool, retries: int) -> None:
    pairing = network()
    for number in range(1, 4):
        fed(pairing, asked(READ, 100 * number, number), told(ANSWER, 100 * number + 5, number))
    fed(pairing, asked(READ, 2000, 4))
    if is_lost:
        pairing.note_loss(Direction.RESPONSE, 0, 2005 * MS)
    (one,) = fed(pairing, asked(READ, 3000, 5), told(ANSWER, 3005, 5))
    assert (one.outcome, one.retries) == (OK, retries)


def test_repeated_requests_that_time_out_count_the_ones_before_them() -> None:
    pairing = network()
    done = fed(pairing, *(asked(READ, 70_000 * number, number) for number in range(3)))
    done += pairing.close()
    assert [(one.outcome, one.retries) for one in done] == [
        (NO_ANSWER, 0), (NO_ANSWER, 1), (NO_ANSWER, 2),
    ]  # fmt: skip


@pytest.mark.parametrize(("way", "outcome"), [(RESPONSE, LOST), (REQUEST, NO_ANSWER)])
def test_bytes_at_the_end_of_a_capture_may_begin_the_response(
    way: Direction, outcome: Outcome
) -> None:
    talk = connection()
    talk.feed(REQUEST, mbap_adu(1, 5, READ_ONE), 0)
    talk.feed(way, mbap_adu(1, 5, VALUE)[:5], 500 * MS)
    (one,) = transactions(talk.close(5000 * MS))
    assert one.outcome == outcome


@pytest.mark.parametrize("lost", [Direction.REQUEST, Direction.RESPONSE])
def test_a_loss_makes_no_pair_sure_that_a_choice_made_doubtful(lost: Direction) -> None:
    pairing = undecided()
    pairing.advance(4206 * MS + 1)
    assert pairing._is_doubtful
    for at_ms in (4210, 4220):
        pairing.note_loss(lost, 100, at_ms * MS)
    assert pairing._is_doubtful
