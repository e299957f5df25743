"""What one tap hears on an ASCII line, cut into frames."""

from __future__ import annotations

import random

import pytest

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.modbus import AsciiSplitter, DirectionBy, Transport, Verdict, ascii_adu
from mbtool.modbus.ascii import CHARACTER_TIMEOUT_NS
from mbtool.modbus.skips import MAX_RUN
from tests.feeding import START_NS, Line, feed_all
from tests.modbus.reading import adus, pdus, raw, skipped

FORMAT = SerialFormat(9600, 7, "E", 1)
REQUEST = b":02010064000198\r\n"  # Unit 2 reads coil 100.
RESPONSE = b":02010100FC\r\n"


def line() -> Line:
    return Line(FORMAT)


def splitter() -> AsciiSplitter:
    return AsciiSplitter(FORMAT)


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


def test_hexadecimal_digits_may_be_small() -> None:
    events = feed_all(splitter(), line().send(RESPONSE.lower()).reads())
    assert pdus(events) == [(2, "010100")]


def test_wrong_lrc_is_told_with_both_values() -> None:
    bad = b":02010064000199\r\n"
    (event,) = skipped(feed_all(splitter(), line().send(bad).reads()))
    assert (event.kind, event.raw) == (EventKind.BAD_CHECK, bad)
    assert event.reason == "a frame with LRC 99H, where 98H would be right"


def test_colon_always_begins_a_frame_anew() -> None:
    events = feed_all(splitter(), line().send(b":0201" + REQUEST).reads())
    assert [one.raw for one in skipped(events)] == [b":0201"]
    assert pdus(events) == [(2, "0100640001")]


@pytest.mark.parametrize(
    "bad", [b":0201006400019\r\n", b":020G0064000198\r\n", b":02010064000198\n", b":0201\r\n"]
)
def test_what_is_no_frame_is_skipped_up_to_its_line_feed(bad: bytes) -> None:
    events = feed_all(splitter(), line().send(bad + REQUEST).reads())
    assert [one.raw for one in skipped(events)] == [bad]
    assert len(adus(events)) == 1


def test_silence_of_a_second_ends_an_incomplete_frame() -> None:
    sent = line().send(REQUEST[:9]).frame(REQUEST[9:], before_ns=CHARACTER_TIMEOUT_NS + 1)
    events = feed_all(splitter(), sent.reads())
    assert [one.raw for one in skipped(events)] == [REQUEST[:9], REQUEST[9:]]


def test_silence_of_less_than_a_second_does_not() -> None:
    sent = line().send(REQUEST[:9]).frame(REQUEST[9:], before_ns=CHARACTER_TIMEOUT_NS)
    assert len(adus(feed_all(splitter(), sent.reads()))) == 1


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
