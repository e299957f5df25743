from __future__ import annotations

from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.devices import Namer
from mbtool.replay.script import Script, Step
from tests.replay.recorded import MS, answered, to_all, unanswered, unasked

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

READ = "03 0000 0001"
VALUE = "03 02 0007"


def _steps(*transactions: Transaction) -> tuple[Step, ...]:
    namer = Namer()
    return Script.of(namer.name(one) for one in transactions).steps


def test_a_step_has_its_request_and_the_recorded_response() -> None:
    first, second = _steps(
        answered(100, READ, VALUE), answered(250, "04 0005 0001", "84 02", unit=9)
    )
    assert (first.number, first.position_ns, first.unit, first.pdu.hex(" ")) == (
        0,
        0,
        1,
        "03 00 00 00 01",
    )
    assert (first.expected, first.latency_ns) == (bytes.fromhex(VALUE), 5 * MS)
    assert (second.position_ns, second.unit, second.reference) == (150 * MS, 9, "input 5")
    assert second.expected == bytes.fromhex("84 02")


def test_steps_come_in_the_order_of_their_requests() -> None:
    steps = _steps(answered(30, READ, VALUE), answered(10, READ, VALUE), unanswered(20, READ))
    assert [step.position_ns // MS for step in steps] == [0, 10, 20]
    assert [step.expected is None for step in steps] == [False, True, False]


def test_equal_requests_share_one_object() -> None:
    first, second = _steps(answered(0, READ, VALUE), answered(10, READ, VALUE))
    assert first.pdu is second.pdu
    assert first.reference is second.reference


def test_an_unsolicited_response_is_no_step_and_a_broadcast_is_one() -> None:
    (step,) = _steps(unasked(0, VALUE), to_all(5, "06 0001 0002"))
    assert (step.is_broadcast, step.unit, step.expected) == (True, 0, None)
    assert Script((step,)).units == frozenset()


def test_a_step_waits_for_earlier_steps_that_were_answered_before_it() -> None:
    pipelined = [
        answered(0, READ, VALUE, latency_ns=30 * MS),
        answered(10, READ, VALUE, latency_ns=5 * MS),
        answered(20, READ, VALUE, latency_ns=50 * MS),
        answered(40, READ, VALUE, latency_ns=1 * MS),
    ]
    assert [step.open_before for step in _steps(*pipelined)] == [(), (0,), (0,), (2,)]


def test_no_step_waits_for_a_request_without_a_response() -> None:
    steps = _steps(*(unanswered(at, READ) for at in range(5)), answered(9, READ, VALUE))
    assert [step.open_before for step in steps] == [()] * 6


def test_the_number_of_open_steps_is_bounded() -> None:
    many = [answered(at, READ, VALUE, latency_ns=10**12) for at in range(MAX_OPEN_REQUESTS + 9)]
    assert max(len(step.open_before) for step in _steps(*many)) == MAX_OPEN_REQUESTS


@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), max_size=30))
def test_a_step_never_waits_for_a_later_one(times: list[tuple[int, int]]) -> None:
    steps = _steps(*(answered(at, READ, VALUE, latency_ns=took * MS) for at, took in times))
    for step in steps:
        assert all(number < step.number for number in step.open_before)
    assert Script(steps).length_ns == (steps[-1].position_ns if steps else 0)
