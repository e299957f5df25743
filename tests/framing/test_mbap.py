"""One direction of a Modbus/TCP stream, cut into ADUs."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, EventKind
from mbtool.framing import MbapSplitter
from mbtool.framing.mbap import LONGEST_LENGTH
from mbtool.framing.skips import MAX_RUN
from mbtool.modbus.adu import Adu, DirectionBy, Skipped, Transport, Verdict
from mbtool.modbus.adu_bytes import mbap_adu
from tests.feeding import every_way, feed_all
from tests.modbus.reading import adus, pdus, raw, skipped

if TYPE_CHECKING:
    from collections.abc import Callable

READ_HOLDING_REQUEST = bytes.fromhex(
    "0001"          # transaction id
    "0000"          # protocol id
    "0006"          # length
    "11"            # unit id
    "03 006B 0003"  # read holding registers, address 107, quantity 3
)  # fmt: skip
WRITE_COIL_REQUEST = bytes.fromhex("0002 0000 0006 11 05 00AC FF00")
READ = (0x11, "03006b0003")
WRITE = (0x11, "0500acff00")


def requests() -> MbapSplitter:
    return MbapSplitter(Direction.REQUEST)


def responses() -> MbapSplitter:
    return MbapSplitter(Direction.RESPONSE)


def test_reads_an_adu() -> None:
    (adu,) = adus(every_way(requests, READ_HOLDING_REQUEST))
    assert adu.transport is Transport.TCP
    assert (adu.direction, adu.direction_by, adu.confidence) == (
        Direction.REQUEST, DirectionBy.PORT, 1.0,
    )  # fmt: skip
    assert (adu.transaction_id, adu.unit, adu.pdu.hex()) == (1, *READ)
    assert adu.raw == READ_HOLDING_REQUEST
    assert adu.checksum is None
    assert adu.verdicts == ()


def test_finds_each_of_several_adus_in_a_segment() -> None:
    events = every_way(requests, READ_HOLDING_REQUEST + WRITE_COIL_REQUEST + READ_HOLDING_REQUEST)
    assert pdus(events) == [READ, WRITE, READ]
    assert skipped(events) == []


def test_adu_has_the_times_of_the_segments_that_began_and_completed_it() -> None:
    splitter = requests()
    assert splitter.feed(READ_HOLDING_REQUEST[:5], 100) == []
    assert splitter.feed(READ_HOLDING_REQUEST[5:9], 200) == []
    (first,) = adus(splitter.feed(READ_HOLDING_REQUEST[9:] + WRITE_COIL_REQUEST[:1], 300))
    (second,) = adus(splitter.feed(WRITE_COIL_REQUEST[1:], 400))
    assert (first.start_ns, first.end_ns) == (100, 300)
    assert (second.start_ns, second.end_ns) == (300, 400)


@pytest.mark.parametrize(
    ("splitter", "seconds", "verdicts"),
    [(requests, 30, ()), (requests, 31, (Verdict.LATE_PARTS,)), (responses, 31, ())],
)
def test_a_request_in_parts_more_than_30_s_apart_is_told(
    splitter: Callable[[], MbapSplitter], seconds: int, verdicts: tuple[Verdict, ...]
) -> None:
    splits, whole = splitter(), bytes.fromhex("0001 0000 0006 01 05 0001 FF00")
    assert splits.feed(whole[:7], 0) == []
    (adu,) = splits.feed(whole[7:], seconds * 1_000_000_000)
    assert isinstance(adu, Adu)
    assert adu.verdicts == verdicts


@pytest.mark.parametrize("length", [2, 254])
def test_length_may_be_from_2_to_254(length: int) -> None:
    adu = mbap_adu(7, 1, bytes(length - 1))
    assert adus(every_way(requests, adu))[0].raw == adu


@pytest.mark.parametrize("length", [0, 1, 255, 0xFFFF])
def test_finds_the_next_adu_after_an_impossible_header(length: int) -> None:
    garbage = bytes.fromhex("0001 0000") + length.to_bytes(2) + b"\x11\x03"
    events = every_way(requests, garbage + READ_HOLDING_REQUEST)
    assert [type(event).__name__ for event in events] == ["Skipped", "Adu"]
    assert skipped(events)[0].raw == garbage
    assert skipped(events)[0].kind is EventKind.SKIPPED
    assert adus(events)[0].verdicts == (Verdict.RESYNCHRONISED,)


def test_is_back_in_step_after_the_adu_it_found() -> None:
    unknown = mbap_adu(3, 1, b"\x41\x00")
    events = every_way(requests, b"\xff" * 9 + READ_HOLDING_REQUEST + unknown)
    assert pdus(events) == [READ, (1, "4100")]
    assert adus(events)[1].verdicts == ()


def test_is_not_deceived_by_zeros_in_register_data() -> None:
    # Out of step, `0000 0000 0002 05 06` looks like a header, but 06 has more than one byte.
    data = bytes.fromhex("FFFF FFFF FFFF 0000 0000 0002 05 06")
    events = every_way(requests, data + READ_HOLDING_REQUEST)
    assert pdus(events) == [READ]
    assert skipped(events)[0].raw == data


def test_is_not_deceived_by_a_header_that_leaves_no_room_for_its_function() -> None:
    # Out of step, a length of 2 behind which 0F stands, whose byte count would come later.
    data = bytes.fromhex("FFFF FFFF FFFF FF 0000 0000 0002 01 0F")
    events = every_way(requests, data + READ_HOLDING_REQUEST)
    assert pdus(events) == [READ]
    assert skipped(events)[0].raw == data


def test_is_not_deceived_by_register_data_behind_a_gap() -> None:
    splitter = requests()
    splitter.gap()
    data = bytes.fromhex("0000 0000 0003 01 06 05")
    assert pdus(splitter.feed(data + READ_HOLDING_REQUEST, 1)) == [READ]


def test_unknown_function_is_skipped_out_of_step_only() -> None:
    unknown = mbap_adu(3, 1, b"\x41\x00")
    assert pdus(every_way(requests, unknown)) == [(1, "4100")]
    events = every_way(requests, b"\xff" * 7 + unknown + READ_HOLDING_REQUEST)
    assert pdus(events) == [READ]


def test_malformed_pdu_is_an_adu_in_step() -> None:
    malformed = mbap_adu(3, 1, bytes.fromhex("03 006B"))
    assert pdus(every_way(requests, malformed + READ_HOLDING_REQUEST)) == [(1, "03006b"), READ]


def test_foreign_protocol_is_one_event_and_the_splitter_stays_in_step() -> None:
    foreign = bytes.fromhex("0000 0001 0006 00 02 0000 0010")  # Protocol id 1.
    events = every_way(requests, foreign + READ_HOLDING_REQUEST)
    assert [(one.kind, one.raw) for one in skipped(events)] == [(EventKind.FOREIGN, foreign)]
    assert skipped(events)[0].reason == "protocol id 0001H, where Modbus has 0000H"
    assert adus(events)[0].verdicts == ()


def test_adu_that_never_ends_comes_out_as_skipped() -> None:
    events = every_way(requests, READ_HOLDING_REQUEST + WRITE_COIL_REQUEST[:-1])
    assert pdus(events) == [READ]
    assert [(one.reason, one.raw) for one in skipped(events)] == [
        ("an ADU that never ends", WRITE_COIL_REQUEST[:-1])
    ]


def test_resynchronises_behind_a_gap() -> None:
    splitter = requests()
    assert splitter.feed(READ_HOLDING_REQUEST[:9], 100) == []
    assert raw(splitter.gap()) == READ_HOLDING_REQUEST[:9]
    events = splitter.feed(READ_HOLDING_REQUEST[-3:] + WRITE_COIL_REQUEST, 200)
    assert pdus(events) == [WRITE]
    assert skipped(events)[0].raw == READ_HOLDING_REQUEST[-3:]
    assert adus(events)[0].verdicts == (Verdict.RESYNCHRONISED,)
    assert splitter.close() == []


UNKNOWN = mbap_adu(3, 0x11, bytes.fromhex("63 0102"))


def in_segments(*segments: bytes) -> list[Adu | Skipped]:
    """Feed segments behind a gap."""
    splitter = MbapSplitter(Direction.REQUEST, by_segments=True)
    splitter.gap()
    return [event for segment in segments for event in splitter.feed(segment, 1)]


def test_out_of_step_a_malformed_adu_is_one_whole_segment() -> None:
    # An exception has two bytes: function and code. This one has three.
    malformed = bytes.fromhex("0001 0000 0004 0A 81 06 00")
    splitter = MbapSplitter(Direction.RESPONSE, by_segments=True)
    assert splitter.gap(10) == []
    assert raw(adus(splitter.feed(malformed, 0))) == malformed
    for rest in (malformed + b"\0" * 3, malformed[:-1]):
        splitter = MbapSplitter(Direction.RESPONSE, by_segments=True)
        assert splitter.gap(10) == []
        assert adus(splitter.feed(rest, 0)) == []


def test_out_of_step_an_unknown_function_begins_and_ends_with_a_segment() -> None:
    (adu,) = adus(in_segments(UNKNOWN))
    assert (adu.pdu.hex(), adu.verdicts) == ("630102", (Verdict.RESYNCHRONISED,))
    assert pdus(in_segments(b"\xff" * 9, UNKNOWN)) == [(0x11, "630102")]
    assert pdus(in_segments(UNKNOWN + READ_HOLDING_REQUEST)) == [(0x11, "630102"), READ]
    assert pdus(in_segments(UNKNOWN[:8], UNKNOWN[8:])) == [(0x11, "630102")]
    assert pdus(in_segments(b"\xff" + UNKNOWN)) == []
    assert pdus(in_segments(UNKNOWN + b"\xff" * 9)) == []


def test_out_of_step_a_known_function_begins_or_ends_with_a_segment_or_a_header_follows() -> None:
    noise = b"\xff" * 9
    assert pdus(in_segments(noise + READ_HOLDING_REQUEST)) == [READ]
    assert pdus(in_segments(noise + READ_HOLDING_REQUEST[:9], READ_HOLDING_REQUEST[9:])) == [READ]
    assert pdus(in_segments(noise + READ_HOLDING_REQUEST + WRITE_COIL_REQUEST)) == [READ, WRITE]
    assert pdus(in_segments(noise + READ_HOLDING_REQUEST + WRITE_COIL_REQUEST[:3])) == [READ]
    assert pdus(in_segments(READ_HOLDING_REQUEST + noise)) == [READ]
    assert pdus(in_segments(noise + READ_HOLDING_REQUEST + noise)) == []


def long_adu(length: int, number: int = 1) -> bytes:
    """An ADU of function 5AH with a length field, filled with bytes that look random."""
    return mbap_adu(number, 0, b"\x5a" + random.Random(length * 7 + number).randbytes(length - 2))


def by_segments(*segments: bytes) -> list[Adu | Skipped]:
    """Feed segments from the start of a stream, and end it."""
    return feed_all(
        MbapSplitter(Direction.REQUEST, by_segments=True), [(one, 1) for one in segments]
    )


@pytest.mark.parametrize("length", [255, 256, 512, 1021, LONGEST_LENGTH])
def test_an_adu_above_the_limit_that_ends_with_its_segment_is_read(length: int) -> None:
    first, second = long_adu(length, 1), long_adu(length, 2)
    for segments in (
        [first, second],
        [first + second],
        [first[:200], first[200:], second],
        [first[:5], first[5:] + second[:100], second[100:]],
        [first, READ_HOLDING_REQUEST, second],
    ):
        events = by_segments(*segments)
        assert raw(events) == b"".join(segments)
        long = [adu for adu in adus(events) if adu.raw != READ_HOLDING_REQUEST]
        assert [adu.raw for adu in long] == [first, second]
        assert all(adu.verdicts == (Verdict.OVER_LENGTH,) for adu in long)
        assert len(events) == 2 + (READ_HOLDING_REQUEST in segments)


def test_an_adu_above_the_limit_is_not_read_from_the_bytes_alone() -> None:
    assert adus(every_way(requests, long_adu(255))) == []


def test_an_adu_longer_than_a_segment_of_ethernet_is_not_read() -> None:
    events = by_segments(long_adu(LONGEST_LENGTH + 1), READ_HOLDING_REQUEST)
    assert pdus(events) == [READ]


@pytest.mark.parametrize("length", [255, 262, 1454])
def test_a_wrong_length_above_the_limit_delays_no_adu(length: int) -> None:
    wrong = bytes.fromhex("0001 0000") + length.to_bytes(2) + b"\x11\x03"
    read = READ_HOLDING_REQUEST
    for segments in ([wrong + read], [wrong, read], [wrong, UNKNOWN]):
        splitter = MbapSplitter(Direction.REQUEST, by_segments=True)
        events = [event for segment in segments for event in splitter.feed(segment, 1)]
        assert [type(event).__name__ for event in events] == ["Skipped", "Adu"]
        assert events[0].raw == wrong
        assert splitter.is_idle


@pytest.mark.parametrize("pdu", ["5a0001", "03006b0003", "0f000000100201"])
def test_an_adu_whose_end_the_capture_lacks_keeps_unit_and_function(pdu: str) -> None:
    adu = mbap_adu(7, 0x11, bytes.fromhex(pdu))
    for kept in range(8, len(adu)):
        splitter = requests()
        assert splitter.feed(adu[:kept], 5) == []
        (cut,) = adus(splitter.gap(len(adu) - kept))
        assert (cut.unit, cut.transaction_id, cut.pdu, cut.raw) == (
            0x11, 7, adu[7:kept], adu[:kept],
        )  # fmt: skip
        assert (cut.missing, cut.size, cut.verdicts) == (len(adu) - kept, len(adu), (Verdict.CUT,))
        # The next byte begins a header: a function that no table knows is read at any place.
        assert pdus(splitter.feed(UNKNOWN + b"\xff", 6)) == [(0x11, "630102")]


def test_without_the_function_code_or_with_too_few_bytes_missing_nothing_is_read() -> None:
    for kept, missing in ((7, 5), (9, 2), (9, 0)):
        splitter = requests()
        splitter.feed(READ_HOLDING_REQUEST[:kept], 5)
        (event,) = splitter.gap(missing)
        assert (type(event).__name__, event.raw) == ("Skipped", READ_HOLDING_REQUEST[:kept])


def test_behind_a_cut_adu_and_further_missing_bytes_it_is_out_of_step() -> None:
    splitter = requests()
    splitter.feed(READ_HOLDING_REQUEST[:9], 5)
    assert pdus(splitter.gap(3 + 20)) == [(0x11, "0300")]
    assert pdus(splitter.feed(UNKNOWN + READ_HOLDING_REQUEST, 6)) == [READ]


def test_direction_says_which_structure_to_expect_out_of_step() -> None:
    response = mbap_adu(1, 0x11, bytes.fromhex("03 02 1234"))
    assert pdus(every_way(responses, b"\xff" * 7 + response)) == [(0x11, "03021234")]
    assert pdus(every_way(requests, b"\xff" * 7 + response)) == []


def test_holds_no_more_than_one_adu_and_a_run_of_skipped_bytes() -> None:
    noise = random.Random(4).randbytes(1 << 20)
    splitter = requests()
    held = most = 0
    for at in range(0, len(noise), 100):
        held += 100 - len(raw(splitter.feed(noise[at : at + 100], at)))
        most = max(most, held)
    assert most < 260 + MAX_RUN


def test_a_megabyte_in_one_segment_loses_nothing() -> None:
    noise = random.Random(5).randbytes(1 << 20)
    splitter = requests()
    events = splitter.feed(noise + READ_HOLDING_REQUEST * 3, 1)
    assert raw(events + splitter.close()) == noise + READ_HOLDING_REQUEST * 3
    assert pdus(events)[-2:] == [READ, READ]


def test_is_idle_if_in_step_and_without_held_bytes() -> None:
    splitter = requests()
    idle = []
    for piece in (b"", READ_HOLDING_REQUEST[:5], READ_HOLDING_REQUEST[5:], b"\xff" * 20):
        splitter.feed(piece, 1)
        idle.append(splitter.is_idle)
    assert idle == [True, False, True, False]


def test_length_has_two_bytes() -> None:
    """Lengths of 0100H to FF00H are impossible."""
    for high in (0x01, 0x02, 0x80, 0xFF):
        garbage = bytes((0, 1, 0, 0, high, 6, 0x11, 3))
        events = every_way(requests, garbage + READ_HOLDING_REQUEST)
        assert pdus(events) == [READ]
        assert skipped(events)[0].raw == garbage


def test_unknown_function_behind_bad_bytes_is_skipped_at_the_start_of_a_stream() -> None:
    unknown = mbap_adu(3, 1, b"\x41\x00")
    events = every_way(requests, bytes.fromhex("0001 0000 0001 11") + unknown)
    assert pdus(events) == []
    splitter = requests()
    bad = bytes.fromhex("0001 0000 FFFF 11 03")
    assert pdus(splitter.feed(bad + unknown + READ_HOLDING_REQUEST, 1)) == [READ]


def test_transaction_id_has_two_bytes() -> None:
    (adu,) = adus(every_way(requests, mbap_adu(0xA5C3, 1, bytes.fromhex("03 0000 0001"))))
    assert adu.transaction_id == 0xA5C3
