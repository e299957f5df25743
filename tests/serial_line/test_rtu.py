"""What one tap hears on an RTU line, cut into frames."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.modbus.adu import Adu, Checksum, DirectionBy, Skipped, Transport, Verdict, crc, rtu_adu
from mbtool.modbus.pdu import exception_pdu
from mbtool.serial_line import RtuSplitter
from mbtool.serial_line.bus_model import SURE
from mbtool.serial_line.rtu import HOLD_NS, MAX_SILENCES, WINDOW
from tests.benchmarks.adapters import Column, Wire, delivered
from tests.feeding import START_NS, Line, feed_all
from tests.modbus.reading import adus, pdus, raw, skipped

if TYPE_CHECKING:
    from collections.abc import Iterable

FORMAT = SerialFormat(19200, 8, "E", 1)
T1_5, T3_5, CHARACTER = FORMAT.t1_5_ns, FORMAT.t3_5_ns, FORMAT.character_ns
MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE

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
OTHER_RESPONSE = rtu_adu(0x12, bytes.fromhex("04 02 000A"))
WRITE = rtu_adu(5, bytes.fromhex("06 0001 0003"))
READS = (READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE)
OTHERS = (OTHER_REQUEST, OTHER_RESPONSE)


def line() -> Line:
    return Line(FORMAT)


def splitter() -> RtuSplitter:
    return RtuSplitter(FORMAT)


def heard(sent: Line, *, timed: bool = True) -> list[Adu | Skipped]:
    return feed_all(RtuSplitter(FORMAT, timed=timed), sent.reads())


def polled(times: int = 20, latency_ns: int = 5 * MS) -> Line:
    """A line that has been heard for a while, so that its latency is known."""
    sent = line()
    for _ in range(times):
        sent.frame(READ_HOLDING_REQUEST, 30 * MS).frame(READ_HOLDING_RESPONSE, latency_ns)
    return sent


def directions(events: Iterable[Adu | Skipped]) -> list[Direction]:
    return [adu.direction for adu in adus(events)]


def sure(events: Iterable[Adu | Skipped]) -> list[bool]:
    """For each frame, True if it is sure. The others have the verdict ambiguous."""
    found = adus(events)
    assert [Verdict.AMBIGUOUS in adu.verdicts for adu in found] == [
        adu.confidence < SURE for adu in found
    ]
    return [adu.confidence >= SURE for adu in found]


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
    assert directions(heard(line().send(write).frame(write))) == [REQUEST] * 2


# Who speaks.


@pytest.mark.parametrize("code", [0x05, 0x06, 0x08, 0x16])
def test_request_and_equal_response_take_turns(code: int) -> None:
    data = {0x16: "0004 00F2 0025", 0x08: "0000 A537"}.get(code, "0004 FF00")
    frame = rtu_adu(5, bytes([code]) + bytes.fromhex(data))
    sent = line().send(frame).frame(frame).frame(frame).frame(frame)
    assert [(adu.direction, adu.direction_by) for adu in adus(heard(sent))] == [
        (Direction.REQUEST, DirectionBy.IDLE),
        (Direction.RESPONSE, DirectionBy.PENDING),
    ] * 2


def test_what_decided_a_direction_is_told() -> None:
    sent = polled().frame(WRITE, 30 * MS).frame(WRITE, 5 * MS)
    sent.frame(WRITE, 30 * MS).frame(WRITE, 400 * MS).frame(WRITE, 5 * MS)
    events = heard(sent)
    assert [(adu.direction, adu.direction_by) for adu in adus(events)[-7:]] == [
        (REQUEST, DirectionBy.FORM),
        (RESPONSE, DirectionBy.PENDING),
        (REQUEST, DirectionBy.IDLE),
        (RESPONSE, DirectionBy.PENDING),
        (REQUEST, DirectionBy.IDLE),
        (REQUEST, DirectionBy.TIMING),
        (RESPONSE, DirectionBy.PENDING),
    ]
    assert all(sure(events))


@pytest.mark.parametrize("timeout_ms", [200, 300, 900])
def test_retry_after_a_timeout_is_a_request_by_timing(timeout_ms: int) -> None:
    sent = polled(latency_ns=5 * MS).frame(WRITE, 30 * MS)
    events = heard(sent.frame(WRITE, timeout_ms * MS).frame(WRITE, 5 * MS))
    retry = adus(events)[-2]
    assert (retry.direction, retry.direction_by) == (REQUEST, DirectionBy.TIMING)
    assert directions(events)[-3:] == [REQUEST, REQUEST, RESPONSE]
    assert all(sure(events))


@pytest.mark.parametrize("retries", [1, 2, 3])
def test_each_retry_is_a_request(retries: int) -> None:
    sent = polled(latency_ns=5 * MS).frame(WRITE, 30 * MS)
    for _ in range(retries):
        sent.frame(WRITE, 300 * MS)
    events = heard(sent.frame(WRITE, 5 * MS).frame(READ_HOLDING_REQUEST, 30 * MS))
    assert directions(events)[40:] == [*[REQUEST] * (retries + 1), RESPONSE, REQUEST]


def test_echo_of_a_slow_slave_is_no_retry() -> None:
    sent = polled(latency_ns=400 * MS).frame(WRITE, 30 * MS).frame(WRITE, 300 * MS)
    events = heard(sent.frame(WRITE, 30 * MS).frame(WRITE, 400 * MS))
    assert directions(events)[40:] == [REQUEST, RESPONSE] * 2
    assert all(sure(events))


@pytest.mark.parametrize("way", ["whole", "byte-by-byte", "without-times"])
@pytest.mark.parametrize("known", [True, False], ids=["known-line", "new-line"])
@pytest.mark.parametrize("latency_ms", [1, 60, 250, 600, 990, 1010, 3000])
def test_late_response_as_long_as_a_request_is_a_response(
    latency_ms: int, known: bool, way: str
) -> None:
    """17 to 24 bits are three bytes, which look like an address and a quantity as well."""
    sent, expected = (polled() if known else line()), [REQUEST, RESPONSE] * (20 if known else 0)
    asked = rtu_adu(1, bytes.fromhex("02 03E8 0014"))
    for bits in ("000000", "050000", "010203", "000001"):
        sent.frame(asked, 50 * MS)
        sent.frame(rtu_adu(1, bytes.fromhex("02 03" + bits)), latency_ms * MS)
        expected += [REQUEST, RESPONSE]
    sizes = [1] * len(sent.data) if way == "byte-by-byte" else []
    events = feed_all(RtuSplitter(FORMAT, timed=way != "without-times"), sent.reads(sizes))
    assert directions(events) == expected
    # The first frame of a capture has the form of both, and is held for at most 1 s.
    assert all(sure(events)[not known and latency_ms > 1000 :])


def test_late_response_as_long_as_a_request_is_a_response_where_frames_are_glued() -> None:
    """An adapter merges a response with the requests around it; one response takes long."""
    asked = rtu_adu(1, bytes.fromhex("02 0014 0018"))
    answer = rtu_adu(1, bytes.fromhex("02 03 000000"))
    sent = line().frame(asked)
    for number in range(40):
        sent.frame(answer + asked, 900 * MS if number == 30 else 20 * MS)
    events = heard(sent)
    assert directions(events) == [REQUEST, *[RESPONSE, REQUEST] * 40]
    assert all(sure(events))


def test_retry_on_a_new_line_is_ambiguous() -> None:
    events = heard(line().send(WRITE).frame(WRITE, 250 * MS))
    assert sure(events)[1] is False


@pytest.mark.parametrize("timed", [True, False])
def test_request_after_a_missing_response_is_a_request(timed: bool) -> None:
    frames = (READ_HOLDING_REQUEST, *OTHERS, READ_HOLDING_REQUEST, READ_HOLDING_REQUEST, *OTHERS)
    sent = line()
    for frame in frames:
        sent.frame(frame, 5 * MS if frame is OTHER_RESPONSE else 300 * MS)
    events = heard(sent, timed=timed)
    assert raws(events) == list(frames)
    assert directions(events) == [
        REQUEST, REQUEST, RESPONSE, REQUEST, REQUEST, REQUEST, RESPONSE,
    ]  # fmt: skip
    assert all(sure(events))


@pytest.mark.parametrize("timed", [True, False])
def test_two_requests_in_a_row_without_a_silence_are_two(timed: bool) -> None:
    events = heard(burst(READ_HOLDING_REQUEST, *OTHERS), timed=timed)
    assert directions(events) == [REQUEST, REQUEST, RESPONSE]


@pytest.mark.parametrize("timed", [True, False])
def test_response_of_another_unit_leaves_the_request_pending(timed: bool) -> None:
    frames = (READ_HOLDING_REQUEST, OTHER_RESPONSE, READ_HOLDING_RESPONSE)
    events = heard(burst(*frames), timed=timed)
    assert raws(events) == list(frames)
    assert directions(events) == [REQUEST, RESPONSE, RESPONSE]
    assert adus(events)[2].direction_by is DirectionBy.PENDING


def test_echo_of_another_unit_is_ambiguous() -> None:
    """A request to another slave, or a response of the wrong slave."""
    other = rtu_adu(6, WRITE[1:-2])
    events = heard(polled().frame(WRITE, 30 * MS).frame(other, 5 * MS).frame(other, 5 * MS))
    assert sure(events)[41] is False


def test_slave_responds_to_the_request_and_to_its_retry() -> None:
    """Its responses to both requests come after the second."""
    sent = polled().frame(OTHER_REQUEST, 30 * MS).frame(OTHER_REQUEST, 300 * MS)
    sent.frame(OTHER_RESPONSE, 2 * MS).frame(OTHER_RESPONSE, 8 * MS)
    events = heard(sent.frame(READ_HOLDING_REQUEST, 30 * MS))
    assert directions(events)[40:] == [REQUEST, REQUEST, RESPONSE, RESPONSE, REQUEST]
    assert all(sure(events))


def test_echoes_of_the_request_and_of_its_retry() -> None:
    sent = polled().frame(WRITE, 30 * MS).frame(WRITE, 300 * MS)
    sent.frame(WRITE, 2 * MS).frame(WRITE, 4 * MS).frame(READ_HOLDING_REQUEST, 30 * MS)
    events = heard(sent)
    assert directions(events)[40:43] == [REQUEST, REQUEST, RESPONSE]
    assert adus(events)[43].direction is RESPONSE or not sure(events)[43]


def test_late_response_after_a_request_to_another_unit() -> None:
    sent = polled().frame(OTHER_REQUEST, 30 * MS).frame(READ_HOLDING_REQUEST, 300 * MS)
    sent.frame(OTHER_RESPONSE, 2 * MS).frame(READ_HOLDING_RESPONSE, 8 * MS)
    events = heard(sent)
    assert directions(events)[40:] == [REQUEST, REQUEST, RESPONSE, RESPONSE]
    assert adus(events)[43].direction_by is DirectionBy.PENDING


def test_nobody_answers_a_broadcast_whatever_follows() -> None:
    write = rtu_adu(0, bytes.fromhex("06 0001 0003"))
    for timed in (True, False):
        events = heard(burst(*READS, write, write, WRITE, WRITE, *READS), timed=timed)
        assert directions(events) == [
            REQUEST, RESPONSE, REQUEST, REQUEST, REQUEST, RESPONSE, REQUEST, RESPONSE,
        ]  # fmt: skip


@pytest.mark.parametrize("code", [0x01, 0x0B, 0x11, 0x12, 0xFF])
@pytest.mark.parametrize("timed", [True, False])
def test_exception_response_may_have_any_code(code: int, timed: bool) -> None:
    refused = rtu_adu(0x11, exception_pdu(3, code))
    frames = (READ_HOLDING_REQUEST, refused, *OTHERS)
    events = heard(burst(*frames), timed=timed)
    assert raws(events) == list(frames)
    assert (adus(events)[1].direction, adus(events)[1].direction_by) == (
        RESPONSE, DirectionBy.PENDING,
    )  # fmt: skip


# Who speaks is known: one wire of two, or a tap that hears one side.


@pytest.mark.parametrize("speaker", [REQUEST, RESPONSE])
def test_who_speaks_may_be_known(speaker: Direction) -> None:
    frames = [WRITE, WRITE, WRITE] + [READS[speaker is RESPONSE], OTHERS[speaker is RESPONSE]] * 2
    for silences in (True, False):
        sent = line()
        for frame in frames:
            sent.frame(frame, 10 * MS if silences else 0)
        for timed in (True, False):
            fed = RtuSplitter(FORMAT, timed=timed, speaker=speaker)
            events = feed_all(fed, sent.reads())
            assert raws(events) == frames
            assert {(adu.direction, adu.direction_by) for adu in adus(events)} == {
                (speaker, DirectionBy.PORT)
            }
            assert all(sure(events))


@pytest.mark.parametrize(
    ("speaker", "frame"),
    [
        (REQUEST, "08 03 0200 0064 4500"),  # Begins with a response of one register.
        (REQUEST, "08 01 03E8 0011 7CEF"),
        (RESPONSE, "08 01 03 E80011 7CEF"),
        (RESPONSE, "01 03 04 0000 0185 3A00"),  # Begins with a request.
        (RESPONSE, "01 07 41 E200"),
    ],
)
def test_only_the_form_of_the_one_who_speaks_counts(speaker: Direction, frame: str) -> None:
    sent = bytes.fromhex(frame)
    for timed in (True, False):
        fed = RtuSplitter(FORMAT, timed=timed, speaker=speaker)
        events = feed_all(fed, burst(sent, sent).reads())
        assert [(adu.raw, adu.direction) for adu in adus(events)] == [(sent, speaker)] * 2


def test_damage_on_one_wire_is_told_with_its_check() -> None:
    bad = READ_HOLDING_RESPONSE[:5] + b"\x55" + READ_HOLDING_RESPONSE[6:]
    sent = burst(bad, OTHER_RESPONSE).reads()
    one, two = feed_all(RtuSplitter(FORMAT, speaker=RESPONSE), sent)
    assert isinstance(one, Skipped)
    assert (one.raw, one.kind) == (bad, EventKind.BAD_CHECK)
    assert one.checksum is not None
    assert two.raw == OTHER_RESPONSE


# Unknown functions.


def test_unknown_function_is_found_where_a_whole_burst_has_a_correct_crc() -> None:
    unknown = rtu_adu(1, bytes.fromhex("41 0102 03"))
    events = heard(line().send(unknown).frame(READ_HOLDING_REQUEST))
    assert raws(events) == [unknown, READ_HOLDING_REQUEST]


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


# Adapters that glue frames and split them.


def test_request_and_response_without_a_silence_are_told_apart() -> None:
    events = heard(burst(READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE))
    assert raws(events) == [READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE]
    assert [adu.verdicts for adu in adus(events)] == [(Verdict.GLUED,)] * 2
    assert [adu.silence_before_ns for adu in adus(events)] == [None, 0]
    assert [adu.direction for adu in adus(events)] == [Direction.REQUEST, Direction.RESPONSE]


def test_only_frames_without_a_silence_are_glued() -> None:
    sent = burst(READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE).frame(OTHER_REQUEST)
    events = heard(sent)
    assert [adu.verdicts for adu in adus(events)] == [(Verdict.GLUED,), (Verdict.GLUED,), ()]
    assert [adu.silence_before_ns for adu in adus(events)] == [None, 0, 2 * T3_5]


@pytest.mark.parametrize(
    ("silence_ns", "is_glued"), [(0, True), (1, True), (T3_5 - 1, True), (T3_5, False)]
)
def test_silence_between_frames_is_told_as_it_was(silence_ns: int, is_glued: bool) -> None:
    sent = line().send(READ_HOLDING_REQUEST).frame(READ_HOLDING_RESPONSE, silence_ns)
    request, response = adus(heard(sent))
    assert response.silence_before_ns == silence_ns
    assert [Verdict.GLUED in adu.verdicts for adu in (request, response)] == [is_glued] * 2


@pytest.mark.parametrize("at", range(1, 11))
def test_torn_frame_is_joined(at: int) -> None:
    sent = line().send(READ_HOLDING_REQUEST).frame(READ_HOLDING_RESPONSE[:at])
    events = heard(sent.frame(READ_HOLDING_RESPONSE[at:], before_ns=16_000_000))
    assert raws(events) == [READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE]
    assert adus(events)[1].verdicts == (Verdict.SPLIT,)
    assert adus(events)[1].longest_silence_ns == 16_000_000


def test_frame_torn_into_single_bytes_is_joined() -> None:
    sent = line()
    for byte in READ_HOLDING_RESPONSE:
        sent.frame(bytes([byte]), before_ns=16_000_000)
    assert raws(heard(sent)) == [READ_HOLDING_RESPONSE]


@pytest.mark.parametrize("size", [16, 32, 62])
def test_long_response_torn_into_pieces_is_joined(size: int) -> None:
    request = rtu_adu(0x11, bytes.fromhex("03 0000 007D"))
    response = rtu_adu(0x11, bytes((3, 250, *range(250))))
    sent = line().send(request)
    for at in range(0, len(response), size):
        sent.frame(response[at : at + size], 16 * MS)
    events = heard(sent.frame(OTHER_REQUEST, 16 * MS))
    assert raws(events) == [request, response, OTHER_REQUEST]
    assert adus(events)[1].verdicts == (Verdict.SPLIT,)


def test_frame_with_too_many_silences_is_given_up() -> None:
    response = rtu_adu(0x11, bytes((3, 40, *range(40))))
    sent = line()
    for byte in response[: MAX_SILENCES + 1]:
        sent.frame(bytes([byte]), 5 * MS)
    fed = splitter()
    events: list[Adu | Skipped] = []
    for data, ts_ns in sent.reads():
        events += fed.feed(data, ts_ns)
    assert events
    assert not adus(events)


def test_frame_glued_to_the_beginning_of_the_next_is_given_out_at_once() -> None:
    fed = splitter()
    sent = burst(READ_HOLDING_REQUEST, READ_HOLDING_RESPONSE[:4])
    events = [one for data, ts_ns in sent.reads() for one in fed.feed(data, ts_ns)]
    assert raws(events) == [READ_HOLDING_REQUEST]
    events = fed.feed(READ_HOLDING_RESPONSE[4:], sent.now_ns + 16 * MS)
    assert raws(events + fed.close()) == [READ_HOLDING_RESPONSE]


def test_silence_between_t1_5_and_t3_5_is_noticed() -> None:
    sent = line().send(READ_HOLDING_REQUEST[:4]).frame(READ_HOLDING_REQUEST[4:], T1_5 + 1)
    assert adus(heard(sent))[0].verdicts == (Verdict.T1_5_BROKEN,)
    sent = line().send(READ_HOLDING_REQUEST[:4]).frame(READ_HOLDING_REQUEST[4:], T1_5)
    assert adus(heard(sent))[0].verdicts == ()


@pytest.mark.parametrize(
    ("silence_ns", "verdicts"),
    [
        (0, ()),
        (T1_5, ()),
        (T1_5 + 1, (Verdict.T1_5_BROKEN,)),
        (T3_5 - 1, (Verdict.T1_5_BROKEN,)),
        (T3_5, (Verdict.SPLIT,)),
        (16 * MS, (Verdict.SPLIT,)),
    ],
)
def test_longest_silence_inside_a_frame_is_told(
    silence_ns: int, verdicts: tuple[Verdict, ...]
) -> None:
    sent = line().send(READ_HOLDING_REQUEST).frame(READ_HOLDING_RESPONSE[:3])
    sent.frame(READ_HOLDING_RESPONSE[3:6], silence_ns // 2)
    sent.frame(READ_HOLDING_RESPONSE[6:], silence_ns)
    adu = adus(heard(sent))[1]
    assert (adu.longest_silence_ns, adu.verdicts) == (silence_ns, verdicts)


def test_nothing_is_told_of_silences_whose_times_are_made_up() -> None:
    sent = burst(READ_HOLDING_REQUEST[:4]).frame(READ_HOLDING_REQUEST[4:], 16 * MS)
    sent.send(READ_HOLDING_RESPONSE)
    for adu in adus(heard(sent, timed=False)):
        assert (adu.silence_before_ns, adu.longest_silence_ns, adu.verdicts) == (None, None, ())


def test_beginning_of_a_frame_is_held_for_a_while_only() -> None:
    fed = splitter()
    assert fed.feed(READ_HOLDING_REQUEST[:5], START_NS) == []
    assert fed.advance(START_NS + HOLD_NS - 1) == []
    assert raws(fed.advance(START_NS + HOLD_NS)) == [READ_HOLDING_REQUEST[:5]]
    sent = line().send(READ_HOLDING_REQUEST[:5]).frame(READ_HOLDING_REQUEST[5:], HOLD_NS)
    assert adus(heard(sent)) == []


def test_hold_lasts_for_t3_5_where_that_is_longer() -> None:
    slow = SerialFormat(30)
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
    assert skipped(events)[0].checksum == Checksum(received=0x8876, computed=0x8776)


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
    assert adus(events)[0].silence_before_ns == 0
    assert skipped(events)[0].checksum is None
    events = heard(burst(b"\xff\xfe\xfd", READ_HOLDING_REQUEST), timed=False)
    assert adus(events)[0].verdicts == (Verdict.NOISE_BEFORE,)


def test_noise_before_a_silence_is_none_of_the_next_frame() -> None:
    events = heard(line().send(b"\xff").frame(READ_HOLDING_REQUEST, T3_5))
    assert raws(events) == [b"\xff", READ_HOLDING_REQUEST]
    assert adus(events)[0].verdicts == ()
    assert adus(events)[0].silence_before_ns == T3_5


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("stray", ["00", "F8", "FC", "FE", "FF", "00 00", "FF FE", "F8 00 FF"])
def test_stray_bytes_between_glued_frames_are_all_that_is_skipped(stray: str, timed: bool) -> None:
    noise = bytes.fromhex(stray)
    parts = [*READS, noise, *OTHERS, noise, READS[0], noise, READS[1], WRITE, noise, WRITE, *OTHERS]
    events = heard(burst(*parts), timed=timed)
    assert raws(events) == parts
    assert directions(events) == [REQUEST, RESPONSE] * 5
    behind = [before is noise for before, part in pairwise(parts) if part is not noise]
    assert [Verdict.NOISE_BEFORE in adu.verdicts for adu in adus(events)] == [False, *behind]


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


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("lost", range(len(READ_HOLDING_RESPONSE)))
def test_frame_behind_one_that_lost_a_byte_is_found(lost: int, timed: bool) -> None:
    rest = READ_HOLDING_RESPONSE[:lost] + READ_HOLDING_RESPONSE[lost + 1 :]
    for parts in ((READS[0], rest, *OTHERS), (READS[0], rest, WRITE, WRITE, *OTHERS)):
        events = heard(burst(*parts), timed=timed)
        assert raws(events) == list(parts)
        assert directions(events) == [REQUEST, *[REQUEST, RESPONSE] * (len(parts) // 2 - 1)]


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("lost", range(len(READ_HOLDING_REQUEST)))
def test_answer_to_a_request_that_lost_a_byte_is_one(lost: int, timed: bool) -> None:
    rest = READ_HOLDING_REQUEST[:lost] + READ_HOLDING_REQUEST[lost + 1 :]
    parts = (*OTHERS, rest, READ_HOLDING_RESPONSE, *OTHERS)
    events = heard(burst(*parts), timed=timed)
    assert raws(events) == list(parts)
    assert directions(events) == [REQUEST, RESPONSE, RESPONSE, REQUEST, RESPONSE]


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("bit", range(0, 8 * len(READ_HOLDING_RESPONSE), 5))
def test_frame_behind_one_with_a_wrong_bit_is_found(bit: int, timed: bool) -> None:
    wrong = bytearray(READ_HOLDING_RESPONSE)
    wrong[bit // 8] ^= 1 << bit % 8
    parts = (READS[0], bytes(wrong), *OTHERS, *READS)
    events = heard(burst(*parts), timed=timed)
    assert raw(events) == b"".join(parts)
    assert [adu.raw for adu in adus(events)] == [READS[0], *OTHERS, *READS]


@pytest.mark.parametrize("way", ["silences", "glued", "without times"])
@pytest.mark.parametrize("damaged_at", [3, 5, 23])
def test_damaged_response_that_holds_a_frame_is_not_taken_apart(way: str, damaged_at: int) -> None:
    """For example a log of another line, read from registers."""
    request = rtu_adu(1, bytes.fromhex("03 0000 000A"))
    response = bytearray(rtu_adu(1, b"\x03\x14" + bytes(4) + OTHER_REQUEST + bytes(8)))
    response[damaged_at] ^= 0x55
    frames = (request, bytes(response), *READS)
    sent = line()
    for frame in frames:
        sent.frame(frame, 10 * MS if way == "silences" else 0)
    events = heard(sent, timed=way != "without times")
    assert raws(events) == list(frames)
    (one,) = skipped(events)
    assert one.kind is EventKind.BAD_CHECK
    assert one.checksum is not None
    assert one.checksum.computed == crc(bytes(response[:-2]))


@pytest.mark.parametrize("way", ["silences", "glued", "without times"])
def test_response_that_holds_frames_is_one(way: str) -> None:
    inner = OTHER_REQUEST + OTHER_RESPONSE + b"\x00"
    request = rtu_adu(1, bytes.fromhex("03 0000 0008"))
    frames = (request, rtu_adu(1, b"\x03\x10" + inner), *READS)
    sent = line()
    for frame in frames:
        sent.frame(frame, 10 * MS if way == "silences" else 0)
    events = heard(sent, timed=way != "without times")
    assert raws(events) == list(frames)
    assert directions(events) == [REQUEST, RESPONSE] * 2


# A capture may begin anywhere.


@pytest.mark.parametrize("way", ["silences", "glued", "without times"])
@pytest.mark.parametrize("begin", range(1, len(READ_HOLDING_RESPONSE)))
def test_capture_that_begins_inside_a_frame(begin: int, way: str) -> None:
    parts = (READ_HOLDING_RESPONSE[begin:], *OTHERS, *READS)
    sent = line()
    for part in parts:
        sent.frame(part, 10 * MS if way == "silences" else 0)
    events = heard(sent, timed=way != "without times")
    assert raws(events) == list(parts)
    assert directions(events) == [REQUEST, RESPONSE] * 2


def test_capture_that_begins_with_an_answer() -> None:
    for timed in (True, False):
        events = heard(burst(READ_HOLDING_RESPONSE, *OTHERS, *READS), timed=timed)
        assert directions(events) == [RESPONSE, *[REQUEST, RESPONSE] * 2]


@pytest.mark.parametrize("repeats", [1, 2, 6])
def test_capture_that_begins_with_the_echo_of_a_write(repeats: int) -> None:
    """The longer silence is the master's: it stands before each request."""
    sent = line().send(WRITE)
    for _ in range(repeats):
        sent.frame(WRITE, 60 * MS).frame(WRITE, 5 * MS)
    events = heard(sent.frame(READ_HOLDING_REQUEST, 60 * MS).frame(READ_HOLDING_RESPONSE, 5 * MS))
    truth = [RESPONSE, *[REQUEST, RESPONSE] * (repeats + 1)]
    for adu, is_sure, direction in zip(adus(events)[1:], sure(events)[1:], truth[1:], strict=True):
        assert adu.direction is direction or not is_sure


