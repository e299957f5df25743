"""What one tap hears on an ASCII line, cut into frames."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.core.limits import MAX_BACK_NS
from mbtool.decode.connections import Bus
from mbtool.framing.skips import MAX_RUN
from mbtool.modbus.adu import (
    MAX_ASCII_ADU,
    Adu,
    Checksum,
    DirectionBy,
    Skipped,
    Transport,
    Verdict,
    ascii_adu,
)
from mbtool.modbus.transaction import Outcome
from mbtool.serial_line import AsciiSplitter
from mbtool.serial_line import ascii as ascii_module
from mbtool.serial_line.ascii import CHARACTER_TIMEOUT_NS
from mbtool.serial_line.bus_model import BusModel, Classification
from tests.feeding import START_NS, Line, Read, feed_all
from tests.modbus.reading import adus, pdus, raw, skipped, transactions, wire_events, with_parity

if TYPE_CHECKING:
    from collections.abc import Callable

FORMAT = SerialFormat(9600, 7, "E", 1)
EIGHT_BITS = SerialFormat(9600, 8, "N", 1)
REQUEST = b":02010064000198\r\n"  # Unit 2 reads coil 100.
RESPONSE = b":02010100FC\r\n"


def line() -> Line:
    return Line(FORMAT)


def splitter() -> AsciiSplitter:
    return AsciiSplitter(FORMAT)


def verdicts(events: list[Adu | Skipped]) -> list[tuple[Verdict, ...]]:
    return [adu.verdicts for adu in adus(events)]


def test_reads_request_and_response() -> None:
    sent = line().send(REQUEST).frame(RESPONSE, before_ns=20_000_000)
    events = feed_all(splitter(), sent.reads())
    assert pdus(events) == [(2, "0100640001"), (2, "010100")]
    request, response = adus(events)
    assert (request.transport, request.raw) == (Transport.ASCII, REQUEST)
    assert (request.direction, request.direction_by) == (Direction.REQUEST, DirectionBy.FORM)
    assert (response.direction, response.direction_by) == (Direction.RESPONSE, DirectionBy.PENDING)
    assert request.checksum is not None
    assert (request.checksum.received, request.checksum.ok) == (0x98, True)


def test_frame_begins_with_its_colon_and_ends_with_its_line_feed() -> None:
    (adu,) = adus(feed_all(splitter(), line().send(REQUEST).reads()))
    assert adu.start_ns == START_NS
    assert adu.end_ns == START_NS + len(REQUEST) * FORMAT.character_ns


def test_lower_case_digits_are_read_and_told() -> None:
    events = feed_all(splitter(), line().send(RESPONSE.lower()).reads())
    assert pdus(events) == [(2, "010100")]
    assert verdicts(events) == [(Verdict.LOWER_CASE,)]
    assert raw(events) == RESPONSE.lower()


def test_wrong_lrc_is_told_with_both_values() -> None:
    bad = b":02010064000199\r\n"
    (event,) = skipped(feed_all(splitter(), line().send(bad).reads()))
    assert (event.kind, event.raw) == (EventKind.BAD_CHECK, bad)
    assert event.reason == "a frame with LRC 99H, where 98H would be right"
    assert event.checksum == Checksum(received=0x99, computed=0x98)


def test_colon_always_begins_a_frame_anew() -> None:
    events = feed_all(splitter(), line().send(b":0201" + REQUEST).reads())
    (cut_off,) = skipped(events)
    assert (cut_off.raw, cut_off.reason) == (b":0201", "a frame that another colon cuts off")
    assert pdus(events) == [(2, "0100640001")]
    assert verdicts(events) == [(Verdict.RESYNCHRONISED,)]


def test_frame_is_found_again_behind_one_of_too_many_characters() -> None:
    events = feed_all(splitter(), line().send(b":" + b"0" * 600 + b"\r\n" + REQUEST).reads())
    assert [len(one.raw) for one in skipped(events)] == [MAX_ASCII_ADU, 90]
    assert skipped(events)[0].reason == "a frame of more than 513 characters"
    assert verdicts(events) == [(Verdict.NOISE_BEFORE, Verdict.RESYNCHRONISED)]


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b":0201006400019\r\n", "13 hexadecimal digits"),
        (b":020G0064000198\r\n", "'G' (47H) as its character 5"),
        (b":0201\r0064000198\r\n", "0DH as its character 6"),
        (b":0201\r\n", "2 bytes"),
    ],
)
def test_what_is_no_frame_is_one_event_up_to_its_line_feed(bad: bytes, reason: str) -> None:
    events = feed_all(splitter(), line().send(bad).frame(REQUEST).reads())
    (event,) = skipped(events)
    assert (event.raw, event.kind, event.checksum) == (bad, EventKind.SKIPPED, None)
    assert reason in event.reason
    assert verdicts(events) == [()]


def test_silence_of_a_second_ends_an_incomplete_frame() -> None:
    sent = line().send(REQUEST[:9]).frame(REQUEST[9:], before_ns=CHARACTER_TIMEOUT_NS + 1)
    events = feed_all(splitter(), sent.reads())
    assert [(one.raw, one.reason) for one in skipped(events)] == [
        (REQUEST[:9], "a frame that ends in more than 1 s of silence"),
        (REQUEST[9:], "characters outside a frame"),
    ]


def test_silence_of_less_than_a_second_does_not() -> None:
    sent = line().send(REQUEST[:9]).frame(REQUEST[9:], before_ns=CHARACTER_TIMEOUT_NS)
    assert verdicts(feed_all(splitter(), sent.reads())) == [()]


def test_without_times_no_silence_ends_a_frame() -> None:
    fed = AsciiSplitter(FORMAT, timed=False)
    reads: list[Read] = [(REQUEST[:9], START_NS), (REQUEST[9:], START_NS + 3_600_000_000_000)]
    assert fed.feed(*reads[0]) == []
    assert fed.advance(START_NS + 3_600_000_000_000) == []
    assert verdicts(fed.feed(*reads[1])) == [()]


def test_without_times_no_clock_is_set_back_and_nothing_is_glued() -> None:
    fed = AsciiSplitter(FORMAT, timed=False)
    events = feed_all(fed, [(REQUEST[:9], START_NS), (REQUEST[9:] + RESPONSE, 0), (REQUEST, 0)])
    assert verdicts(events) == [(), (), ()]


def test_silence_is_known_without_another_byte() -> None:
    fed = splitter()
    fed.feed(REQUEST[:9], START_NS)
    assert not fed.is_idle
    assert fed.advance(START_NS + CHARACTER_TIMEOUT_NS) == []
    assert raw(fed.advance(START_NS + CHARACTER_TIMEOUT_NS + 1)) == REQUEST[:9]
    assert fed.is_idle


def test_noise_before_a_frame_is_noticed() -> None:
    events = feed_all(splitter(), line().send(b"\xff\x00" + REQUEST).reads())
    assert [one.raw for one in skipped(events)] == [b"\xff\x00"]
    assert adus(events)[0].verdicts == (Verdict.NOISE_BEFORE,)


def test_frame_that_an_adapter_glued_to_the_one_before_is_noticed() -> None:
    events = feed_all(splitter(), line().send(REQUEST + RESPONSE).reads())
    assert verdicts(events) == [(), (Verdict.GLUED,)]
    apart = line().send(REQUEST).frame(RESPONSE, before_ns=1)
    assert verdicts(feed_all(splitter(), apart.reads())) == [(), ()]


def test_what_was_held_goes_on_with_nothing_behind_a_clock_that_was_set_back() -> None:
    back_ns = START_NS - MAX_BACK_NS - 1
    events = feed_all(splitter(), [(REQUEST[:9], START_NS), (REQUEST[9:], back_ns)])
    assert [one.raw for one in skipped(events)] == [REQUEST[:9], REQUEST[9:]]


def test_a_read_with_a_time_a_little_too_early_goes_on_with_what_was_held() -> None:
    fed = splitter()
    events = feed_all(fed, [(REQUEST[:9], START_NS), (REQUEST[9:], START_NS - MAX_BACK_NS)])
    assert [one.raw for one in adus(events)] == [REQUEST]
    assert fed.has_disorder


def test_no_character_comes_before_one_of_the_read_before() -> None:
    events = feed_all(splitter(), [(REQUEST, START_NS), (RESPONSE, START_NS + 1)])
    request, response = adus(events)
    assert (request.end_ns, response.end_ns) == (START_NS, START_NS + 1)
    assert response.start_ns == START_NS - FORMAT.character_ns


def test_long_noise_is_told_in_runs_with_their_own_times() -> None:
    noise = line().send(b"\x00" * (2 * MAX_RUN + 1) + REQUEST)
    events = feed_all(splitter(), noise.reads())
    first_ns = START_NS + FORMAT.character_ns
    run_ns = MAX_RUN * FORMAT.character_ns
    assert [(one.ts_ns, len(one.raw)) for one in skipped(events)] == [
        (first_ns, MAX_RUN), (first_ns + run_ns, MAX_RUN), (first_ns + 2 * run_ns, 1),
    ]  # fmt: skip
    assert feed_all(splitter(), noise.reads([700] * 4)) == events


def test_largest_frame_has_513_characters() -> None:
    largest = ascii_adu(1, b"\x41" + bytes(252))
    assert len(largest) == 513
    assert len(adus(feed_all(splitter(), line().send(largest).reads()))) == 1
    events = feed_all(splitter(), line().send(ascii_adu(1, b"\x41" + bytes(253))).reads())
    assert [len(one.raw) for one in skipped(events)] == [513, 2]


def test_clock_that_was_set_back_ends_what_was_held() -> None:
    fed = splitter()
    fed.feed(REQUEST[:9], START_NS)
    events = fed.feed(REQUEST, START_NS - 3_600_000_000_000)
    assert raw(events) == REQUEST[:9] + REQUEST
    assert adus(events)[0].end_ns == START_NS - 3_600_000_000_000


def test_holds_no_more_than_one_frame_and_a_run_of_noise() -> None:
    noise = random.Random(3).choices(b":0\r\n\xff", k=20_000)
    fed = splitter()
    held = most = 0
    for at, byte in enumerate(noise):
        held += 1 - len(raw(fed.feed(bytes([byte]), START_NS + at * FORMAT.character_ns)))
        most = max(most, held)
    assert most < 513 + MAX_RUN


# A port of 8 data bits on a line of 7.


@pytest.mark.parametrize("parity", ["even", "odd", "mark"])
def test_7_data_bits_heard_with_8_are_read_without_the_parity_bit(parity: str) -> None:
    request, response = with_parity(REQUEST, parity), with_parity(RESPONSE, parity)
    heard = Line(EIGHT_BITS).send(request).frame(response)
    events = feed_all(AsciiSplitter(EIGHT_BITS), heard.reads())
    assert pdus(events) == [(2, "0100640001"), (2, "010100")]
    assert verdicts(events) == [(Verdict.PARITY_IN_DATA,)] * 2
    assert [adu.raw for adu in adus(events)] == [request, response]


def test_8_data_bits_have_no_parity_to_tell() -> None:
    events = feed_all(AsciiSplitter(EIGHT_BITS), Line(EIGHT_BITS).send(REQUEST).reads())
    assert verdicts(events) == [()]


def test_parity_bit_on_a_port_of_7_data_bits_is_damage() -> None:
    events = feed_all(splitter(), line().send(with_parity(REQUEST, "even")).reads())
    assert adus(events) == []


def test_character_whose_bit_7_does_not_fit_the_others_is_damage() -> None:
    damaged = bytearray(REQUEST)
    damaged[3] |= 0x80
    heard = Line(EIGHT_BITS).send(bytes(damaged)).frame(REQUEST)
    events = feed_all(AsciiSplitter(EIGHT_BITS), heard.reads())
    (event,) = skipped(events)
    assert event.reason.startswith("a frame with B0H as its character 4, ")
    assert len(adus(events)) == 1


def test_wrong_lrc_behind_parity_is_told_as_such() -> None:
    bad = with_parity(b":02010064000199\r\n", "even")
    events = feed_all(AsciiSplitter(EIGHT_BITS), Line(EIGHT_BITS).send(bad).reads())
    (event,) = skipped(events)
    assert (event.kind, event.checksum) == (EventKind.BAD_CHECK, Checksum(0x99, 0x98))


# Ends other than CR and LF.


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r.", b"\r\x00", b"\r\r", b"\rA"])
def test_frame_with_another_end_is_read_where_its_lrc_is_right(end: bytes) -> None:
    request, response = REQUEST[:-2] + end, RESPONSE[:-2] + end
    sent = line().send(request).frame(response)
    events = feed_all(splitter(), sent.reads())
    assert [adu.raw for adu in adus(events)] == [request, response]
    assert verdicts(events) == [(Verdict.OTHER_END,)] * 2
    assert skipped(events) == []
    assert adus(events)[0].end_ns == START_NS + len(request) * FORMAT.character_ns


def test_cr_alone_ends_a_frame_when_a_second_of_silence_follows() -> None:
    fed = splitter()
    fed.feed(REQUEST[:-1], START_NS)
    assert fed.advance(START_NS + CHARACTER_TIMEOUT_NS) == []
    (adu,) = adus(fed.advance(START_NS + CHARACTER_TIMEOUT_NS + 1))
    assert (adu.raw, adu.end_ns) == (REQUEST[:-1], START_NS)
    assert adu.verdicts == (Verdict.OTHER_END,)


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r.", b"\r\n"])
def test_frame_with_a_wrong_lrc_is_one_event_whatever_its_end(end: bytes) -> None:
    bad = b":02010064000199" + end
    events = feed_all(splitter(), line().send(bad).frame(REQUEST).reads())
    (event,) = skipped(events)
    assert (event.raw, event.kind) == (bad, EventKind.BAD_CHECK)
    assert len(adus(events)) == 1


def test_frame_without_any_end_is_not_believed() -> None:
    events = feed_all(splitter(), line().send(REQUEST[:-2]).frame(REQUEST).reads())
    assert [one.raw for one in skipped(events)] == [REQUEST[:-2]]


# Function 08, sub-function 3 (V1.1b3, 6.8.1).

CHANGE = bytes.fromhex("08 0003 2E00")  # To a full stop.
DOT = b"."


def ended(pdu: bytes, end: bytes = b"\n") -> bytes:
    return ascii_adu(2, pdu)[:-1] + end


def other_ends(events: list[Adu | Skipped]) -> list[bool]:
    return [Verdict.OTHER_END in each for each in verdicts(events)]


READ, READ_ANSWER = bytes.fromhex("01 0064 0001"), bytes.fromhex("01 01 00")


@pytest.mark.parametrize("answered_with", [b"\n", DOT])
def test_delimiter_changes_for_the_frames_after_the_exchange(answered_with: bytes) -> None:
    sent = line().send(ended(CHANGE)).frame(ended(CHANGE, answered_with))
    sent.frame(ended(READ, DOT)).frame(ended(READ_ANSWER, DOT))
    events = feed_all(splitter(), sent.reads())
    assert other_ends(events) == [False] * 4
    assert [adu.direction for adu in adus(events)] == [Direction.REQUEST, Direction.RESPONSE] * 2


def test_frame_with_lf_after_the_change_is_told() -> None:
    sent = line().send(ended(CHANGE)).frame(ended(CHANGE)).frame(ended(READ))
    assert other_ends(feed_all(splitter(), sent.reads())) == [False, False, True]


def test_change_that_is_refused_changes_nothing() -> None:
    sent = line().send(ended(CHANGE)).frame(ended(bytes.fromhex("88 03")))
    sent.frame(ended(READ)).frame(ended(READ_ANSWER))
    assert other_ends(feed_all(splitter(), sent.reads())) == [False] * 4


def test_answer_that_may_be_a_repeated_request_changes_nothing() -> None:
    class Unsure(BusModel):
        def classify(self, *_: object, **__: object) -> Classification:
            return Classification(Direction.RESPONSE, DirectionBy.PENDING, 0.6)

    sent = line().send(ended(CHANGE)).frame(ended(READ))
    assert other_ends(feed_all(AsciiSplitter(FORMAT, Unsure()), sent.reads())) == [False, False]


def test_delimiter_may_have_8_bits() -> None:
    change = CHANGE[:3] + b"\x8a\x00"
    sent = Line(EIGHT_BITS).send(ended(READ, b"\x8a")).frame(ended(change)).frame(ended(change))
    events = feed_all(AsciiSplitter(EIGHT_BITS), sent.frame(ended(READ, b"\x8a")).reads())
    assert other_ends(events) == [True, False, False, False]


def test_frame_with_a_wrong_lrc_ends_with_the_changed_delimiter() -> None:
    bad = b":02010064000199\r."
    fed = splitter()
    sent = line().send(ended(CHANGE)).frame(ended(CHANGE)).frame(bad)
    events: list[Adu | Skipped] = []
    for data, ts_ns in sent.reads():
        events += fed.feed(data, ts_ns)
    assert [one.raw for one in skipped(events)] == [bad]
    assert fed.is_idle


def test_a_tap_that_hears_only_requests_learns_the_change_from_its_use() -> None:
    fed = AsciiSplitter(FORMAT, speaker=Direction.REQUEST)
    sent = line().send(ended(CHANGE)).frame(ended(READ)).frame(ended(READ, DOT)).frame(ended(READ))
    assert other_ends(feed_all(fed, sent.reads())) == [False, False, False, True]


# Who speaks.


class _NeverAsked(BusModel):
    def classify(self, *_: object, **__: object) -> Classification:
        raise AssertionError("asked who speaks")

    spoke = classify


@pytest.mark.parametrize("speaker", [Direction.REQUEST, Direction.RESPONSE])
def test_a_tap_of_one_side_knows_who_speaks(speaker: Direction) -> None:
    fed = AsciiSplitter(FORMAT, _NeverAsked(), speaker=speaker)
    for adu in adus(feed_all(fed, line().send(REQUEST).frame(RESPONSE).reads())):
        assert (adu.direction, adu.direction_by) == (speaker, DirectionBy.PORT)
        assert (adu.confidence, adu.verdicts) == (1.0, ())


def test_frame_of_which_it_is_not_sure_who_spoke_is_ambiguous() -> None:
    class Unsure(BusModel):
        def classify(self, *_: object, **__: object) -> Classification:
            return Classification(Direction.REQUEST, DirectionBy.IDLE, 0.6)

    events = feed_all(AsciiSplitter(FORMAT, Unsure()), line().send(REQUEST).reads())
    assert verdicts(events) == [(Verdict.AMBIGUOUS,)]


def test_request_that_is_repeated_behind_a_damaged_answer_is_a_request() -> None:
    write = ascii_adu(2, bytes.fromhex("06 0064 0001"))  # Answered with its own bytes.
    sent = line().send(write).frame(write[:5] + b"?" + write[6:]).frame(write).frame(write)
    sent.frame(REQUEST)
    assert [adu.direction for adu in adus(feed_all(splitter(), sent.reads()))] == [
        Direction.REQUEST, Direction.REQUEST, Direction.RESPONSE, Direction.REQUEST,
    ]  # fmt: skip


# As transactions, and the work it takes.


@pytest.mark.parametrize("parity", ["even", "odd", "space"])
def test_bus_joins_the_lt830_s_examples(parity: str) -> None:
    # INE-350, 6.5.1, 6.5.3 (its LRC 4D is a misprint of 4B) and the example of function 15.
    heard = Line(EIGHT_BITS)
    for frame in (
        b":02010064000198\r\n", b":02010100FC\r\n",
        b":020300CD00032B\r\n", b":020306001E007800144B\r\n",
        b":020F00640001010188\r\n", b":020F006400018A\r\n",
    ):  # fmt: skip
        heard.frame(with_parity(frame, parity), before_ns=20_000_000)
    decoded = feed_all(Bus("rs485", EIGHT_BITS, ascii=True), heard.reads())
    assert wire_events(decoded) == []
    read, pid, start = transactions(decoded)
    assert [one.outcome for one in (read, pid, start)] == [Outcome.OK] * 3
    assert (read.address, read.response_values) == (100, [0])
    assert (pid.address, pid.response_values) == (205, [30, 120, 20])
    assert (start.address, start.request_values) == (100, [1])
    assert (Verdict.PARITY_IN_DATA in pid.verdicts) == (parity != "space")


@pytest.mark.parametrize(
    "characters",
    [b":" * 3000, b"\r" * 3000, b":" + b"0" * 3000, (b":" + b"01" * 50 + b"\r" * 400) * 6,
     b":00\r" * 800, b":\xb0\r.\n" * 600],
    ids=["colons", "crs", "digits", "digits-and-crs", "beginnings", "bits"],
)  # fmt: skip
def test_each_character_is_read_three_times_at_most(
    characters: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = 0

    def counting(function: Callable[..., object]) -> Callable[..., object]:
        def counted(frame: bytes, **options: bool) -> object:
            nonlocal read
            read += len(frame)
            return function(frame, **options)

        return counted

    for name in ("read_frame", "why_unreadable"):
        monkeypatch.setattr(ascii_module, name, counting(getattr(ascii_module, name)))
    feed_all(AsciiSplitter(EIGHT_BITS), Line(EIGHT_BITS).send(characters).reads())
    assert read <= 3 * len(characters)
