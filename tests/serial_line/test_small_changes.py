"""Limits of what one tap hears on an RTU line, to the byte, the nanosecond and the bit."""

from __future__ import annotations

import random
from math import log2

import pytest

from mbtool.core import Direction, SerialFormat
from mbtool.modbus.adu import Adu, DirectionBy, Skipped, Verdict, rtu_adu
from mbtool.serial_line import RtuSplitter, costs
from mbtool.serial_line.bus_model import SURE
from mbtool.serial_line.bus_state import bits_of
from tests.feeding import START_NS, Line, feed_all
from tests.modbus.reading import adus, raw, skipped

FORMAT = SerialFormat(19200, 8, "E", 1)
T3_5, CHARACTER = FORMAT.t3_5_ns, FORMAT.character_ns
MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
READ = rtu_adu(0x11, bytes.fromhex("03 006B 0003"))
ANSWER = rtu_adu(0x11, bytes.fromhex("03 06 022B 0000 0064"))
OTHER = rtu_adu(0x12, bytes.fromhex("04 0008 0001"))
OTHER_ANSWER = rtu_adu(0x12, bytes.fromhex("04 02 000A"))
WRITE = rtu_adu(5, bytes.fromhex("06 0001 0003"))
VENDOR = rtu_adu(1, bytes.fromhex("41 0102 03"))


def polled(times: int = 20, latency_ns: int = 5 * MS) -> Line:
    """A line that has been heard for a while, so that its latency is known."""
    sent = Line(FORMAT)
    for _ in range(times):
        sent.frame(READ, 30 * MS).frame(ANSWER, latency_ns)
    return sent


def heard(sent: Line, *, timed: bool = True) -> list[Adu | Skipped]:
    return feed_all(RtuSplitter(FORMAT, timed=timed), sent.reads())


def so_far(sent: Line) -> tuple[RtuSplitter, list[Adu | Skipped]]:
    """What has come out when the last byte was heard."""
    fed = RtuSplitter(FORMAT)
    return fed, [one for data, ts_ns in sent.reads() for one in fed.feed(data, ts_ns)]


def raws(events: list[Adu | Skipped]) -> list[bytes]:
    return [event.raw for event in events]


# How many bytes and silences are held.


def test_search_decides_at_512_bytes_and_holds_the_last_256() -> None:
    noise = random.Random(8).randbytes(512)
    fed = RtuSplitter(FORMAT)
    assert fed.feed(noise[:511], START_NS) == []
    assert raw(fed.feed(noise[511:], START_NS + CHARACTER)) == noise[:256]


def test_last_256_bytes_are_held_behind_a_frame_too() -> None:
    noise = b"\x55\xaa" * 300
    sent = noise[:101] + READ + noise[: 512 - 109]
    assert raw(RtuSplitter(FORMAT).feed(sent, START_NS)) == sent[:256]


def test_certain_frame_among_the_last_256_bytes_is_not_held() -> None:
    noise = b"\x55\xaa" * 300
    for at, whole in ((248, 256), (249, 257), (250, 258)):
        sent = noise[:at] + READ + noise[: 504 - at]
        assert len(raw(RtuSplitter(FORMAT).feed(sent, START_NS))) == whole


@pytest.mark.parametrize("silence_ns", [5 * MS, T3_5])
@pytest.mark.parametrize(("count", "is_whole"), [(16, True), (17, False)])
def test_frame_may_come_in_sixteen_pieces(count: int, is_whole: bool, silence_ns: int) -> None:
    """At the sixteenth silence its bytes are decided."""
    response = rtu_adu(0x11, bytes((3, 40, *range(40))))
    sent = Line(FORMAT)
    for byte in response[: count - 1]:
        sent.frame(bytes([byte]), silence_ns)
    sent.frame(response[count - 1 :], silence_ns)
    assert ([adu.raw for adu in adus(heard(sent))] == [response]) is is_whole


def test_beginning_of_a_frame_is_held_for_a_second() -> None:
    fed = RtuSplitter(FORMAT)
    fed.feed(READ[:5], START_NS)
    assert fed.advance(START_NS + 1000 * MS - 1) == []
    assert raws(fed.advance(START_NS + 1000 * MS)) == [READ[:5]]


def test_whole_frame_after_a_silence_ends_the_wait_for_the_one_before() -> None:
    asked = rtu_adu(0x11, bytes.fromhex("03 0000 0014"))
    head = b"\x11\x03\x28\x01\x02"
    sent = polled().frame(asked, 30 * MS).frame(head, 5 * MS).frame(OTHER, 40 * MS)
    fed, events = so_far(sent.frame(OTHER_ANSWER, 5 * MS))
    events += fed.advance(sent.now_ns + T3_5)
    assert raws(events)[40:] == [asked, head, OTHER, OTHER_ANSWER]


# Silences of exactly t3.5, and times of exactly a second.