@pytest.mark.parametrize(
    ("start", "timed"),
    [
        ("at an echo, or a write that nobody answers", True),
        ("at an echo, or a write that nobody answers", False),
        ("at a write", True),
        ("at a write", False),
    ],
)
def test_writes_of_changing_values_are_told_from_their_echoes(start: str, timed: bool) -> None:
    """Only writes, with their echoes directly after them; the master polls every 100 ms."""
    sent = line()
    if start != "at a write":
        sent.send(rtu_adu(5, bytes.fromhex("06 0001 0000")))
    for value in range(1, 9):
        write = rtu_adu(5, bytes((0x06, 0, 1, 0, value)))
        sent.frame(write, 100 * MS).frame(write, 5 * MS)
    events = heard(sent, timed=timed)
    first = len(adus(events)) % 2
    for adu, is_sure, direction in zip(
        adus(events)[first:], sure(events)[first:], [REQUEST, RESPONSE] * 8, strict=True
    ):
        assert adu.direction is direction or not is_sure
    assert directions(events)[-2:] == [REQUEST, RESPONSE]


def test_retry_glued_to_its_echo_is_right_or_ambiguous() -> None:
    """An adapter delivers 62 bytes at once, so the silences between reads say little."""
    sent = polled(latency_ns=100 * MS).frame(WRITE, 30 * MS)
    sent.frame(WRITE + WRITE + b"".join(OTHERS), 98 * MS)
    events = heard(sent)
    for adu, is_sure, direction in zip(
        adus(events)[40:], sure(events)[40:], [REQUEST, *[REQUEST, RESPONSE] * 2], strict=True
    ):
        assert adu.direction is direction or not is_sure


