"""Cases that plants of the benchmark have shown: write loops, noise, slow slaves, merged scans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.decode.connections import Bus
from mbtool.modbus import Adu, Outcome, Transaction, Verdict, rtu_adu
from mbtool.modbus.adu import crc as _crc
from tests.benchmarks.plants.catalog import record
from tests.benchmarks.plants.delivery import Adapter, delivered
from tests.feeding import Line

if TYPE_CHECKING:
    from collections.abc import Iterable

FORMAT = SerialFormat(19200, 8, "E", 1)
MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
READ, ANSWER = rtu_adu(1, bytes.fromhex("03 006B 0001")), rtu_adu(1, bytes.fromhex("03 02 022B"))
WRITE = rtu_adu(1, bytes.fromhex("06 001B 0016"))
OTHER_FUNCTION = rtu_adu(1, bytes.fromhex("05 0001 FF00"))
ABSENT_WRITE = rtu_adu(9, bytes.fromhex("06 001B 0016"))


def polls(line: Line, count: int, latency_ns: int = 3 * MS) -> Line:
    for _ in range(count):
        line.frame(READ, 30 * MS).frame(ANSWER, latency_ns)
    return line


def heard(reads: Iterable[tuple[bytes, int]], *, timed: bool = True) -> list[object]:
    bus = Bus("line", FORMAT, timed=timed)
    return [*(one for data, ts_ns in reads for one in bus.feed(data, ts_ns)), *bus.close()]


def transactions(decoded: list[object], function: int) -> list[Transaction]:
    return [one for one in decoded if isinstance(one, Transaction) and one.function == function]


def directions(decoded: list[object], raw: bytes) -> list[Direction]:
    return [one.direction for one in decoded if isinstance(one, Adu) and one.raw == raw]


def test_write_loop_with_varying_latency_keeps_its_directions() -> None:
    """A response that takes a little longer than those before it reverses nothing."""
    line = Line(FORMAT)
    for number in range(100):
        line.frame(WRITE, 17 * MS).frame(WRITE, (25 + number % 5) * MS)
    assert directions(heard(line.reads()), WRITE) == [REQUEST, RESPONSE] * 100


def test_write_loop_after_many_different_requests_is_pairs_without_times() -> None:
    line = polls(Line(FORMAT), 60)
    for _ in range(20):
        line.frame(WRITE, 30 * MS).frame(WRITE, 3 * MS)
    writes = transactions(heard(polls(line, 5).reads(), timed=False), 0x06)
    assert [one.outcome for one in writes] == [Outcome.OK] * 20


@pytest.mark.parametrize("count", [3, 4, 5])
def test_equal_writes_to_a_unit_that_answers_nothing_else_are_ambiguous_without_times(
    count: int,
) -> None:
    line = polls(Line(FORMAT), 20)
    for _ in range(count):
        line.frame(ABSENT_WRITE, 300 * MS)
    decoded = heard(polls(line, 5).reads(), timed=False)
    assert all(one.confidence < 0.8 for one in transactions(decoded, 0x06))


def test_requests_and_retries_that_a_buffer_merges_are_no_echo_of_the_adapter() -> None:
    """A scan of absent units, delivered 255 ms after the first byte: each request twice."""
    reads, now_ns = [], 0
    for unit in range(2, 30):
        now_ns += 455 * MS
        reads.append((rtu_adu(unit, bytes.fromhex("04 0000 0002")) * 2, now_ns))
    decoded = heard(reads)
    assert not [one for one in decoded if getattr(one, "kind", None) is EventKind.ECHO]
    assert len(transactions(decoded, 0x04)) == 56


def test_copy_of_a_request_shows_no_timeout() -> None:
    """An adapter merges a read with its retry. Then a write is answered in the same block."""
    reads, now_ns = [], 0
    for block in (READ + READ + ANSWER, READ + ANSWER, WRITE + WRITE, READ + ANSWER):
        now_ns += 300 * MS
        reads.append((block, now_ns))
    (write,) = transactions(heard(reads), 0x06)
    assert write.outcome is Outcome.OK


def test_frame_at_the_end_of_a_burst_of_noise_is_found() -> None:
    noise = bytes.fromhex("76 10 25 50 37 C1 10 F1 03 44 FF FD 83 F3 1E 25 7F 6B D8 D3")
    line = polls(Line(FORMAT), 60)
    line.frame(noise + READ, 15 * MS).frame(ANSWER, 3 * MS)
    decoded = heard(polls(line, 5).reads())
    assert [one.outcome for one in transactions(decoded, 0x03)] == [Outcome.OK] * 66


def test_response_behind_noise_may_be_torn() -> None:
    """The first bytes of the response come with the noise before it, the rest after a silence."""
    noise = bytes.fromhex("BD 08 E8 26 78 3B 17 A2 62 9B FA F2 DB 97 48 4E 0F 24 C4 5C")
    line = polls(Line(FORMAT), 60)
    line.frame(READ, 15 * MS).frame(noise + ANSWER[:5], 0).frame(ANSWER[5:], 16 * MS)
    decoded = heard(polls(line, 5).reads())
    assert [one.outcome for one in transactions(decoded, 0x03)] == [Outcome.OK] * 66


def test_first_slow_echo_of_a_line_is_ambiguous() -> None:
    line = polls(Line(FORMAT), 60, latency_ns=20 * MS)
    line.frame(WRITE, 30 * MS).frame(WRITE, 120 * MS)
    decoded = heard(polls(line, 5, latency_ns=20 * MS).reads())
    assert all(one.confidence < 0.8 for one in transactions(decoded, 0x06))


def test_slow_echo_of_another_function_is_a_response() -> None:
    """As long as one write takes, others may take as well."""
    line = polls(Line(FORMAT), 20)
    for raw in (WRITE, WRITE, OTHER_FUNCTION):
        polls(line.frame(raw, 30 * MS).frame(raw, 90 * MS), 5)
    (last,) = transactions(heard(line.reads()), 0x05)
    assert (last.outcome, last.confidence > 0.5) == (Outcome.OK, True)


def test_frame_soon_after_a_slow_echo_is_the_response_to_its_retry() -> None:
    """This master always pauses for 30 ms, so it did not ask again after 5 ms."""
    line = polls(Line(FORMAT), 30, latency_ns=75 * MS)
    line.frame(WRITE, 30 * MS).frame(WRITE, 100 * MS).frame(WRITE, 5 * MS)
    decoded = heard(polls(line, 5, latency_ns=75 * MS).reads())
    assert directions(decoded, WRITE)[2] is RESPONSE


def test_frame_just_before_the_timeout_of_a_slow_line_is_no_sure_retry() -> None:
    line = polls(Line(FORMAT), 20, latency_ns=90 * MS)
    line.frame(READ, 30 * MS).frame(READ, 100 * MS).frame(ANSWER, 10 * MS)
    polls(line, 20, latency_ns=90 * MS).frame(WRITE, 30 * MS).frame(WRITE, 100 * MS)
    decoded = heard(polls(line, 5, latency_ns=90 * MS).reads())
    assert all(one.confidence < 0.8 for one in transactions(decoded, 0x06))


def merged_scan(units: range) -> list[tuple[bytes, int]]:
    """A scan of absent units with 08. An adapter delivers each request with its retry."""
    reads, now_ns = [(READ + ANSWER, 0)], 0
    for unit in units:
        now_ns += 520 * MS
        reads.append((rtu_adu(unit, bytes.fromhex("08 0000 A537")) * 2, now_ns))
    return reads


def test_requests_and_retries_that_an_adapter_merges_are_no_sure_pairs() -> None:
    """All silences are longer than the master's timeout, so it may lie between two equal frames."""
    scanned = transactions(heard(merged_scan(range(2, 60))), 0x08)
    assert all(one.confidence < 0.8 for one in scanned[4:])


