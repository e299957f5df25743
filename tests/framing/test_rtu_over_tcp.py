"""One direction of RTU over TCP, cut into frames."""

from __future__ import annotations

import random

from mbtool.core import Direction, EventKind, Origin
from mbtool.framing import RtuStreamSplitter
from mbtool.framing.skips import MAX_RUN
from mbtool.modbus.adu import DirectionBy, Transport, Verdict, rtu_adu
from tests.feeding import every_way
from tests.modbus.reading import adus, pdus, raw, skipped

READ_HOLDING_REQUEST = bytes.fromhex(
    "11"            # unit
    "03 006B 0003"  # read holding registers, address 107, quantity 3
    "7687"          # CRC
)  # fmt: skip
WRITE_COIL_REQUEST = bytes.fromhex("11 05 00AC FF00 4E8B")
READ, WRITE = (0x11, "03006b0003"), (0x11, "0500acff00")


def requests() -> RtuStreamSplitter:
    return RtuStreamSplitter(Direction.REQUEST)


def responses() -> RtuStreamSplitter:
    return RtuStreamSplitter(Direction.RESPONSE)


def test_reads_a_frame() -> None:
    (adu,) = adus(every_way(requests, READ_HOLDING_REQUEST))
    assert (adu.transport, adu.direction_by) == (Transport.RTU_TCP, DirectionBy.PORT)
    assert (adu.unit, adu.pdu.hex(), adu.raw) == (*READ, READ_HOLDING_REQUEST)
    assert adu.transaction_id is None
    assert adu.checksum is not None
    assert adu.checksum.ok
    assert adu.verdicts == ()


def test_finds_each_of_several_frames() -> None:
    events = every_way(requests, READ_HOLDING_REQUEST + WRITE_COIL_REQUEST)
    assert pdus(events) == [READ, WRITE]


def test_response_that_ends_in_zero_is_read_whole() -> None:
    response = bytes.fromhex("01 04 02 0301 7800")  # Its CRC is valid one byte shorter too.
    assert adus(every_way(responses, response * 2))[0].raw == response


def test_frame_has_the_times_of_the_segments_that_began_and_completed_it() -> None:
    splitter = requests()
    assert splitter.feed(b"\xff", 50) == []
    assert splitter.feed(READ_HOLDING_REQUEST[:5], 100) == []
    events = splitter.feed(READ_HOLDING_REQUEST[5:], 200)
    assert skipped(events)[0].ts_ns == 50
    assert (adus(events)[0].start_ns, adus(events)[0].end_ns) == (100, 200)


def test_finds_the_next_frame_after_bad_bytes() -> None:
    events = every_way(requests, b"\xff\xfe" + READ_HOLDING_REQUEST)
    assert skipped(events)[0].raw == b"\xff\xfe"
    assert adus(events)[0].verdicts == (Verdict.RESYNCHRONISED,)


def test_frame_with_a_wrong_crc_is_reported_with_both_values() -> None:
    bad = READ_HOLDING_REQUEST[:-1] + b"\x88"
    (event,) = skipped(every_way(requests, READ_HOLDING_REQUEST + bad + WRITE_COIL_REQUEST))
    assert (event.kind, event.raw) == (EventKind.BAD_CHECK, bad)
    assert event.reason == "a frame with CRC 8876H, where 8776H would be right"


def test_frame_of_an_unknown_function_is_skipped() -> None:
    unknown = rtu_adu(1, b"\x41\x00")
    events = every_way(requests, unknown + READ_HOLDING_REQUEST)
    assert pdus(events) == [READ]
    assert skipped(events)[0].raw == unknown


def test_frame_behind_a_false_beginning_comes_out_when_the_stream_ends() -> None:
    false = bytes.fromhex("01 10 0000 007B F6")  # Would be a write of 123 registers.
    events = every_way(requests, false + READ_HOLDING_REQUEST)
    assert pdus(events) == [READ]
    assert skipped(events)[0].raw == false


def test_incomplete_frame_comes_out_at_a_gap() -> None:
    splitter = requests()
    splitter.feed(READ_HOLDING_REQUEST[:5], 100)
    assert raw(splitter.gap()) == READ_HOLDING_REQUEST[:5]
    assert pdus(splitter.feed(READ_HOLDING_REQUEST, 200)) == [READ]


def test_holds_no_more_than_one_frame_and_a_run_of_skipped_bytes() -> None:
    noise = random.Random(4).randbytes(1 << 18)
    splitter = responses()
    held = most = 0
    for at in range(0, len(noise), 100):
        held += 100 - len(raw(splitter.feed(noise[at : at + 100], at)))
        most = max(most, held)
    assert most < 256 + MAX_RUN


def test_is_idle_without_an_incomplete_frame() -> None:
    splitter = requests()
    frame = rtu_adu(1, bytes.fromhex("03 0000 0001"))
    idle = []
    for piece in (b"", frame[:3], frame[3:]):
        splitter.feed(piece, 1)
        idle.append(splitter.is_idle)
    assert idle == [True, False, True]


def test_frame_of_256_bytes_is_read_and_one_of_257_is_skipped() -> None:
    longest, longer = (rtu_adu(1, bytes((3, count, *bytes(count)))) for count in (251, 252))
    assert [len(longest), len(longer)] == [256, 257]
    assert [adu.raw for adu in adus(every_way(responses, longest))] == [longest]
    assert adus(every_way(responses, longer)) == []
    splitter = responses()
    assert adus(splitter.feed(longest[:255], 1)) == []
    assert [adu.raw for adu in adus(splitter.feed(longest[255:], 2))] == [longest]


def test_a_frame_that_tells_its_size_too_late_is_skipped_at_256_bytes() -> None:
    # Each of 255 objects of an identification may be followed by another.
    endless = bytes.fromhex("01 2B 0E 01 01 00 00 FF") + b"\xf0\x00" * 124
    assert len(endless) == 256
    splitter = responses()
    assert splitter.feed(endless[:255], 1) == []
    assert not splitter.is_idle
    splitter.feed(endless[255:], 2)
    frame = rtu_adu(0x41, bytes.fromhex("83 02"))
    assert pdus(splitter.feed(frame, 3)) == [(0x41, "8302")]


def test_every_frame_is_found_behind_any_single_byte() -> None:
    for byte in range(256):
        events = every_way(requests, bytes([byte]) + READ_HOLDING_REQUEST + WRITE_COIL_REQUEST)
        assert pdus(events) == [READ, WRITE]
        assert [adu.verdicts for adu in adus(events)] == [(Verdict.RESYNCHRONISED,), ()]
        assert adus(events)[0].confidence == 1.0


def test_an_adu_has_the_origins_of_its_last_byte() -> None:
    splitter = requests()
    first, second = Origin("f", 1), Origin("f", 2)
    assert splitter.feed(READ_HOLDING_REQUEST[:-1], 1, first) == []
    (one, two) = adus(splitter.feed(READ_HOLDING_REQUEST[-1:] + WRITE_COIL_REQUEST, 2, second))
    assert (one.origin, one.start_ns, one.end_ns) == (second, 1, 2)
    assert (two.origin, two.start_ns, two.end_ns) == (second, 2, 2)