@pytest.mark.parametrize("timed", [True, False])
def test_unknown_request_that_is_repeated_is_right_or_ambiguous(timed: bool) -> None:
    request = rtu_adu(0x63, bytes.fromhex("6D 5A5C 29CA"))
    response = rtu_adu(0x63, bytes.fromhex("6D 269A 2CC9 E2E1"))
    events = heard(burst(*READS, request, request, response, *OTHERS), timed=timed)
    truth = [REQUEST, RESPONSE, REQUEST, REQUEST, RESPONSE, REQUEST, RESPONSE]
    for adu, is_sure, direction in zip(adus(events), sure(events), truth, strict=True):
        assert adu.direction is direction or not is_sure


def test_count_whose_request_was_damaged_is_a_response() -> None:
    """A request for a count has 0000 as data."""
    count = rtu_adu(5, bytes.fromhex("08 000B 0108"))
    damaged = bytearray(rtu_adu(5, bytes.fromhex("08 000B 0000")))
    damaged[5] ^= 0x10
    for timed in (True, False):
        events = heard(burst(*READS, bytes(damaged), count, *OTHERS), timed=timed)
        assert raws(events) == [*READS, bytes(damaged), count, *OTHERS]
        assert directions(events) == [REQUEST, RESPONSE, RESPONSE, REQUEST, RESPONSE]


