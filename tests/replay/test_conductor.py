from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core.limits import TURNAROUND_NS, LinkLimits
from mbtool.devices import Namer
from mbtool.replay.clock import PlayClock
from mbtool.replay.conductor import Conductor
from mbtool.replay.judging import ResponseJudge, Tolerance
from mbtool.replay.script import Script, Step
from tests.replay.recorded import MS, answered, to_all, unanswered

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

READ = "03 0000 0001"
VALUE = "03 02 0007"
RIGHT = bytes.fromhex(VALUE)
BEGIN = 1_700_000_000_000_000_000


class Played:
    """A conductor on a clock that stands where a test puts it."""

    def __init__(
        self,
        *transactions: Transaction,
        rate: Fraction | None = Fraction(1),
        limits: LinkLimits | None = None,
        is_loop: bool = False,
    ) -> None:
        namer = Namer()
        script = Script.of(namer.name(one) for one in transactions)
        self.judge = ResponseJudge()
        self.clock = PlayClock(script.length_ns, rate=rate, gap_ns=MS, is_loop=is_loop)
        self.clock.run(BEGIN)
        self.conductor = Conductor(script, self.clock, self.judge, limits or LinkLimits())

    def sent(self, at_ms: float) -> list[int]:
        """The numbers of the steps that are sent at a moment."""
        numbers = []
        while (step := self.conductor.next_step(BEGIN + round(at_ms * MS))) is not None:
            numbers.append(step.number)
        return numbers

    def wake(self, at_ms: float) -> float | None:
        wake_ns = self.conductor.wake_ns(BEGIN + round(at_ms * MS))
        return None if wake_ns is None else (wake_ns - BEGIN) / MS

    def answer(self, number: int, at_ms: float, pdu: bytes = RIGHT) -> bool | None:
        at_ns = BEGIN + round(at_ms * MS)
        return self.conductor.answered(number, pdu, at_ns, at_ns)


def test_steps_are_sent_at_their_recorded_times() -> None:
    played = Played(*(answered(at, READ, VALUE) for at in (0, 100, 250)))
    assert played.sent(0) == [0]
    assert played.answer(0, 5) is True
    assert (played.sent(99), played.wake(99), played.sent(100)) == ([], 100, [1])
    played.answer(1, 105)
    assert (played.wake(105), played.sent(250)) == (250, [2])
    played.answer(2, 255)
    assert played.conductor.has_ended
    assert (played.judge.count, played.judge.wrong) == (3, 0)


def test_a_rate_divides_the_times() -> None:
    played = Played(*(answered(at, READ, VALUE) for at in (0, 100)), rate=Fraction(4))
    played.sent(0)
    played.answer(0, 1)
    assert (played.sent(24.9), played.sent(25)) == ([], [1])


def test_a_step_waits_for_a_late_answer() -> None:
    played = Played(*(answered(at, READ, VALUE) for at in (0, 100)))
    played.sent(0)
    assert played.sent(150) == []
    assert played.wake(150) == LinkLimits().timeout_ns / MS
    played.answer(0, 160)
    assert played.sent(160) == [1]


def test_requests_that_were_open_at_once_are_open_at_once_again() -> None:
    played = Played(*(answered(at, READ, VALUE, latency_ns=50 * MS) for at in (0, 10, 20, 80)))
    assert [played.sent(at) for at in (0, 10, 20, 80)] == [[0], [1], [2], []]
    played.answer(1, 81)
    played.answer(0, 82)
    assert played.sent(82) == []
    played.answer(2, 83)
    assert played.sent(83) == [3]


def test_at_maximum_speed_steps_wait_for_responses_only() -> None:
    played = Played(*(answered(at, READ, VALUE) for at in (0, 1000, 2000)), rate=None)
    assert played.sent(0) == [0]
    played.answer(0, 1)
    assert played.sent(1) == [1]


def test_no_step_waits_for_a_request_without_a_response() -> None:
    played = Played(unanswered(0, READ), unanswered(5, READ), answered(10, READ, VALUE))
    assert [played.sent(at) for at in (0, 5, 10)] == [[0], [1], [2]]
    played.answer(2, 15)
    assert not played.conductor.has_ended
    given_up = played.conductor.expire(BEGIN + LinkLimits().timeout_ns + 5 * MS)
    assert [(step.number, is_right) for step, is_right in given_up] == [(0, True), (1, True)]
    assert played.conductor.has_ended


def test_a_request_without_a_response_is_given_up() -> None:
    played = Played(answered(0, READ, VALUE), answered(10, READ, VALUE))
    played.sent(0)
    assert played.conductor.expire(BEGIN + LinkLimits().timeout_ns - 1) == []
    ((step, is_right),) = played.conductor.expire(BEGIN + LinkLimits().timeout_ns)
    assert (step.number, is_right) == (0, False)
    assert played.sent(LinkLimits().timeout_ns / MS) == [1]


def test_a_request_can_be_given_up_before_its_time_out() -> None:
    played = Played(answered(0, READ, VALUE), to_all(5, "06 0000 0001"), answered(10, READ, VALUE))
    played.sent(0)
    ((step, is_right),) = played.conductor.give_up(0, BEGIN + 1)
    assert (step.number, is_right) == (0, False)
    assert played.conductor.give_up(0, BEGIN + 1) == []
    assert played.sent(5) == [1]
    assert played.conductor.give_up(1, BEGIN + 5 * MS) == []  # A broadcast has no answer.
    assert (played.judge.count, played.judge.wrong) == (2, 1)