def test_full_buffer_between_merged_retries_does_not_make_them_sure_pairs() -> None:
    reads = merged_scan(range(2, 30))
    now_ns = reads[-1][1]
    for _ in range(2):  # 30 bytes each, and the first two of the next frame: a full buffer.
        now_ns += 50 * MS
        reads.append(((READ + ANSWER) * 2 + READ[:2], now_ns))
        now_ns += 50 * MS
        reads.append((READ[2:] + ANSWER, now_ns))
    reads += [(raw, now_ns + ts_ns + 520 * MS) for raw, ts_ns in merged_scan(range(30, 60))]
    scanned = transactions(heard(reads), 0x08)
    assert all(one.confidence < 0.8 for one in scanned[4:])


def test_response_that_an_adapter_merges_with_its_request_is_sure_beside_short_silences() -> None:
    """An adapter that holds bytes back for 16 ms merges no retry."""
    reads, now_ns = [(READ + ANSWER, 0)], 0
    for unit in range(2, 30):
        now_ns += 36 * MS
        reads.append((rtu_adu(unit, bytes.fromhex("08 0000 A537")) * 2, now_ns))
    scanned = transactions(heard(reads), 0x08)
    assert [one.outcome for one in scanned] == [Outcome.OK] * 28
    # Three short silences between bursts show that the adapter does not merge for long.
    assert [one.confidence >= 0.8 for one in scanned] == [False] * 3 + [True] * 25