def test_clock_that_was_set_back_ends_what_was_held() -> None:
    fed = splitter()
    fed.feed(READ_HOLDING_REQUEST, START_NS)
    hour = 3_600_000_000_000
    assert raws(fed.feed(READ_HOLDING_RESPONSE, START_NS - hour)) == [READ_HOLDING_REQUEST]
    (adu,) = adus(fed.advance(START_NS - hour + T3_5))
    assert adu.end_ns == START_NS - hour


def test_clock_that_was_set_back_leaves_no_time_that_is_still_to_come() -> None:
    fed = splitter()
    write = rtu_adu(5, bytes.fromhex("06 0001 0003"))
    hour = 3_600_000_000_000
    fed.feed(write, START_NS)
    fed.advance(START_NS + HOLD_NS)
    events = fed.feed(write, START_NS - hour) + fed.advance(START_NS - hour + HOLD_NS)
    (adu,) = adus(events)
    assert (adu.direction, adu.silence_before_ns) == (REQUEST, None)


def test_noise_across_a_full_window_counts_as_damage() -> None:
    noise = random.Random(5).randbytes(2000)
    fed = splitter()
    fed.feed(rtu_adu(5, bytes.fromhex("06 0001 0003")), START_NS)
    fed.feed(noise, START_NS + 3000 * CHARACTER)
    assert fed._model.state.follows_damage


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


