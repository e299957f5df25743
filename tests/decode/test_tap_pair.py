"""A line of which each side has a tap of its own."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.core.limits import MAX_CLOCK_STEP_NS
from mbtool.decode.pairing import BUS_TIMEOUT_NS
from mbtool.decode.tap_pair import LOOKAHEAD_NS, MAX_HELD, MISPLACED_FRAMES, TapPair
from mbtool.modbus.adu import DirectionBy, ascii_adu, rtu_adu
from mbtool.modbus.pdu import pdu_length
from mbtool.modbus.transaction import Outcome
from mbtool.serial_line.rtu import WINDOW
from tests.feeding import START_NS, pieces
from tests.modbus.reading import adus, transactions, wire_events
from tests.strategies import SIZES, Exchange, exchanges

if TYPE_CHECKING:
    from mbtool.decode.connections import Decoded

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
FORMAT = SerialFormat(19200)
MS = 1_000_000
SECOND = 1_000_000_000
READ = bytes.fromhex("03 006B 0001")  # read holding registers, address 107, quantity 1
ANSWER = bytes.fromhex("03 02 022B")
OTHER_READ = bytes.fromhex("04 0000 0002")
OTHER_ANSWER = bytes.fromhex("04 04 0001 0002")
Read = tuple[Direction, bytes, int]
"""Who spoke, the bytes, and the time of the last of them."""


@dataclass
class Wires:
    """Writes down what both sides say, and when it is read."""

    format: SerialFormat = FORMAT
    now_ns: int = START_NS
    reads: list[Read] = field(default_factory=list)

    def say(
        self, speaker: Direction, data: bytes, *, after_ms: float = 5, late_ms: float = 0
    ) -> Wires:
        """An ADU behind a silence, that its adapter delivers late."""
        self.now_ns += int(after_ms * MS) + len(data) * self.format.character_ns
        self.reads.append((speaker, data, self.now_ns + int(late_ms * MS)))
        return self

    def ask(
        self, pdu: bytes = READ, unit: int = 5, *, after_ms: float = 5, late_ms: float = 0
    ) -> Wires:
        return self.say(REQUEST, rtu_adu(unit, pdu), after_ms=after_ms, late_ms=late_ms)

    def answer(
        self, pdu: bytes = ANSWER, unit: int = 5, *, after_ms: float = 5, late_ms: float = 0
    ) -> Wires:
        return self.say(RESPONSE, rtu_adu(unit, pdu), after_ms=after_ms, late_ms=late_ms)

    def decoded(self, taps: TapPair | None = None) -> list[Decoded]:
        """What comes out when the reads are fed in the order of their times."""
        return feed(
            taps or TapPair("a+b", self.format), sorted(self.reads, key=lambda read: read[2])
        )


def feed(taps: TapPair, reads: list[Read]) -> list[Decoded]:
    decoded: list[Decoded] = []
    for read in reads:
        decoded += taps.feed(*read)
    return decoded + taps.close()


def told(decoded: list[Decoded]) -> list[tuple[str, str | None, int]]:
    """Outcome, response and retries of each transaction."""
    return [
        (one.outcome.value, one.response_raw.hex() if one.response_raw else None, one.retries)
        for one in transactions(decoded)
    ]


def test_a_request_and_its_response_become_a_transaction_whose_direction_is_certain() -> None:
    decoded = Wires().ask().answer(after_ms=8).decoded()
    (transaction,) = transactions(decoded)
    assert [type(one).__name__ for one in decoded] == ["Adu", "Adu", "Transaction"]
    assert (transaction.link, transaction.outcome) == ("a+b", Outcome.OK)
    assert (transaction.direction_by, transaction.confidence) == (DirectionBy.PORT, 1.0)
    assert transaction.latency_ns == 8 * MS


def test_echoes_are_told_apart_by_their_port() -> None:
    write = bytes.fromhex("06 0001 0007")
    wires = Wires().ask(write).answer(write).ask(write).ask(write, after_ms=200).answer(write)
    assert told(wires.decoded()) == [
        ("ok", rtu_adu(5, write).hex(), 0),
        ("no-answer", None, 0),
        ("ok", rtu_adu(5, write).hex(), 1),
    ]


def test_a_capture_that_begins_with_a_response_is_not_shifted_by_one() -> None:
    wires = Wires().answer()
    for value in range(12):
        wires.ask().answer(bytes([3, 2, 0, value]))
    first, *others = transactions(wires.decoded())
    assert first.outcome is Outcome.NOT_CAPTURED
    assert [one.response_values for one in others] == [[value] for value in range(12)]


@pytest.mark.parametrize(("late_ms", "pause_ms"), [(4, 3), (16, 20), (40, 100)])
def test_a_response_that_is_read_before_its_request_belongs_to_it(
    late_ms: int, pause_ms: int
) -> None:
    wires = Wires()
    for value in range(6):
        wires.ask(after_ms=pause_ms, late_ms=late_ms).answer(bytes([3, 2, 0, value]))
    assert [one.response_values for one in transactions(wires.decoded())] == [
        [value] for value in range(6)
    ]


@pytest.mark.parametrize("late_ms", [4, 16, 40])
def test_a_response_that_is_read_after_the_next_request_belongs_to_its_own(late_ms: int) -> None:
    wires = Wires()
    for value in range(6):
        wires.ask(after_ms=3).answer(bytes([3, 2, 0, value]), late_ms=late_ms)
    assert [one.response_values for one in transactions(wires.decoded())] == [
        [value] for value in range(6)
    ]


def test_a_response_much_before_the_first_request_answers_a_request_before_the_capture() -> None:
    wires = Wires().answer().ask(after_ms=0, late_ms=80)
    assert [one.outcome for one in transactions(wires.decoded())] == ["not-captured", "no-answer"]


def test_a_late_answer_of_a_slow_slave_is_not_the_next_requests() -> None:
    wires = Wires().ask().answer(after_ms=400).ask(after_ms=3).answer(after_ms=400).ask(after_ms=3)
    assert [one.outcome for one in transactions(wires.decoded())] == ["ok", "ok", "no-answer"]


def test_a_retry_is_answered_though_its_answer_is_read_first() -> None:
    wires = Wires().ask(late_ms=12).answer().ask(late_ms=12)
    wires.ask(after_ms=300, late_ms=12).answer().ask(late_ms=12).answer()
    assert told(wires.decoded()) == [
        ("ok", rtu_adu(5, ANSWER).hex(), 0),
        ("no-answer", None, 0),
        ("ok", rtu_adu(5, ANSWER).hex(), 1),
        ("ok", rtu_adu(5, ANSWER).hex(), 0),
    ]


def test_a_broadcast_has_no_response() -> None:
    write = bytes.fromhex("06 0001 0007")
    wires = Wires().ask(write, unit=0).ask().answer()
    assert [one.outcome for one in transactions(wires.decoded())] == ["broadcast", "ok"]


def test_ascii_may_have_two_taps() -> None:
    line = SerialFormat(9600, 7, "E", 1)
    wires = Wires(line).say(REQUEST, ascii_adu(5, READ)).say(RESPONSE, ascii_adu(5, ANSWER))
    decoded = wires.decoded(TapPair("a+b", line, ascii=True))
    assert [(one.transport, one.outcome) for one in transactions(decoded)] == [("ascii", "ok")]


def test_the_order_in_which_the_sides_are_read_makes_no_difference() -> None:
    wires = Wires()
    for _ in range(4):
        wires.ask().answer().ask(OTHER_READ).answer(OTHER_ANSWER)
    requests = [read for read in wires.reads if read[0] is REQUEST]
    responses = [read for read in wires.reads if read[0] is RESPONSE]
    expected = wires.decoded()
    assert len(transactions(expected)) == 8
    assert feed(TapPair("a+b", FORMAT), requests + responses) == expected
    assert feed(TapPair("a+b", FORMAT), responses + requests) == expected


def test_bytes_that_cannot_be_read_say_who_sent_them() -> None:
    (event,) = wire_events(Wires().say(RESPONSE, b"\xff" * 9).decoded())
    assert (event.link, event.raw) == ("a+b", b"\xff" * 9)
    assert event.message.startswith("9 bytes of a slave: ")


def test_a_transaction_comes_out_when_both_sides_are_known_to_be_silent() -> None:
    wires = Wires().ask().answer()
    taps = TapPair("a+b", FORMAT)
    for read in wires.reads:
        assert taps.feed(*read) == []
    assert transactions(taps.advance(wires.now_ns + 5 * MS)) == []
    assert len(transactions(taps.advance(wires.now_ns + LOOKAHEAD_NS))) == 1


def test_a_request_that_waits_times_out_in_silence() -> None:
    wires = Wires().ask()
    taps = TapPair("a+b", FORMAT)
    assert taps.feed(*wires.reads[0]) == []
    assert [type(one).__name__ for one in taps.advance(wires.now_ns + BUS_TIMEOUT_NS)] == ["Adu"]
    (transaction,) = transactions(taps.advance(wires.now_ns + BUS_TIMEOUT_NS + 1))
    assert transaction.outcome is Outcome.NO_ANSWER


def test_a_request_does_not_time_out_while_its_response_is_held() -> None:
    wires = Wires().ask()
    wires.answer(after_ms=BUS_TIMEOUT_NS / MS - 10)
    taps = TapPair("a+b", FORMAT)
    decoded = [*taps.feed(*wires.reads[0]), *taps.feed(*wires.reads[1])]
    # The response has ended, and a request may have come before it that is read later.
    decoded += taps.advance(wires.reads[0][2] + BUS_TIMEOUT_NS + 5 * MS)
    assert [one.outcome for one in transactions(decoded + taps.close())] == [Outcome.OK]


def test_a_side_that_says_nothing_holds_the_other_up_for_a_second() -> None:
    taps = TapPair("a+b", FORMAT)
    wires = Wires()
    decoded: list[Decoded] = []
    for _ in range(20):
        wires.ask(after_ms=100)
        decoded += taps.feed(*wires.reads[-1])
    held_ns = wires.now_ns - adus(decoded)[-1].end_ns
    assert held_ns <= MAX_CLOCK_STEP_NS + LOOKAHEAD_NS + 200 * MS


def stepped(wires: Wires, at: int, by_ns: int = 3600 * SECOND) -> list[Read]:
    """The reads, as a clock says that is set back before one of them."""
    return [
        (speaker, data, ts_ns if place < at else ts_ns - by_ns)
        for place, (speaker, data, ts_ns) in enumerate(wires.reads)
    ]


@pytest.mark.parametrize("ascii_line", [False, True])
def test_a_clock_that_is_set_back_costs_no_transaction(ascii_line: bool) -> None:
    make = ascii_adu if ascii_line else rtu_adu
    wires = Wires()
    for value in range(20):
        wires.say(REQUEST, make(5, READ)).say(RESPONSE, make(5, bytes([3, 2, 0, value])))
    reads = stepped(wires, 20)
    # The slaves' port is read first.
    pairs = zip(reads[0::2], reads[1::2], strict=True)
    reads = [read for request, response in pairs for read in (response, request)]
    done = transactions(feed(TapPair("a+b", FORMAT, ascii=ascii_line), reads))
    assert [one.outcome for one in done] == ["ok"] * 20
    assert [one.response_values for one in done] == [[value] for value in range(20)]


def test_a_clock_that_is_set_back_before_a_response_leaves_it_its_request() -> None:
    wires = Wires()
    for value in range(6):
        wires.ask().answer(bytes([3, 2, 0, value]))
    done = transactions(feed(TapPair("a+b", FORMAT), stepped(wires, 5)))
    assert [one.response_values for one in done] == [[value] for value in range(6)]


def test_behind_a_clock_that_is_set_back_each_side_still_waits_for_the_other() -> None:
    wires = Wires().ask().answer().ask().answer()
    reads = stepped(wires, 2)
    taps = TapPair("a+b", FORMAT)
    for read in reads[:2]:
        taps.feed(*read)
    assert len(transactions(taps.feed(*reads[3]))) == 1  # What came before it waits no more.
    assert taps.feed(*reads[2]) == []
    assert [one.outcome for one in transactions(taps.close())] == ["ok"]


def test_a_clock_that_is_set_back_makes_the_sides_as_new() -> None:
    """What was learned of the delays of the adapters is forgotten, as the times are others."""
    wires = Wires()
    for _ in range(2):
        wires.ask(after_ms=3).answer(after_ms=5, late_ms=45)
    for value in range(6):
        pause_ms = 3 if value else 1000
        wires.ask(after_ms=pause_ms)
        wires.answer(bytes([3, 2, 0, value]), after_ms=60, late_ms=45)
    in_order = sorted(wires.reads, key=lambda read: read[2])
    reads = stepped(replace(wires, reads=in_order), 4)
    anew = told(feed(TapPair("a+b", FORMAT), reads[4:]))
    assert told(feed(TapPair("a+b", FORMAT), reads))[2:] == anew
    assert told(wires.decoded())[2:] != anew


def test_silence_that_a_clock_set_back_tells_gives_out_what_waits() -> None:
    wires = Wires().ask().answer()
    taps = TapPair("a+b", FORMAT)
    for read in wires.reads:
        assert taps.feed(*read) == []
    assert len(transactions(taps.advance(wires.now_ns - 3600 * SECOND))) == 1


@pytest.mark.parametrize(("back_ns", "given"), [(0, 0), (1, 1)])
def test_a_time_a_little_before_what_is_known_is_no_clock_set_back(
    back_ns: int, given: int
) -> None:
    wires = Wires().ask().answer()
    taps = TapPair("a+b", FORMAT)
    for read in wires.reads:
        assert taps.feed(*read) == []
    request_ns, response_ns = (read[2] for read in wires.reads)
    told_ns = response_ns - MAX_CLOCK_STEP_NS - back_ns
    assert len(transactions(taps.feed(RESPONSE, b"\x05", told_ns))) == given
    silent = TapPair("a+b", FORMAT)
    for read in wires.reads:
        silent.feed(*read)
    # Silence is of both sides: the master's last read is the earlier one.
    told_ns = request_ns - MAX_CLOCK_STEP_NS - back_ns
    assert len(transactions(silent.advance(told_ns))) == given


def test_skipped_bytes_of_a_side_give_up_a_request_of_the_other() -> None:
    wires = Wires().ask().say(RESPONSE, b"\xff" * 9, after_ms=2 * BUS_TIMEOUT_NS / MS)
    decoded = wires.decoded()
    assert [type(one).__name__ for one in decoded] == ["Adu", "Transaction", "WireEvent"]


@pytest.mark.parametrize(("wait_ns", "count"), [(-1, 0), (0, 2)])
def test_an_event_comes_out_once_both_sides_are_known_long_enough_behind_it(
    wait_ns: int, count: int
) -> None:
    """From the start of the response on, which the request goes before."""
    wires = Wires().ask().answer()
    taps = TapPair("a+b", FORMAT)
    for read in wires.reads:
        taps.feed(*read)
    start_ns = wires.now_ns - len(wires.reads[1][1]) * FORMAT.character_ns
    decoded = taps.advance(start_ns + LOOKAHEAD_NS + wait_ns)
    assert len(adus(decoded)) == (count or 1)


def test_held_bytes_keep_back_what_the_other_side_said_behind_them() -> None:
    taps = TapPair("a+b", FORMAT)
    request, response = rtu_adu(5, READ), rtu_adu(5, ANSWER)
    assert taps.feed(REQUEST, request, START_NS) == []
    assert taps.feed(RESPONSE, response[:4], START_NS + 20 * MS) == []
    assert adus(taps.feed(REQUEST, request, START_NS + 400 * MS)) == []
    last_ns = START_NS + 20 * MS + 3 * FORMAT.character_ns
    decoded = taps.feed(RESPONSE, response[4:], last_ns) + taps.close()
    assert [one.outcome for one in transactions(decoded)] == [Outcome.OK, Outcome.NO_ANSWER]


def test_ports_are_told_at_the_time_of_the_frame_that_decides() -> None:
    wires = Wires()
    for _ in range(MISPLACED_FRAMES):
        wires.say(REQUEST, rtu_adu(5, ANSWER), after_ms=30)
    decoded = wires.decoded()
    (event,) = [one for one in wire_events(decoded) if one.kind is EventKind.MISPLACED]
    assert event.link == "a+b"
    assert event.ts_ns == adus(decoded)[-1].start_ns


def test_memory_is_bounded_whatever_the_times_say() -> None:
    line = SerialFormat(921600)  # Too fast for the bound by time.
    taps, wires = TapPair("a+b", line), Wires(line)
    decoded: list[Decoded] = []
    for _ in range(3 * MAX_HELD):
        wires.ask(after_ms=0)
        decoded += taps.feed(*wires.reads[-1])
    assert wires.now_ns - START_NS < MAX_CLOCK_STEP_NS
    assert 3 * MAX_HELD - len(adus(decoded)) <= MAX_HELD + WINDOW // 8


def test_ports_that_are_exchanged_are_told_once() -> None:
    wires = Wires()
    for _ in range(3 * MISPLACED_FRAMES):
        wires.say(RESPONSE, rtu_adu(5, READ)).say(REQUEST, rtu_adu(5, ANSWER))
    events = [event for event in wire_events(wires.decoded()) if event.kind is EventKind.MISPLACED]
    assert len(events) == 1
    assert "the other way round" in events[0].message


def test_ports_that_are_not_exchanged_are_left_alone_whatever_the_noise() -> None:
    wires = Wires().ask().answer()
    for _ in range(3 * MISPLACED_FRAMES):
        wires.say(REQUEST, rtu_adu(5, ANSWER))
    assert EventKind.MISPLACED not in [event.kind for event in wire_events(wires.decoded())]


@pytest.mark.parametrize(("misplaced", "events"), [(3, 0), (4, 1)])
@pytest.mark.parametrize(
    ("side", "pdu"), [(REQUEST, ANSWER), (RESPONSE, READ), (RESPONSE, b"\x07")]
)
def test_the_fourth_frame_of_the_other_side_tells_that_ports_are_exchanged(
    side: Direction, pdu: bytes, misplaced: int, events: int
) -> None:
    wires = Wires()
    for _ in range(misplaced):
        wires.say(side, rtu_adu(5, pdu))
    kinds = [event.kind for event in wire_events(wires.decoded())]
    assert kinds.count(EventKind.MISPLACED) == events


def test_that_the_slaves_adapter_is_the_later_one_is_learned_from_quick_responses() -> None:
    wires = Wires().ask(after_ms=3).answer(after_ms=5, late_ms=45)
    for value in range(6):  # Slow ones: each seems to come behind the next request.
        wires.ask(after_ms=3).answer(bytes([3, 2, 0, value]), after_ms=60, late_ms=45)
    assert [one.response_values for one in transactions(wires.decoded())] == [
        [0x022B],
        *([value] for value in range(6)),
    ]


@st.composite
def conversations(draw: st.DrawFn) -> list[Exchange]:
    """Exchanges, some of them several times in a row, as a master polls."""
    chosen = draw(st.lists(exchanges(broadcasts=True), min_size=1, max_size=3))
    return draw(st.lists(st.sampled_from(chosen), min_size=1, max_size=10))


def spoken(conversation: list[Exchange], data: st.DataObject) -> Wires:
    """What both sides say, each pause as long as rules and habits allow."""
    wires = Wires()
    pauses = st.sampled_from((2.1, 3, 7, 20, 60))
    before_ms = 5.0
    for one in conversation:
        wires.ask(one.request, one.unit, after_ms=before_ms)
        if one.response is not None:
            wires.answer(one.response, one.unit, after_ms=data.draw(pauses))
        # A master waits for an answer that does not come.
        patience_ms = 10 if one.outcome is Outcome.BROADCAST else 200
        before_ms = data.draw(pauses) if one.response is not None else patience_ms
    return wires


def _has_structure(one: Exchange) -> bool:
    spoken_by = [(one.request, REQUEST), (one.response, RESPONSE)]
    return all(pdu_length(pdu, speaker) == len(pdu) for pdu, speaker in spoken_by if pdu)


def said(decoded: list[Decoded]) -> list[tuple[object, ...]]:
    """All that transactions say beside times and what follows from them, in order of requests."""
    return [
        (one.unit, one.outcome, one.request_raw, one.response_raw, one.retries)
        for one in sorted(transactions(decoded), key=lambda one: one.start_ns)
    ]


@given(conversation=conversations(), data=st.data())
def test_delays_of_the_adapters_change_no_transaction(
    conversation: list[Exchange], data: st.DataObject
) -> None:
    # Frames whose size nothing tells cannot be parted where an adapter glues them.
    assume(all(_has_structure(one) for one in conversation))
    # Of equal polls in a row only the times tell which is answered; so each has its own unit.
    conversation = [
        replace(one, unit=one.unit and number) for number, one in enumerate(conversation, 1)
    ]
    wires = spoken(conversation, data)
    expected = said(feed(TapPair("a+b", FORMAT), wires.reads))
    assert [outcome for _, outcome, *_ in expected] == [one.outcome for one in conversation]
    delays = {
        speaker: data.draw(st.sampled_from((0, 1, 16))) * MS for speaker in (REQUEST, RESPONSE)
    }
    late: list[Read] = []
    last_ns = {REQUEST: 0, RESPONSE: 0}
    for speaker, frame, ts_ns in wires.reads:
        late_ns = ts_ns + data.draw(st.integers(0, delays[speaker]))
        # What is read behind it cannot have come before it.
        last_ns[speaker] = max(late_ns, last_ns[speaker] + len(frame) * FORMAT.character_ns)
        late.append((speaker, frame, last_ns[speaker]))
    late.sort(key=lambda read: read[2])
    assert said(feed(TapPair("a+b", FORMAT), late)) == expected


@given(conversation=conversations(), sizes=SIZES, data=st.data())
def test_neither_cuts_nor_interleaving_make_a_difference(
    conversation: list[Exchange], sizes: list[int], data: st.DataObject
) -> None:
    wires = spoken(conversation, data)
    expected = feed(TapPair("a+b", FORMAT), wires.reads)
    sides: dict[Direction, list[Read]] = {REQUEST: [], RESPONSE: []}
    for speaker, frame, ts_ns in wires.reads:
        end_ns = ts_ns - len(frame) * FORMAT.character_ns
        for part in pieces(frame, sizes):
            end_ns += len(part) * FORMAT.character_ns
            sides[speaker].append((speaker, part, end_ns))
    mixed: list[Read] = []
    while any(sides.values()):
        # One side may be ahead of the other by what a reading process may take.
        heads = sorted((side for side in sides.values() if side), key=lambda side: side[0][2])
        ahead = heads[-1][0][2] - heads[0][0][2] < MAX_CLOCK_STEP_NS and data.draw(st.booleans())
        mixed.append((heads[-1] if ahead else heads[0]).pop(0))
    assert feed(TapPair("a+b", FORMAT), mixed) == expected