def test_write_merged_with_its_response_on_a_slow_line_is_no_sure_retry() -> None:
    """Each poll comes 500 ms after the one before, so nothing shows how long bytes are held."""
    reads = [
        (READ + ANSWER if number % 2 else ABSENT_WRITE * 2, number * 500 * MS)
        for number in range(30)
    ]
    writes = transactions(heard(reads), 0x06)
    assert all(one.confidence < 0.8 for one in writes[3:])


def test_an_echo_later_than_any_response_heard_is_ambiguous_also_at_the_beginning() -> None:
    """In a scan with 08 a retry comes 100 ms after its request, and just one unit has answered."""
    read, answer = rtu_adu(0x18, bytes.fromhex("03 006B 0001")), bytes.fromhex("03 02 022B")
    line = Line(FORMAT).frame(read, 0).frame(rtu_adu(0x18, answer), 24 * MS)
    echo = rtu_adu(5, bytes.fromhex("08 0000 A537"))
    line.frame(echo, 32 * MS).frame(echo, 100 * MS)
    bus = Bus("line", FORMAT)
    decoded = [one for data, ts_ns in line.reads() for one in bus.feed(data, ts_ns)]
    first, second = [one for one in [*decoded, *bus.close()] if isinstance(one, Transaction)]
    assert (first.unit, Verdict.AMBIGUOUS in first.verdicts) == (0x18, False)
    assert (second.unit, Verdict.AMBIGUOUS in second.verdicts) == (5, True)


def test_write_loop_slower_than_its_pauses_is_right_once_a_read_tells_the_direction() -> None:
    """Until then the directions may be reversed, and nothing is learned from the frames."""
    line = Line(FORMAT)
    for number in range(50):
        line.frame(WRITE, 9 * MS).frame(WRITE, (15 + number % 7) * MS)
    line.frame(READ, 9 * MS).frame(ANSWER, 15 * MS)
    for number in range(50):
        line.frame(WRITE, 9 * MS).frame(WRITE, (15 + number % 7) * MS)
    writes = [one for one in heard(line.reads()) if isinstance(one, Adu) and one.raw == WRITE]
    assert all(one.confidence < 0.8 for one in writes[2:99])
    assert [one.direction for one in writes[100:]] == [REQUEST, RESPONSE] * 50


def test_request_behind_an_answered_retry_is_no_second_response() -> None:
    """It comes when this master goes on; a slave would answer a second time at once."""
    line = polls(Line(FORMAT), 60).frame(WRITE, 30 * MS).frame(WRITE, 250 * MS)
    line.frame(WRITE, 7 * MS)
    for _ in range(10):
        line.frame(WRITE, 30 * MS).frame(WRITE, 7 * MS)
    truth = [REQUEST, REQUEST, RESPONSE, *[REQUEST, RESPONSE] * 10]
    decoded = heard(polls(line, 3).reads())
    told = [one for one in decoded if isinstance(one, Adu) and one.raw == WRITE]
    for one, direction in zip(told, truth, strict=True):
        assert one.direction is direction or one.confidence < 0.8
    assert [one.direction for one in told[4:]] == truth[4:]


def test_loop_of_an_odd_number_of_writes_is_the_surer_the_earlier_without_times() -> None:
    """One of eleven requests has no response, and nothing tells which."""
    line = polls(Line(FORMAT), 20)
    for _ in range(21):
        line.frame(WRITE, 30 * MS)
    decoded = heard([(bytes(polls(line, 5).data), 1)], timed=False)
    told = [one for one in decoded if isinstance(one, Adu) and one.raw == WRITE]
    assert [one.direction for one in told] == [*[REQUEST, RESPONSE] * 10, REQUEST]
    echoes = [one.confidence for one in told[1::2]]
    assert echoes == sorted(echoes, reverse=True)
    assert echoes[0] > 0.9
    assert echoes[-1] < 0.2