def test_noise_is_parted_at_silences_of_exactly_t3_5() -> None:
    sent = Line(FORMAT).send(b"\x01\x03").frame(b"\x01", T3_5).frame(READ, T3_5)
    assert raws(heard(sent)) == [b"\x01\x03", b"\x01", READ]
    sent = Line(FORMAT).send(b"\x01\x03").frame(b"\x01", T3_5 - 1).frame(READ, T3_5)
    assert raws(heard(sent)) == [b"\x01\x03\x01", READ]


def retried(after_ns: int, stray: bytes = b"") -> Adu:
    """A write that comes again, on a line whose slaves take 5 ms to respond."""
    sent = polled().frame(WRITE, 30 * MS)
    return adus(heard(sent.frame(stray + WRITE, after_ns - len(stray) * CHARACTER)))[-1]


@pytest.mark.parametrize("stray", [b"", b"\xff"])
def test_each_doubling_of_the_silence_before_a_retry_makes_it_surer(
    stray: bytes,
) -> None:
    """The echo is later, and fewer masters have a timeout that short."""
    retries = [retried(silence_ms * MS, stray) for silence_ms in (110, 120, 130)]
    assert [one.direction for one in retries] == [REQUEST] * 3
    first, second, third = (bits_of(one.confidence) for one in retries)
    per_doubling = costs.LATE_PER_DOUBLING + costs.SHORT_TIMEOUT
    assert third - first == pytest.approx(per_doubling * log2(130 / 110))
    assert second - first == pytest.approx(per_doubling * log2(120 / 110))


def test_frame_that_only_the_search_finds_is_told_by_the_same_rules() -> None:
    """Whatever decides its direction, no later byte does."""
    for silence_us in range(20_000, 60_000, 500):
        behind, alone = retried(silence_us * 1000, b"\xff"), retried(silence_us * 1000)
        assert (behind.direction, behind.direction_by) == (alone.direction, alone.direction_by)


@pytest.mark.parametrize(("after_ns", "is_sure"), [(1000 * MS, True), (1000 * MS + 1, False)])
@pytest.mark.parametrize("stray", [b"", b"\xff"])
def test_echo_that_begins_within_a_second_is_a_sure_response(
    after_ns: int, is_sure: bool, stray: bytes
) -> None:
    sent = polled(latency_ns=1050 * MS).frame(WRITE, 30 * MS)
    sent.frame(stray + WRITE, after_ns - len(stray) * CHARACTER)
    adu = adus(heard(sent))[-1]
    assert (adu.direction, adu.direction_by) == (RESPONSE, DirectionBy.PENDING)
    assert (adu.confidence >= SURE) is is_sure


def test_silence_before_a_frame_is_counted_from_the_end_of_stray_bytes() -> None:
    sent = Line(FORMAT).send(READ).frame(b"\xff", 5 * MS).frame(ANSWER, T3_5 - 1)
    events = heard(sent)
    assert raws(events) == [READ, b"\xff", ANSWER]
    response = adus(events)[1]
    assert (response.silence_before_ns, response.verdicts) == (T3_5 - 1, (Verdict.NOISE_BEFORE,))


# What is learned from stray bytes and damage.


@pytest.mark.parametrize(("stray", "is_noise"), [(b"\xff", True), (b"\x55", False)])
def test_zero_is_noise_on_a_line_of_much_noise_only(stray: bytes, is_noise: bool) -> None:
    """Other stray bytes do not show that the 00 after a frame of unknown form is one."""
    sent = Line(FORMAT)
    for _ in range(60):
        sent.frame(READ + stray, 30 * MS).frame(ANSWER + stray, 5 * MS)
    events = heard(sent.frame(VENDOR + b"\x00", 30 * MS).frame(READ, 30 * MS))
    assert (VENDOR in raws(events)) is is_noise


@pytest.mark.parametrize("size", [3, 4])
def test_four_skipped_bytes_may_have_been_the_response_and_three_not(size: int) -> None:
    sent = polled().frame(WRITE, 30 * MS).frame(b"\x55\x66\x77\x99"[:size], 5 * MS)
    sent.frame(WRITE, 310 * MS).frame(OTHER, 30 * MS)
    events = heard(sent)
    assert len(skipped(events)) == 1
    assert (adus(events)[-2].confidence >= SURE) is (size == 3)


def test_each_damage_shows_how_often_one_wrong_bit_explains_it() -> None:
    for wrong, is_cheaper in ((0x10, True), (0x5A, False)):
        damaged = ANSWER[:4] + bytes([ANSWER[4] ^ wrong]) + ANSWER[5:]
        fed = RtuSplitter(FORMAT)
        events = feed_all(fed, polled(1).frame(READ, 30 * MS).frame(damaged, 5 * MS).reads())
        assert raws(events)[-1] == damaged
        assert (fed._statistics.one_bit.bits < costs.RARE_ONE_BIT) is is_cheaper