# Damage that bit repair explains.


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("at", range(1, 8))
def test_echo_of_a_write_with_one_wrong_bit_is_a_sure_response(at: int, timed: bool) -> None:
    """The CRC tells what the damaged frame was, and so what the next one is."""
    damaged = bytearray(WRITE)
    damaged[at] ^= 0x10
    sent = polled().frame(WRITE, 30 * MS).frame(WRITE, 5 * MS).frame(OTHER_REQUEST, 30 * MS)
    sent.frame(OTHER_RESPONSE, 5 * MS).frame(rtu_adu(5, b"\x03\0\0\0\x01"), 30 * MS)
    sent.frame(rtu_adu(5, b"\x03\x02\0\0"), 5 * MS).frame(bytes(damaged), 30 * MS).frame(
        WRITE, 5 * MS
    )
    events = heard(sent.frame(OTHER_REQUEST, 30 * MS), timed=timed)
    assert bytes(damaged) in raws(events)
    *_, echo, other = adus(events)
    assert (echo.raw, echo.direction, other.raw) == (WRITE, RESPONSE, OTHER_REQUEST)
    assert echo.confidence >= SURE


@pytest.mark.parametrize("damage", [b"\x04", b""], ids=["wrong", "lost"])
def test_request_whose_last_byte_is_damaged_is_not_the_shorter_response_in_it(
    damage: bytes,
) -> None:
    """A CRC that ends in 00 is correct without that byte, too."""
    pdus = (bytes((0x01, 2, 7, 0, quantity)) for quantity in range(1, 256))
    request = next(raw for raw in (rtu_adu(0x11, pdu) for pdu in pdus) if raw[-1] == 0)
    bits = int.from_bytes(request[4:6])
    response = rtu_adu(0x11, bytes((0x01, -(-bits // 8))) + bytes(-(-bits // 8)))
    sent = polled().frame(request, 30 * MS).frame(response, 5 * MS)
    damaged = request[:-1] + damage
    sent.frame(damaged, 30 * MS).frame(response, 5 * MS).frame(OTHER_REQUEST, 30 * MS)
    events = heard(sent)
    assert raws(events)[-3:] == [damaged, response, OTHER_REQUEST]
    assert isinstance(events[-3], Skipped)


def test_frames_in_the_registers_of_a_damaged_frame_are_in_doubt() -> None:
    """Without silences, two frames among skipped bytes may be real, or contents of registers."""
    held = b"".join(OTHERS)
    long = bytearray(rtu_adu(0x11, b"\x03\x1a" + bytes(range(5)) + held + bytes(range(6))))
    long[0:3] = b"\x55\x44\x99"
    events = heard(burst(*READS, *OTHERS, bytes(long), *READS), timed=False)
    inner = [adu for adu in adus(events)[4:] if adu.raw in OTHERS]
    assert all(adu.confidence < SURE for adu in inner)
    assert raws(events)[-2:] == [*READS]
    assert sure(events)[-2:] == [True, True]


@pytest.mark.parametrize("after_ns", [200 * MS, 500 * MS, 1000 * MS])
@pytest.mark.parametrize("pairs", [1, 8])
def test_retry_of_a_damaged_write_does_not_reverse_the_directions(
    pairs: int, after_ns: int
) -> None:
    """One bit is wrong on the wire, so the slave did not understand it either."""
    damaged = bytearray(WRITE)
    damaged[3] ^= 0x40
    sent = line()
    for _ in range(pairs):
        sent.frame(WRITE, 20 * MS).frame(WRITE, 5 * MS)
    sent.frame(bytes(damaged), 20 * MS).frame(WRITE, after_ns).frame(WRITE, 5 * MS)
    for _ in range(20):
        sent.frame(WRITE, 20 * MS).frame(WRITE, 5 * MS)
    events = heard(sent)
    truth = [REQUEST, RESPONSE] * (pairs + 21)
    for adu, is_sure, direction in zip(adus(events), sure(events), truth, strict=True):
        assert adu.direction is direction or not is_sure


def test_response_with_stray_bytes_that_looks_like_a_request_is_read_again() -> None:
    """A frame remembered as a request may be incomplete later."""
    answer = bytes.fromhex("01 02 01 05 61 8B")
    assert adus(heard(line().send(answer + b"\x00\x00").frame(answer, 100 * MS)))


def test_write_of_no_coil_value_is_a_request_all_the_same() -> None:
    """A test tool sends what no master sends; the exception response shows that."""
    for pdu in ("05 0000 1234", "08 0002 0001"):
        request = rtu_adu(5, bytes.fromhex(pdu))
        refusal = rtu_adu(5, bytes((int(pdu[:2], 16) | 0x80, 3)))
        sent = polled().frame(request, 30 * MS).frame(refusal, 5 * MS)
        assert directions(heard(sent))[-2:] == [REQUEST, RESPONSE], pdu


@pytest.mark.parametrize(("pause_ms", "latency_ms"), [(9, 12), (20, 12), (30, 9)])
def test_unknown_functions_stay_in_step_with_an_adapter_that_splits_frames(
    pause_ms: int, latency_ms: int
) -> None:
    """Only its end shows such a frame, so others are held together with it."""
    polls = ((b"\x64\x01\x02", bytes(range(9))), (b"\x42", bytes(range(100, 120))))
    sent, frames, now_ns = Wire(FORMAT), [], START_NS
    for number in range(12):
        for pdu, data in polls:
            response = pdu[:1] + bytes([number]) + data
            for said, gap_ms in ((pdu, pause_ms), (response, latency_ms)):
                frames.append(rtu_adu(1, said))
                now_ns += gap_ms * MS
                sent.data += frames[-1]
                sent.times += [now_ns + (at + 1) * CHARACTER for at in range(len(frames[-1]))]
                now_ns = sent.times[-1]
    assert raws(adus(feed_all(splitter(), delivered(sent, Column.FTDI)))) == frames


def test_function_heard_before_is_found_again_after_hidden_bytes() -> None:
    """Without times and other frames, only the known function shows where a frame may begin."""
    one = rtu_adu(1, b"\x42\x01"), rtu_adu(1, b"\x42" + bytes(range(20)))
    other = rtu_adu(2, b"\x64\x07"), rtu_adu(2, b"\x64" + bytes(range(9)))
    sent = burst(*other * 40, *one, bytes(range(50, 90)), *other * 6)
    assert raws(adus(heard(sent, timed=False)))[-12:] == [*other * 6]
