"""One direction of a Modbus/TCP stream, cut into ADUs."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, EventKind, Origin
from mbtool.framing import MbapSplitter
from mbtool.framing.mbap import LONG_HEADER
from mbtool.framing.skips import MAX_RUN
from mbtool.modbus.adu import Adu, DirectionBy, Skipped, Transport, Verdict, mbap_adu
from tests.feeding import every_way, feed_all
from tests.modbus.reading import adus, pdus, raw, skipped

if TYPE_CHECKING:
    from collections.abc import Callable

LONGEST_LENGTH = 1454  # An ADU that fills a TCP segment of 1460 bytes.
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
    [(requests, 1, ()), (requests, 2, (Verdict.LATE_PARTS,)), (responses, 2, ())],
)
def test_a_request_in_parts_more_than_1_s_apart_is_told(
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
    assert [(one.kind, one.reason, one.raw) for one in skipped(events)] == [
        (EventKind.SKIPPED, "an ADU that never ends", WRITE_COIL_REQUEST[:-1])
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


def test_headers_of_every_length_are_known_by_their_bytes() -> None:
    matched = [
        length for length in range(0x10000) if LONG_HEADER.match(b"\r\n\0\0" + length.to_bytes(2))
    ]
    assert matched == [*range(2, LONGEST_LENGTH + 1)]
    assert LONG_HEADER.match(b"\1\2\0\1\0\6") is None
    assert LONG_HEADER.match(b"\1\2\1\0\0\6") is None


@pytest.mark.parametrize("length", [2, 3, 253, 254])
def test_an_adu_of_any_length_is_found_behind_noise(length: int) -> None:
    # 07 has no data; 0F has a byte count; both tell their length.
    pdu = b"\x07"
    if length > 2:
        count = length - 7 if length > 100 else 0
        bits = (8 * count).to_bytes(2)
        pdu = b"\x0f\0\0" + bits + bytes((count, *bytes(count))) if count else b"\x83\2"
    direction = Direction.RESPONSE if length == 3 else Direction.REQUEST
    adu = mbap_adu(7, 1, pdu)
    assert int.from_bytes(adu[4:6]) == length
    events = every_way(lambda: MbapSplitter(direction), b"\xff" * 9 + adu)
    assert [one.raw for one in adus(events)] == [adu]


def _out_of_step(*segments: bytes, direction: Direction = Direction.REQUEST) -> list[str]:
    """What segments give behind a gap: `adu` or `skipped`, until the last has come."""
    splitter = MbapSplitter(direction, by_segments=True)
    splitter.gap()
    events = [event for segment in segments for event in splitter.feed(segment, 1)]
    return [type(event).__name__.lower() for event in events]


def _in_step(*segments: bytes) -> list[str]:
    splitter = MbapSplitter(Direction.REQUEST, by_segments=True)
    events = [event for segment in segments for event in splitter.feed(segment, 1)]
    return [type(event).__name__.lower() for event in events]


_LONG_START = bytes.fromhex("0001 0000 012C 11 5A")  # claims 306 bytes, of an unknown function
_IDENTIFYING_START = bytes.fromhex("0001 0000 012C 11 2B 0D")
_KNOWN_START = bytes.fromhex("0001 0000 012C 11 03")


@pytest.mark.parametrize(
    ("segments", "events"),
    [
        ([_LONG_START + READ_HOLDING_REQUEST], []),
        ([_LONG_START, READ_HOLDING_REQUEST], ["skipped", "adu"]),
        ([_LONG_START, READ_HOLDING_REQUEST[:9]], []),
        ([_LONG_START, READ_HOLDING_REQUEST + b"\0"], []),
        ([_LONG_START, b"\0" + READ_HOLDING_REQUEST], []),
        ([_LONG_START, UNKNOWN], ["skipped", "adu"]),
        ([_LONG_START + UNKNOWN], []),
        ([_LONG_START, b"\0" + UNKNOWN], []),
        ([_KNOWN_START + READ_HOLDING_REQUEST], ["skipped", "adu"]),
        ([_KNOWN_START, READ_HOLDING_REQUEST], ["skipped", "adu"]),
        ([_KNOWN_START + READ_HOLDING_REQUEST[:11]], []),
        ([_KNOWN_START + UNKNOWN], []),
        ([_KNOWN_START, UNKNOWN], ["skipped", "adu"]),
        ([_IDENTIFYING_START + READ_HOLDING_REQUEST], ["skipped", "adu"]),
        # Its PDU has not the form of its function, so it refutes nothing.
        ([_KNOWN_START, mbap_adu(2, 0x11, bytes.fromhex("03 006B"))], []),
        ([_LONG_START, mbap_adu(2, 0x11, bytes.fromhex("03 006B"))], []),
    ],
)
def test_a_long_adu_is_awaited_until_another_refutes_it(
    segments: list[bytes], events: list[str]
) -> None:
    assert _in_step(*segments) == events
    if not events:  # It is whole when all its bytes have come.
        rest = 306 - len(b"".join(segments))
        assert _in_step(*segments, b"\xff" * rest) == ["adu"]


def test_a_header_one_byte_behind_a_false_one_refutes_a_long_adu() -> None:
    # From its byte -1 on, the second ADU looks like one of length 2.
    start = bytes.fromhex("0001 0000 05AE 11 5A")
    assert _in_step(start, mbap_adu(0x0100, 0, b"\x5a" + b"\xff" * 0x203)) == ["skipped", "adu"]


@pytest.mark.parametrize("length", [0, 1, 2, 3, 254, 255, 256, 1453, 1454, 1455, 0xFFFF])
def test_a_long_adu_is_whole_if_a_possible_header_follows(length: int) -> None:
    adu, header = long_adu(300), b"\0\2\0\0" + length.to_bytes(2)
    is_possible = 2 <= length <= LONGEST_LENGTH
    noise = b"\xff" * 20
    assert (_in_step(adu + header + noise)[:1] == ["adu"]) == is_possible
    assert _in_step(adu + header[:5]) == ["adu"]
    assert _in_step(adu + b"\0\2") == ["adu"]
    for wrong in (b"\0\2\1", b"\0\2\0\1", b"\0\2\0\1\0\6"):
        assert _in_step(adu + wrong)[:1] != ["adu"]


@pytest.mark.parametrize("length", [255, 1454, 1455])
@pytest.mark.parametrize("is_in_step", [True, False])
def test_the_longest_adu_fills_a_segment(length: int, is_in_step: bool) -> None:
    adu = long_adu(length)
    found = _in_step(adu) if is_in_step else _out_of_step(adu)
    assert (found == ["adu"]) == (length <= LONGEST_LENGTH)


@pytest.mark.parametrize(
    ("segments", "events"),
    [
        ([UNKNOWN], ["adu"]),
        ([UNKNOWN[:8], UNKNOWN[8:]], ["adu"]),
        ([UNKNOWN[:-1]], []),
        ([UNKNOWN + READ_HOLDING_REQUEST], ["adu", "adu"]),
        ([READ_HOLDING_REQUEST], ["adu"]),
        ([READ_HOLDING_REQUEST[:-1]], []),
        ([READ_HOLDING_REQUEST + b"\xff"], ["adu"]),
        ([b"\xff" + READ_HOLDING_REQUEST], ["skipped", "adu"]),
        ([b"\xff" + READ_HOLDING_REQUEST[:-1]], []),
        ([b"\xff" + READ_HOLDING_REQUEST[:-1], READ_HOLDING_REQUEST[-1:]], ["skipped", "adu"]),
        ([long_adu(300)], ["adu"]),
        ([long_adu(300)[:200], long_adu(300)[200:]], ["adu"]),
    ],
)
def test_out_of_step_the_ends_of_segments_confirm_an_adu(
    segments: list[bytes], events: list[str]
) -> None:
    assert _out_of_step(*segments) == events


@pytest.mark.parametrize(
    ("kept", "missing", "is_adu"),
    [
        (7, 5, False),
        (8, 4, True),
        (11, 1, True),
        (8, 3, False),
        (8, 5, True),
        (8, 0, False),
    ],
)
@pytest.mark.parametrize("by_segments", [True, False])
def test_a_cut_adu_needs_its_function_and_enough_missing_bytes(
    kept: int, missing: int, is_adu: bool, by_segments: bool
) -> None:
    splitter = MbapSplitter(Direction.REQUEST, by_segments=by_segments)
    splitter.feed(READ_HOLDING_REQUEST[:kept], 5)
    (event,) = splitter.gap(missing)
    assert isinstance(event, Adu) == is_adu
    assert splitter.is_idle == (is_adu and missing == 12 - kept)


def test_a_whole_foreign_or_too_long_adu_is_not_completed_by_missing_bytes() -> None:
    foreign = bytes.fromhex("0001 0001 0006 11 03")
    too_long = bytes.fromhex("0001 0000 00FF 11 5A 00")
    for by_segments, start, missing, is_adu in (
        (False, foreign, 4, False), (True, foreign, 4, False),
        (False, too_long, 252, False), (True, too_long, 252, True),
        (True, bytes.fromhex("0001 0000 05AE 11 5A 00"), 1451, True),
        (True, bytes.fromhex("0001 0000 05AF 11 5A 00"), 1452, False),
        (False, bytes.fromhex("0001 0000 00FE 11 5A 00"), 251, True),
    ):  # fmt: skip
        splitter = MbapSplitter(Direction.REQUEST, by_segments=by_segments)
        splitter.feed(start, 5)
        found = adus(splitter.gap(missing))
        assert bool(found) == is_adu, start.hex()
        if found:
            size = len(start) + missing
            assert found[0].verdicts == (
                (Verdict.CUT, Verdict.OVER_LENGTH) if size > 260 else (Verdict.CUT,)
            )


def test_out_of_step_a_cut_adu_begins_with_a_segment_or_tells_its_size() -> None:
    for by_segments, before, start, missing, is_adu in (
        (True, b"", UNKNOWN[:9], 1, True),
        (False, b"", READ_HOLDING_REQUEST[:9], 3, True),
        (True, b"\xff", READ_HOLDING_REQUEST[:9], 3, True),
        (True, b"\xff", UNKNOWN[:9], 1, False),
        (True, b"\xff", bytes.fromhex("0001 0000 0007 11 03"), 5, False),
    ):
        splitter = MbapSplitter(Direction.REQUEST, by_segments=by_segments)
        splitter.gap()
        splitter.feed(before + start, 5)
        found = adus(splitter.gap(missing))
        assert bool(found) == is_adu, (before, start.hex())
        if found:
            assert found[0].verdicts == (Verdict.RESYNCHRONISED, Verdict.CUT)


def test_a_request_may_take_1_s_and_no_ns_more() -> None:
    for ns, is_late in ((1_000_000_000, False), (1_000_000_001, True)):
        splitter = requests()
        splitter.feed(READ_HOLDING_REQUEST[:7], 5)
        (adu,) = adus(splitter.feed(READ_HOLDING_REQUEST[7:], 5 + ns))
        assert (Verdict.LATE_PARTS in adu.verdicts) == is_late


def test_an_adu_has_the_origin_of_its_last_byte() -> None:
    splitter = requests()
    first, second = Origin("f", 1), Origin("f", 2)
    (whole,) = adus(splitter.feed(READ_HOLDING_REQUEST, 1, first))
    assert (whole.origin, whole.start_ns, whole.end_ns) == (first, 1, 1)
    assert splitter.feed(READ_HOLDING_REQUEST[:-1], 1, first) == []
    (one, two) = adus(splitter.feed(READ_HOLDING_REQUEST[-1:] + WRITE_COIL_REQUEST, 2, second))
    assert (one.origin, one.start_ns, one.end_ns) == (second, 1, 2)
    assert (two.origin, two.start_ns, two.end_ns) == (second, 2, 2)


def test_a_segment_of_one_adu_is_read_as_one_in_pieces() -> None:
    # The short way for a whole ADU takes no other segment.
    for segment in (
        READ_HOLDING_REQUEST + b"\0", READ_HOLDING_REQUEST[:-1], mbap_adu(1, 1, bytes(253)),
        bytes.fromhex("0001 0000 0001 11"), bytes.fromhex("0001 0001 0002 11 07"),
        bytes.fromhex("0001 0000 0106 11 03 006B 0003"), bytes.fromhex("0001 0000 0002 11 07"),
    ):  # fmt: skip
        every_way(requests, segment)