def test_merged_write_of_several_values_that_comes_twice_is_ambiguous() -> None:
    """Some slaves repeat the whole request, and an adapter that merges hides the time between."""
    write = rtu_adu(1, bytes.fromhex("10 0010 0001 02 1234"))
    line = polls(Line(FORMAT), 20)
    reads = line.reads()
    now_ns = reads[-1][1] + 30 * MS
    reads += [(write + write, now_ns), (READ + ANSWER, now_ns + 40 * MS)]
    _, second = (one for one in heard(reads) if isinstance(one, Adu) and one.raw == write)
    assert second.confidence < 0.8
    assert all(one.confidence < 0.8 for one in transactions(heard(reads), 0x10))


def test_copy_of_a_write_of_several_values_does_not_end_the_echo_of_an_adapter() -> None:
    write, done = (
        rtu_adu(1, bytes.fromhex(pdu)) for pdu in ("10 0010 0001 02 1234", "10 0010 0001")
    )
    reads, now_ns = [], 0
    for request, response in [(READ, ANSWER)] * 2 + [(write, done)] + [(READ, ANSWER)] * 5:
        now_ns += 40 * MS
        reads.append((request + request + response, now_ns))
    kinds = [str(one.kind) for one in heard(reads) if hasattr(one, "kind")]
    assert kinds.count("echo") >= 4


def test_long_frame_of_an_unknown_function_does_not_swallow_frames_with_correct_crcs() -> None:
    """The first bytes of the last frame are, by chance, the CRC of all bytes before."""
    request = rtu_adu(1, b"\x45\x01\x02")
    following = b"".join(rtu_adu(7, bytes((0x64, number, 9))) for number in range(6))
    for number in range(1 << 16):
        response = rtu_adu(1, b"\x45" + number.to_bytes(2))
        unit, function = _crc(response + following).to_bytes(2, "little")
        if 0 < unit < 248 and 0x41 <= function <= 0x48:
            break
    line = polls(Line(FORMAT), 20)
    for raw in (request, response + following, rtu_adu(unit, bytes((function, 1, 2)))):
        line.frame(raw, 30 * MS)
    told = [one.raw for one in heard(polls(line, 3).reads(), timed=False) if isinstance(one, Adu)]
    assert response in told
    assert max(map(len, told)) == 8


@pytest.mark.parametrize("timed", [True, False], ids=["with times", "without times"])
def test_equal_responses_where_only_slaves_are_heard_are_no_copies(timed: bool) -> None:
    line = Line(FORMAT)
    for number in (*range(6), *[9] * 12):
        line.frame(rtu_adu(1, bytes.fromhex("03 02 00") + bytes([number])), 40 * MS)
    told = [one for one in heard(line.reads(), timed=timed) if isinstance(one, Adu)]
    assert len(told) == 18


def test_due_frame_that_a_block_cuts_behind_a_stray_byte_is_waited_for() -> None:
    """A line without bias: a stray byte and the first bytes of a request end a block."""
    recording = record("bias", 3873541002, 100)
    bus = Bus("line", recording.line)
    reads = delivered(recording, Adapter.BURST_62)
    decoded = [one for data, ts_ns in reads for one in bus.feed(data, ts_ns)]
    told = [one for one in [*decoded, *bus.close()] if isinstance(one, Transaction)]
    assert len(told) > 90
    assert Outcome.UNSOLICITED not in {one.outcome for one in told}


def test_silence_of_an_adapter_that_holds_bytes_back_shows_no_timeout() -> None:
    """A second master asks unit 2 while unit 1 is asked, and the first request ends a block."""
    other, told_by = rtu_adu(2, READ[1:-2]), rtu_adu(2, ANSWER[1:-2])
    reads = [(READ + ANSWER, 260 * MS * (1 + number)) for number in range(2)]
    now_ns = reads[-1][1] + 130 * MS
    reads += [(READ, now_ns), (other + ANSWER + told_by, now_ns + 130 * MS)]
    late = transactions(heard(reads), 0x03)[2]
    assert (late.unit, late.confidence) == (1, 0.5)