def test_a_serial_line_carries_one_request_at_a_time() -> None:
    limits = LinkLimits(one_at_a_time=True, pause_ns=4 * MS)
    played = Played(unanswered(0, READ), answered(1, READ, VALUE), limits=limits)
    played.sent(0)
    assert played.sent(1) == []
    played.conductor.expire(BEGIN + LinkLimits().timeout_ns)
    after = LinkLimits().timeout_ns / MS
    assert (played.sent(after), played.wake(after)) == ([], after + 4)
    assert played.sent(after + 4) == [1]


def test_after_a_broadcast_there_is_a_pause() -> None:
    played = Played(to_all(0, "06 0001 0007"), answered(1, READ, VALUE))
    assert played.sent(0) == [0]
    assert (played.sent(1), played.wake(1)) == ([], TURNAROUND_NS / MS)
    assert played.sent(TURNAROUND_NS / MS) == [1]


def test_latencies_and_pauses_count_from_the_last_byte() -> None:
    played = Played(to_all(0, "06 0001 0007"), answered(1, READ, VALUE, latency_ns=8 * MS))
    first = played.conductor.next_step(BEGIN)
    assert isinstance(first, Step)
    played.conductor.note_sent(first, BEGIN + 10 * MS)
    free_ms = TURNAROUND_NS // MS + 10
    assert (played.sent(free_ms - 1), played.wake(free_ms - 1)) == ([], free_ms)
    second = played.conductor.next_step(BEGIN + free_ms * MS)
    assert isinstance(second, Step)
    played.conductor.note_sent(second, BEGIN + (free_ms + 20) * MS)
    tolerant = ResponseJudge(tolerance=Tolerance(share=0.0))
    tolerant.judge(second, RIGHT, 9 * MS)
    assert played.answer(1, free_ms + 29) is True
    assert tolerant.differences() == []


def test_unsolicited_responses_are_counted() -> None:
    played = Played(answered(0, READ, VALUE))
    assert played.answer(0, 0) is None
    played.sent(0)
    played.answer(0, 1)
    assert played.answer(0, 2) is None
    assert (played.conductor.unsolicited, played.judge.count) == (2, 1)


def test_a_loop_begins_again() -> None:
    played = Played(answered(0, READ, VALUE), answered(10, READ, VALUE), is_loop=True)
    for lap_ms in (0, 11, 22):
        assert played.sent(lap_ms) == [0]
        played.answer(0, lap_ms + 1)
        assert played.sent(lap_ms + 10) == [1]
        played.answer(1, lap_ms + 10.5)
        assert not played.conductor.has_ended
    assert played.conductor.sent == 6


def test_in_a_pause_nothing_is_sent() -> None:
    played = Played(answered(0, READ, VALUE), answered(10, READ, VALUE))
    played.sent(0)
    played.answer(0, 1)
    played.clock.pause(BEGIN + 5 * MS)
    assert (played.sent(50), played.wake(50)) == ([], None)
    played.clock.run(BEGIN + 100 * MS)
    assert (played.wake(100), played.sent(105)) == (105, [1])


def test_lateness_is_that_of_the_player_alone() -> None:
    played = Played(*(answered(at, READ, VALUE) for at in (0, 100, 200)))
    played.sent(0.25)  # woken late
    played.answer(0, 150)  # answered late
    played.sent(150)
    played.answer(1, 151)
    played.sent(200.5)
    assert [value / MS for value in played.conductor.lateness.values] == [0.25, 0.5]


@given(
    st.lists(st.tuples(st.integers(0, 500), st.integers(1, 80)), min_size=1, max_size=20),
    st.lists(st.integers(0, 30), min_size=1, max_size=10),
)
def test_every_step_is_sent_once_in_order_and_never_before_its_time(
    recorded: list[tuple[int, int]], delays: list[int]
) -> None:
    played = Played(*(answered(at, READ, VALUE, latency_ns=took * MS) for at, took in recorded))
    order: list[int] = []
    answers: dict[int, int] = {}
    at_ms = 0
    while not played.conductor.has_ended:
        assert at_ms < 100_000
        for number in played.sent(at_ms):
            order.append(number)
            answers[number] = at_ms + delays[number % len(delays)]
        for number in [each for each, due in answers.items() if due <= at_ms]:
            assert played.answer(number, answers.pop(number)) is True
        at_ms += 1
    assert order == list(range(len(recorded)))
    assert all(late >= 0 for late in played.conductor.lateness.values)


def test_while_the_clock_stands_still_only_steps_are_sent() -> None:
    played = Played(*(answered(at, READ, VALUE) for at in (0, 100, 250)))
    played.sent(0)
    played.answer(0, 5)
    played.clock.pause(BEGIN + 10 * MS)
    assert (played.sent(500), played.wake(500)) == ([], None)
    played.conductor.allow_step(BEGIN)
    assert played.wake(500) == 500
    assert (played.sent(500), played.sent(501)) == ([1], [])
    played.answer(1, 505)
    played.clock.run(BEGIN + 600 * MS)
    assert (played.sent(749), played.sent(750)) == ([], [2])
    assert list(played.conductor.lateness.values) == [0, 0]
