"""Pairing of requests with responses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Direction, WireEvent
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.network_pairing import NetworkPairing
from mbtool.decode.pairing import Pairing
from mbtool.decode.transactions import Ends
from mbtool.modbus.adu import Adu, DirectionBy, Transport, Verdict
from mbtool.modbus.transaction import Outcome, Transaction

if TYPE_CHECKING:
    from collections.abc import Sequence

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
MS = 1_000_000

READ = "03 006B 0001"
ANSWER = "03 02 022B"
WRITE = "06 0001 0003"


def network() -> NetworkPairing:
    return NetworkPairing(Ends("10.0.0.9", "10.0.0.1:40000", "10.0.0.9:502"))


def bus() -> Pairing:
    return Pairing(Ends("rs485"))


def adu(
    direction: Direction, pdu: str, at_ms: int, *, unit: int = 1, transaction_id: int | None = None
) -> Adu:
    """An ADU that takes a millisecond from `at_ms` on."""
    data = bytes.fromhex(pdu)
    return Adu(
        start_ns=at_ms * MS,
        end_ns=at_ms * MS + MS,
        transport=Transport.RTU if transaction_id is None else Transport.TCP,
        direction=direction,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=unit,
        pdu=data,
        raw=data,
        transaction_id=transaction_id,
    )


def asked(pdu: str, at_ms: int, transaction_id: int | None = None, unit: int = 1) -> Adu:
    return adu(REQUEST, pdu, at_ms, unit=unit, transaction_id=transaction_id)


def told(pdu: str, at_ms: int, transaction_id: int | None = None, unit: int = 1) -> Adu:
    return adu(RESPONSE, pdu, at_ms, unit=unit, transaction_id=transaction_id)


def joined(pairing: Pairing | NetworkPairing, *adus: Adu) -> list[Transaction]:
    done = [each for one in adus for each in pairing.feed(one) if isinstance(each, Transaction)]
    return done + pairing.close()


def outcomes(done: Sequence[Transaction | WireEvent]) -> list[Outcome]:
    return [one.outcome for one in done if isinstance(one, Transaction)]


# On a network.


def test_a_response_is_paired_with_its_request() -> None:
    (done,) = joined(network(), asked(READ, 10, 7), told(ANSWER, 15, 7))
    assert done.outcome is Outcome.OK
    assert (done.source, done.destination) == ("10.0.0.1:40000", "10.0.0.9:502")
    assert (done.unit, done.transaction_id, done.function, done.address) == (1, 7, 3, 0x6B)
    assert (done.request_ns, done.response_ns) == (11 * MS, 16 * MS)
    assert done.latency_ns == 4 * MS  # From the request's end to the response's start.
    assert (done.retries, done.verdicts) == (0, [])


def test_responses_out_of_order_find_their_requests_by_id() -> None:
    done = joined(
        network(), asked(READ, 0, 1), asked(READ, 1, 2), told(ANSWER, 5, 2), told(ANSWER, 6, 1)
    )
    assert [(one.transaction_id, one.request_ns) for one in done] == [(2, 2 * MS), (1, MS)]


def test_with_equal_ids_the_oldest_request_is_answered_first() -> None:
    done = joined(
        network(),
        asked(READ, 0, 0), asked("03 0000 0001", 1, 0),
        told(ANSWER, 5, 0), told("03 02 0001", 6, 0),
    )  # fmt: skip
    assert [(one.address, one.response_values) for one in done] == [(0x6B, [0x22B]), (0, [1])]


def test_equal_ids_of_different_units_are_distinguished() -> None:
    done = joined(
        network(),
        asked(READ, 0, 0, unit=1), asked(READ, 1, 0, unit=2),
        told(ANSWER, 5, 0, unit=2), told(ANSWER, 6, 0, unit=1),
    )  # fmt: skip
    assert [(one.unit, one.request_ns) for one in done] == [(2, 2 * MS), (1, MS)]


def test_equal_ids_of_different_functions_are_distinguished() -> None:
    done = joined(
        network(), asked(READ, 0, 0), asked(WRITE, 1, 0), told(WRITE, 5, 0), told("83 02", 6, 0)
    )
    assert [(one.function, one.outcome) for one in done] == [
        (6, Outcome.OK), (3, Outcome.EXCEPTION),
    ]  # fmt: skip


def test_a_response_with_another_id_belongs_to_the_only_open_request() -> None:
    (done,) = joined(network(), asked(READ, 0, 0), told(ANSWER, 5, 4))
    assert (done.outcome, done.transaction_id) == (Outcome.OK, 0)
    assert done.verdicts == [Verdict.OTHER_TRANSACTION_ID]


def test_a_response_with_another_id_that_does_not_fit_is_unsolicited() -> None:
    done = joined(network(), asked(READ, 0, 1), told("03 04 0000 0000", 5, 4))
    assert outcomes(done) == [Outcome.UNSOLICITED, Outcome.NO_ANSWER]
    done = joined(network(), asked(READ, 0, 1), told(ANSWER, 5, 4, unit=2))
    assert outcomes(done) == [Outcome.UNSOLICITED, Outcome.NO_ANSWER]


def test_a_response_with_another_id_is_unsolicited_if_several_requests_are_open() -> None:
    done = joined(network(), asked(READ, 0, 1), asked(READ, 1, 2), told(ANSWER, 5, 4))
    assert outcomes(done) == [Outcome.UNSOLICITED, Outcome.NO_ANSWER, Outcome.NO_ANSWER]


def polled(pairing: NetworkPairing, count: int = 10) -> None:
    """Let a master with one id poll a slave that responds after 5 ms."""
    for at in range(count):
        joined_so_far = [*pairing.feed(asked(READ, 100 * at, 3))]
        joined_so_far += pairing.feed(told(ANSWER, 100 * at + 5, 3))
        assert [one.outcome for one in joined_so_far] == [Outcome.OK]


def pairs_of(done: list[Transaction]) -> dict[int, tuple[int, bool]]:
    """For each request by its time in ms: that of its response, and True if the pair is sure."""
    return {
        one.request_ns // MS: (one.response_ns // MS, Verdict.AMBIGUOUS not in one.verdicts)
        for one in done
        if one.request_ns is not None and one.response_ns is not None
    }


def test_two_late_responses_one_after_the_other_go_to_their_own_requests() -> None:
    pairing = network()
    polled(pairing)
    late = [asked(READ, 1000, 3), asked(READ, 2000, 3), told(ANSWER, 2008, 3)]
    late += [asked("04 006B 0001", 2010, 3), asked("04 006B 0001", 3010, 3)]
    late += [told(ANSWER, 3030, 3), told("04 02 022B", 3035, 3), told("04 02 022B", 3040, 3)]
    pairs = pairs_of(joined(pairing, *late))
    assert pairs[1001] == (2009, True)
    assert pairs[2001] == (3031, True)


def test_the_pairs_after_a_choice_without_evidence_are_ambiguous() -> None:
    pairing = network()
    polled(pairing)
    done = [one for at in (1000, 1200) for one in pairing.feed(asked(READ, at, 3))]
    for at in range(1205, 1205 + 50 * 10, 10):
        done += pairing.feed(told(ANSWER, at, 3))
        done += pairing.feed(asked(READ, at + 2, 3))
    pairs = pairs_of(done)
    assert len(pairs) > 40
    assert not any(is_sure for _, is_sure in pairs.values())


def test_a_retry_is_answered_although_other_functions_take_longer_than_the_timeout() -> None:
    pairing = network()
    polled(pairing)
    slow = [asked("04 006B 0001", 1000, 3), told("04 02 022B", 1150, 3)]
    silent = [asked(WRITE, 1200, 3), asked(WRITE, 1400, 3), told(WRITE, 1405, 3)]
    after = [asked(READ, 1500, 3), told(ANSWER, 1505, 3)]
    done = joined(pairing, *slow, *silent, *after)
    assert pairs_of(done)[1401] == (1406, True)
    assert [one.request_ns for one in done if one.outcome is Outcome.NO_ANSWER] == [1201 * MS]


def test_a_response_without_a_request_is_unsolicited() -> None:
    (done,) = joined(network(), told("06 0001 0003", 5, 9))
    assert (done.outcome, done.request_ns, done.request_raw) == (Outcome.UNSOLICITED, None, None)
    assert (done.address, done.response_values, done.response_ns) == (1, [3], 6 * MS)


def test_request_that_stays_open_is_given_up_after_a_minute() -> None:
    pairing = network()
    assert pairing.feed(asked(READ, 0, 1)) == []
    assert pairing.advance(60_001 * MS) == []
    assert outcomes(pairing.advance(60_001 * MS + 1)) == [Outcome.NO_ANSWER]
    late = told(ANSWER, 61_000, 1)
    assert outcomes(pairing.feed(late)) == [Outcome.UNSOLICITED]


def test_the_next_adu_can_time_out_a_request() -> None:
    done = joined(network(), asked(READ, 0, 1), asked(WRITE, 61_000, 2))
    assert [(one.function, one.outcome) for one in done] == [
        (3, Outcome.NO_ANSWER), (6, Outcome.NO_ANSWER),
    ]  # fmt: skip


def test_retry_is_counted_while_the_first_request_is_still_open() -> None:
    done = joined(network(), asked(READ, 0, 1), asked(READ, 1000, 2), told(ANSWER, 1005, 2))
    assert [(one.transaction_id, one.outcome, one.retries) for one in done] == [
        (2, Outcome.OK, 1), (1, Outcome.NO_ANSWER, 0),
    ]  # fmt: skip


def test_request_that_a_retry_replaced_is_not_counted_again() -> None:
    done = joined(
        network(),
        asked(READ, 0, 1), asked(READ, 1000, 2), told(ANSWER, 1005, 2),
        asked(READ, 62_000, 3), told(ANSWER, 62_005, 3),
    )  # fmt: skip
    assert [(one.transaction_id, one.retries) for one in done] == [(2, 1), (1, 0), (3, 0)]


def test_holds_a_bounded_number_of_requests() -> None:
    pairing = network()
    done = [one for at in range(3 * MAX_OPEN_REQUESTS) for one in pairing.feed(asked(READ, at, at))]
    assert outcomes(done) == [Outcome.NOT_CAPTURED] * 2 * MAX_OPEN_REQUESTS
    assert {tuple(one.verdicts) for one in done} == {(Verdict.OVER_LIMIT,)}
    assert len(pairing.close()) == MAX_OPEN_REQUESTS


def test_clock_that_ran_backwards_leaves_no_latency() -> None:
    (done,) = joined(network(), asked(READ, 10, 1), told(ANSWER, 5, 1))
    assert (done.outcome, done.latency_ns) == (Outcome.OK, None)


# On a bus.


def test_a_bus_pairs_request_and_response_of_one_unit() -> None:
    (done,) = joined(bus(), asked(READ, 0), told(ANSWER, 5))
    assert (done.outcome, done.source, done.transaction_id) == (Outcome.OK, None, None)


def test_on_a_bus_the_next_request_ends_the_open_one() -> None:
    done = joined(bus(), asked(READ, 0), asked(WRITE, 300), told(WRITE, 305))
    assert [(one.function, one.outcome) for one in done] == [
        (3, Outcome.NO_ANSWER), (6, Outcome.OK),
    ]  # fmt: skip


def test_retries_are_counted_until_the_response() -> None:
    done = joined(
        bus(),
        asked(READ, 0), asked(READ, 300), asked(READ, 600), told(ANSWER, 605), asked(READ, 900),
    )  # fmt: skip
    assert [(one.outcome, one.retries) for one in done] == [
        (Outcome.NO_ANSWER, 0), (Outcome.NO_ANSWER, 1), (Outcome.OK, 2), (Outcome.NO_ANSWER, 0),
    ]  # fmt: skip


def test_a_response_of_another_unit_leaves_the_request_open() -> None:
    done = joined(bus(), asked(READ, 0), told(ANSWER, 5, unit=2), told(ANSWER, 9))
    assert [(one.unit, one.outcome) for one in done] == [
        (2, Outcome.UNSOLICITED), (1, Outcome.OK),
    ]  # fmt: skip


def test_a_broadcast_is_complete_at_once() -> None:
    pairing = bus()
    pairing.feed(asked(READ, 0))
    done = pairing.feed(asked(WRITE, 300, unit=0))
    assert outcomes([*done, *pairing.close()]) == [Outcome.BROADCAST, Outcome.NO_ANSWER]


def test_unit_0_is_no_broadcast_on_a_network() -> None:
    (done,) = joined(network(), asked(WRITE, 0, 1, unit=0), told(WRITE, 5, 1, unit=0))
    assert done.outcome is Outcome.OK


def test_request_on_a_bus_is_given_up_after_five_seconds() -> None:
    pairing = bus()
    pairing.feed(asked(READ, 0))
    assert pairing.advance(5001 * MS) == []
    assert outcomes(pairing.advance(5001 * MS + 1)) == [Outcome.NO_ANSWER]


def test_counts_of_unanswered_requests_are_bounded() -> None:
    pairing = bus()
    for address in range(MAX_OPEN_REQUESTS + 2):
        pairing.feed(asked(f"03 {address:04X} 0001", 300 * address))
    first = asked("03 0000 0001", 300 * (MAX_OPEN_REQUESTS + 2))
    pairing.feed(first)
    (done,) = pairing.close()
    assert (done.address, done.retries) == (0, 0)  # The oldest count was given up.


def test_request_is_ambiguous_if_the_retry_after_it_may_be_its_response() -> None:
    retry = replace(asked(WRITE, 200), confidence=0.6, verdicts=(Verdict.AMBIGUOUS,))
    first, second = joined(bus(), asked(WRITE, 0), retry, told(WRITE, 210))
    assert (first.outcome, first.confidence) == (Outcome.NO_ANSWER, 0.6)
    assert (second.outcome, second.confidence, second.retries) == (Outcome.OK, 0.6, 1)
    assert Verdict.AMBIGUOUS in first.verdicts


def test_request_is_certain_though_another_after_it_is_ambiguous() -> None:
    other = replace(asked(READ, 200), confidence=0.6, verdicts=(Verdict.AMBIGUOUS,))
    first, _ = joined(bus(), asked(WRITE, 0), other)
    assert (first.confidence, first.verdicts) == (1.0, [])
