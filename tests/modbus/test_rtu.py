"""What one tap hears on an RTU line, cut into frames."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.modbus import (
    Adu,
    DirectionBy,
    RtuSplitter,
    Skipped,
    Transport,
    Verdict,
    crc,
    exception_pdu,
    rtu_adu,
)
from mbtool.modbus.rtu import HOLD_NS, WINDOW
from tests.feeding import START_NS, Line, feed_all
from tests.modbus.reading import adus, pdus, raw, skipped

if TYPE_CHECKING:
    from collections.abc import Iterable

FORMAT = SerialFormat(19200, 8, "E", 1)
T1_5, T3_5, CHARACTER = FORMAT.t1_5_ns, FORMAT.t3_5_ns, FORMAT.character_ns

READ_HOLDING_REQUEST = bytes.fromhex(
    "11"            # unit
    "03 006B 0003"  # read holding registers, address 107, quantity 3
    "7687"          # CRC
)  # fmt: skip
READ_HOLDING_RESPONSE = bytes.fromhex(
    "11"                   # unit
    "03 06 022B 0000 0064" # three registers
    "C8BA"                 # CRC
)  # fmt: skip
OTHER_REQUEST = rtu_adu(0x12, bytes.fromhex("04 0008 0001"))


def line() -> Line:
    return Line(FORMAT)


def splitter() -> RtuSplitter:
    return RtuSplitter(FORMAT)


def heard(sent: Line) -> list[Adu | Skipped]:
    return feed_all(splitter(), sent.reads())


def burst(*frames: bytes) -> Line:
    """Frames without a silence between them."""
    return line().send(b"".join(frames))


def raws(events: Iterable[Adu | Skipped]) -> list[bytes]:
    return [event.raw for event in events]


# Clean silences.


def test_reads_request_and_response() -> None:
    sent = line().send(READ_HOLDING_REQUEST).frame(READ_HOLDING_RESPONSE)
    request, response = adus(heard(sent))
    assert (request.transport, request.unit, request.pdu.hex()) == (
        Transport.RTU, 0x11, "03006b0003",
    )  # fmt: skip
    assert (request.direction, request.direction_by) == (Direction.REQUEST, DirectionBy.FORM)
    assert (response.direction, response.direction_by) == (Direction.RESPONSE, DirectionBy.PENDING)
    assert request.checksum is not None
    assert (request.checksum.received, request.checksum.ok) == (0x8776, True)
    assert request.verdicts == response.verdicts == ()


def test_frame_begins_with_its_first_start_bit_and_ends_with_its_last_stop_bit() -> None:
    (adu,) = adus(heard(line().send(READ_HOLDING_REQUEST)))
    assert (adu.start_ns, adu.end_ns) == (START_NS, START_NS + 8 * CHARACTER)


def test_frame_comes_out_after_a_silence_of_t3_5() -> None:
    fed = splitter()
    assert fed.feed(READ_HOLDING_REQUEST, START_NS) == []
    assert not fed.is_idle
    assert fed.advance(START_NS + T3_5 - 1) == []
    assert raws(fed.advance(START_NS + T3_5)) == [READ_HOLDING_REQUEST]
    assert fed.is_idle


def test_frame_comes_out_when_the_next_begins() -> None:
    fed = splitter()
    fed.feed(READ_HOLDING_REQUEST, START_NS)
    events = fed.feed(READ_HOLDING_RESPONSE[:1], START_NS + T3_5 + CHARACTER)
    assert raws(events) == [READ_HOLDING_REQUEST]


def test_empty_read_changes_nothing() -> None:
    fed = splitter()
    fed.feed(READ_HOLDING_REQUEST[:5], START_NS)
    assert fed.feed(b"", START_NS + 1) == []
    assert raws(fed.feed(READ_HOLDING_REQUEST[5:], START_NS + 3 * CHARACTER) + fed.close()) == [
        READ_HOLDING_REQUEST
    ]


def test_broadcast_is_a_request_that_nobody_answers() -> None:
    write = rtu_adu(0, bytes.fromhex("06 0000 1234"))
    sent = line().send(write).frame(write)
    assert [adu.direction for adu in adus(heard(sent))] == [Direction.REQUEST] * 2


# What may look like a shorter or a longer frame. Each is alone in its burst.


@pytest.mark.parametrize(
    "frame",
    [
        pytest.param("01 04 02 0301 7800", id="response-of-one-register-ending-in-zero"),
        pytest.param("08 03 0200 0064 4500", id="request-that-holds-a-7-byte-response"),
        pytest.param("01 03 04 0000 0185 3A00", id="response-that-begins-with-an-8-byte-request"),
        pytest.param("08 01 03E8 0011 7CEF", id="request-as-long-as-a-3-byte-response"),
        pytest.param("08 01 03 123401 4BD2", id="3-byte-response-as-long-as-a-request"),
    ],
)
def test_ambiguous_frame_is_read_whole(frame: str) -> None:
    sent = bytes.fromhex(frame)
    assert crc(sent) == 0
    assert raws(heard(line().send(sent))) == [sent]


def test_request_for_bits_from_03e8h_and_its_response_are_told_apart_by_the_turn() -> None:
    request = bytes.fromhex("08 01 03E8 0011 7CEF")  # 17 contacts, from 03E8H on.
    response = bytes.fromhex("08 01 03 123401 4BD2")
    sent = line().send(request).frame(response).frame(request).frame(response)
    assert [adu.direction for adu in adus(heard(sent))] == [
        Direction.REQUEST, Direction.RESPONSE, Direction.REQUEST, Direction.RESPONSE,
    ]  # fmt: skip


def test_repeated_request_for_bits_from_03e8h_is_not_its_own_response() -> None:
    request = bytes.fromhex("08 01 03E8 0011 7CEF")
    sent = line().send(request).frame(request, before_ns=300_000_000)
    assert [adu.direction for adu in adus(heard(sent))] == [Direction.REQUEST] * 2


def test_response_of_07_that_ends_in_zero_is_no_request() -> None:
    response = next(
        frame
        for unit in range(1, 248)
        for status in range(256)
        if (frame := rtu_adu(unit, bytes([7, status])))[-1] == 0
    )
    assert crc(response[:4]) == 0  # As a request it would be valid too.
    request = rtu_adu(response[0], b"\x07")
    events = heard(line().send(request).frame(response))
    assert raws(events) == [request, response]
    assert adus(events)[1].direction is Direction.RESPONSE


def test_response_of_10h_before_a_zero_is_no_request_of_no_bytes() -> None:
    response = next(
        frame
        for unit in range(1, 248)
        for address in range(256)
        if (frame := rtu_adu(unit, bytes([0x10, 0, address, 0, 1])))[6] == 0
    )
    assert crc(response + b"\x00") == 0  # A write of 0 bytes would have 9.
    broadcast = rtu_adu(0, bytes.fromhex("06 0000 1234"))
    events = heard(burst(response, broadcast))
    assert raws(events) == [response, broadcast]


@pytest.mark.parametrize("code", [0x05, 0x06, 0x08, 0x16])
def test_request_and_equal_response_take_turns(code: int) -> None:
    data = {0x16: "0004 00F2 0025", 0x08: "0000 A537"}.get(code, "0004 FF00")
    frame = rtu_adu(5, bytes([code]) + bytes.fromhex(data))
    sent = line().send(frame).frame(frame).frame(frame).frame(frame)
    assert [(adu.direction, adu.direction_by) for adu in adus(heard(sent))] == [
        (Direction.REQUEST, DirectionBy.IDLE),
        (Direction.RESPONSE, DirectionBy.PENDING),
    ] * 2


@pytest.mark.parametrize("zeros", [1, 2, 3])
def test_zeros_behind_a_frame_are_noise(zeros: int) -> None:
    events = heard(burst(READ_HOLDING_REQUEST, bytes(zeros)))
    assert raws(events) == [READ_HOLDING_REQUEST, bytes(zeros)]


# Functions that no table knows.


def test_unknown_function_is_found_where_a_whole_burst_has_a_correct_crc() -> None:
    unknown = rtu_adu(1, bytes.fromhex("41 0102 03"))
    events = heard(line().send(unknown).frame(READ_HOLDING_REQUEST))
    assert raws(events) == [unknown, READ_HOLDING_REQUEST]
    assert (adus(events)[0].direction, adus(events)[0].confidence) == (Direction.REQUEST, 0.5)


def test_response_of_an_unknown_function_answers_its_request() -> None:
    request, response = rtu_adu(1, b"\x41\x00"), rtu_adu(1, b"\x41\x00\x13")
    events = heard(line().send(request).frame(response))
    assert [adu.direction for adu in adus(events)] == [Direction.REQUEST, Direction.RESPONSE]


def test_unknown_function_is_found_behind_noise_that_is_held() -> None:
    unknown = rtu_adu(1, bytes.fromhex("41 0102 03"))
    events = heard(line().send(b"\x01").frame(unknown))
    assert raws(events) == [b"\x01", unknown]
    assert adus(events)[0].verdicts == ()  # A silence parts them.


def test_known_function_of_another_form_is_found_the_same_way() -> None:
    odd = rtu_adu(1, bytes.fromhex("03 0000"))
    assert raws(heard(line().send(odd))) == [odd]


# Adapters that glue frames and tear them.


def test_request_and_response_without_a_silence_are_told_apart() -> None:
    events = heard(burst(READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE))
    assert raws(events) == [READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE]
    assert [adu.verdicts for adu in adus(events)] == [(Verdict.GLUED,)] * 2
    assert [adu.direction for adu in adus(events)] == [Direction.REQUEST, Direction.RESPONSE]


def test_only_frames_without_a_silence_are_glued() -> None:
    sent = burst(READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE).frame(OTHER_REQUEST)
    assert [adu.verdicts for adu in adus(heard(sent))] == [(Verdict.GLUED,), (Verdict.GLUED,), ()]


@pytest.mark.parametrize("at", range(1, 11))
def test_torn_frame_is_joined(at: int) -> None:
    sent = line().send(READ_HOLDING_REQUEST).frame(READ_HOLDING_RESPONSE[:at])
    events = heard(sent.frame(READ_HOLDING_RESPONSE[at:], before_ns=16_000_000))
    assert raws(events) == [READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE]
    assert adus(events)[1].verdicts == (Verdict.SPLIT,)


def test_frame_torn_into_single_bytes_is_joined() -> None:
    sent = line()
    for byte in READ_HOLDING_RESPONSE:
        sent.frame(bytes([byte]), before_ns=16_000_000)
    assert raws(heard(sent)) == [READ_HOLDING_RESPONSE]


def test_silence_between_t1_5_and_t3_5_is_noticed() -> None:
    sent = line().send(READ_HOLDING_REQUEST[:4]).frame(READ_HOLDING_REQUEST[4:], T1_5 + 1)
    assert adus(heard(sent))[0].verdicts == (Verdict.T1_5_BROKEN,)
    sent = line().send(READ_HOLDING_REQUEST[:4]).frame(READ_HOLDING_REQUEST[4:], T1_5)
    assert adus(heard(sent))[0].verdicts == ()


def test_beginning_of_a_frame_is_held_for_a_while_only() -> None:
    fed = splitter()
    assert fed.feed(READ_HOLDING_REQUEST[:5], START_NS) == []
    assert fed.advance(START_NS + HOLD_NS - 1) == []
    assert raws(fed.advance(START_NS + HOLD_NS)) == [READ_HOLDING_REQUEST[:5]]
    sent = line().send(READ_HOLDING_REQUEST[:5]).frame(READ_HOLDING_REQUEST[5:], HOLD_NS)
    assert adus(heard(sent)) == []


def test_hold_lasts_for_t3_5_where_that_is_longer() -> None:
    slow = SerialFormat(300)
    fed = RtuSplitter(slow)
    fed.feed(READ_HOLDING_REQUEST[:5], START_NS)
    assert slow.t3_5_ns > HOLD_NS
    assert fed.advance(START_NS + slow.t3_5_ns - 1) == []
    assert raws(fed.advance(START_NS + slow.t3_5_ns)) == [READ_HOLDING_REQUEST[:5]]


def test_long_run_of_frames_without_any_silence_is_read() -> None:
    pairs = [READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE] * 200
    events = heard(burst(*pairs))
    assert raws(events) == pairs


# Bytes that are no frame.


def test_frame_with_a_wrong_crc_is_told_with_both_values() -> None:
    bad = READ_HOLDING_REQUEST[:-1] + b"\x88"
    events = heard(line().send(bad).frame(READ_HOLDING_RESPONSE))
    assert raws(events) == [bad, READ_HOLDING_RESPONSE]
    assert skipped(events)[0].kind is EventKind.BAD_CHECK
    assert skipped(events)[0].reason == "a frame with CRC 8876H, where 8776H would be right"


def test_each_of_several_frames_with_a_wrong_crc_is_told() -> None:
    bad = READ_HOLDING_REQUEST[:-1] + b"\x88"
    events = heard(line().send(bad).frame(bad).frame(OTHER_REQUEST))
    assert [one.kind for one in skipped(events)] == [EventKind.BAD_CHECK] * 2
    assert raws(events) == [bad, bad, OTHER_REQUEST]


def test_torn_frame_with_a_wrong_crc_is_told_whole() -> None:
    bad = READ_HOLDING_REQUEST[:-1] + b"\x88"
    events = heard(line().send(bad[:5]).frame(bad[5:], before_ns=16_000_000))
    assert [(one.kind, one.raw) for one in skipped(events)] == [(EventKind.BAD_CHECK, bad)]


def test_noise_before_a_frame_is_noticed() -> None:
    events = heard(burst(b"\xff\xfe\xfd", READ_HOLDING_REQUEST))
    assert raws(events) == [b"\xff\xfe\xfd", READ_HOLDING_REQUEST]
    assert adus(events)[0].verdicts == (Verdict.NOISE_BEFORE,)


def test_noise_between_frames_is_skipped() -> None:
    noise = bytes.fromhex("00 F8 FE FC")
    events = heard(burst(READ_HOLDING_REQUEST, noise, READ_HOLDING_RESPONSE, noise))
    assert raws(events) == [READ_HOLDING_REQUEST, noise, READ_HOLDING_RESPONSE, noise]


def test_skipped_bytes_have_the_time_of_the_first() -> None:
    events = heard(line().send(READ_HOLDING_REQUEST).frame(b"\xff" * 9))
    assert skipped(events)[0].ts_ns == START_NS + 9 * CHARACTER + 2 * T3_5


def test_bursts_of_noise_are_events_of_their_own() -> None:
    sent = line().send(b"\x01\x03").frame(b"\x01").frame(READ_HOLDING_REQUEST)
    assert raws(heard(sent)) == [b"\x01\x03", b"\x01", READ_HOLDING_REQUEST]


def test_clock_that_was_set_back_ends_what_was_held() -> None:
    fed = splitter()
    fed.feed(READ_HOLDING_REQUEST, START_NS)
    hour = 3_600_000_000_000
    assert raws(fed.feed(READ_HOLDING_RESPONSE, START_NS - hour)) == [READ_HOLDING_REQUEST]
    (adu,) = adus(fed.advance(START_NS - hour + T3_5))
    assert adu.end_ns == START_NS - hour


def test_reads_that_seem_to_overlap_belong_together() -> None:
    fed = splitter()
    fed.feed(READ_HOLDING_RESPONSE[:6], START_NS)
    fed.feed(READ_HOLDING_RESPONSE[6:], START_NS + CHARACTER)
    (adu,) = adus(fed.close())
    assert (adu.end_ns, adu.verdicts) == (START_NS + CHARACTER, ())


def test_holds_less_than_a_window() -> None:
    noise = random.Random(6).randbytes(60_000)
    fed = splitter()
    held = most = 0
    for at in range(0, len(noise), 50):
        held += 50 - len(raw(fed.feed(noise[at : at + 50], START_NS + at * CHARACTER)))
        most = max(most, held)
    assert 256 < most < WINDOW + 50


def test_frame_in_the_middle_of_noise_is_found() -> None:
    noise = bytes(byte | 0x60 & 0x7F for byte in random.Random(7).randbytes(3000))
    events = heard(burst(noise[:1500], READ_HOLDING_REQUEST, noise[1500:]))
    assert pdus(events) == [(0x11, "03006b0003")]
    assert raw(events) == noise[:1500] + READ_HOLDING_REQUEST + noise[1500:]


def test_exception_response_is_found() -> None:
    refused = rtu_adu(0x11, exception_pdu(3, 2))
    events = heard(line().send(READ_HOLDING_REQUEST).frame(refused))
    assert raws(events) == [READ_HOLDING_REQUEST, refused]
    assert adus(events)[1].direction_by is DirectionBy.PENDING
