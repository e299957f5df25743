"""The truth of the plants agrees with itself and with the specification."""

from __future__ import annotations

from itertools import pairwise

import pytest

from mbtool.core import Direction, SerialFormat
from mbtool.modbus import parse_pdu, rtu_adu
from mbtool.modbus.adu import crc
from tests.benchmarks.plants import pdus
from tests.benchmarks.plants.catalog import PLANTS, record
from tests.benchmarks.plants.delivery import Adapter, delivered
from tests.benchmarks.plants.hearing import at_another_rate
from tests.benchmarks.plants.measuring import drawn_seeds, lines
from tests.benchmarks.plants.recording import Recording, Role

REQUESTS = 120
SEEDS = (1, 2, 3)
FRAMES = (Role.REQUEST, Role.RESPONSE, Role.ECHO)


@pytest.fixture(scope="module", params=PLANTS)
def recordings(request: pytest.FixtureRequest) -> list[Recording]:
    return [record(request.param, seed, REQUESTS) for seed in SEEDS]


def test_every_byte_belongs_to_one_frame_or_to_noise(recordings: list[Recording]) -> None:
    for one in recordings:
        assert one.data == b"".join(sent.raw for sent in one.sent)
        assert len(one.times) == len(one.data)
        offset = 0
        for sent in one.sent:
            assert sent.offset == offset
            offset += len(sent.raw)
            assert one.times[offset - 1] == sent.end_ns


def test_times_only_grow_and_nobody_speaks_while_another_does(
    recordings: list[Recording],
) -> None:
    for one in recordings:
        character_ns = one.line.character_ns
        assert all(after - before >= character_ns for before, after in pairwise(one.times))
        assert all(after.start_ns >= before.end_ns for before, after in pairwise(one.sent))


def test_every_frame_has_a_right_crc_and_a_length_that_rtu_allows(
    recordings: list[Recording],
) -> None:
    for one in recordings:
        for sent in one.sent:
            if sent.role in FRAMES:
                assert crc(sent.raw) == 0
                assert 4 <= len(sent.raw) <= 256
                assert sent.raw == rtu_adu(sent.raw[0], sent.raw[1:-2])


def test_a_response_comes_after_its_request_and_fits_it(recordings: list[Recording]) -> None:
    for one in recordings:
        for at, sent in enumerate(one.sent):
            if sent.role is not Role.RESPONSE:
                continue
            if sent.answers is None and {each.role for each in one.sent} == {Role.RESPONSE}:
                continue  # A listener that hears the wire of the slaves only.
            if sent.answers is None and any(each.is_damaged for each in one.sent):
                continue  # A request whose bytes are all lost.
            assert sent.answers is not None
            assert sent.answers < at
            request = one.sent[sent.answers]
            if request.is_damaged:
                continue
            assert request.role is Role.REQUEST
            assert request.unit == sent.unit
            assert request.function == sent.function & 0x7F
            if request.function in (0x01, 0x02, 0x03, 0x04) and not sent.is_exception:
                quantity = int.from_bytes(request.raw[4:6], "big")
                byte_count = quantity * 2 if request.function > 0x02 else -(-quantity // 8)
                assert sent.raw[2] == byte_count == len(sent.raw) - 5


def test_a_request_has_one_response_at_most(recordings: list[Recording]) -> None:
    for one in recordings:
        answered = [sent.answers for sent in one.sent if sent.role is Role.RESPONSE]
        answered = [at for at in answered if at is not None]
        assert len(answered) == len(set(answered))


def test_every_frame_of_a_known_function_has_its_form(recordings: list[Recording]) -> None:
    for one in recordings:
        for sent in one.sent:
            known = sent.role in (Role.REQUEST, Role.RESPONSE) and not sent.is_odd
            if known and sent.function & 0x7F not in (*pdus.USER_DEFINED, pdus.UMAS):
                parsed = parse_pdu(sent.raw[1:-2], Direction(sent.role))
                assert parsed.problem is None, sent.raw.hex(" ")


def test_the_same_seed_gives_the_same_line() -> None:
    for plant in PLANTS:
        first, again = record(plant, 7, 60), record(plant, 7, 60)
        assert (first.line, first.data, first.times) == (again.line, again.data, again.times)


def test_lines_differ_in_baud_rate_format_and_units() -> None:
    drawn = [record("clean", seed, 20) for seed in range(60)]
    assert {one.line.baud for one in drawn} == {
        1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200,
    }  # fmt: skip
    assert {(one.line.parity, one.line.stop_bits) for one in drawn} == {
        ("E", 1), ("N", 1), ("N", 2),
    }  # fmt: skip
    units = {sent.unit for one in drawn for sent in one.sent}
    assert set(range(1, 13)) < units
    assert max(units) > 100


def test_a_stray_byte_has_any_value() -> None:
    noise = [
        sent.raw
        for seed in range(40)
        for sent in record("stray bytes", seed, 300).sent
        if sent.role is Role.NOISE
    ]
    assert {len(one) for one in noise} == {1}
    assert len(set(noise)) > 200


def test_an_adapter_that_echoes_gives_each_request_twice() -> None:
    one = record("adapter echo", 1, REQUESTS)
    for at, sent in enumerate(one.sent):
        if sent.role is Role.REQUEST:
            echo = one.sent[at + 1]
            assert (echo.role, echo.copies, echo.raw) == (Role.ECHO, at, sent.raw)
            assert 300_000 <= echo.start_ns - sent.end_ns <= 700_000


def test_a_dead_unit_never_answers() -> None:
    for seed in SEEDS:
        one = record("dead units", seed, REQUESTS)
        answered = {sent.unit for sent in one.sent if sent.role is Role.RESPONSE}
        asked = {sent.unit for sent in one.sent if sent.role is Role.REQUEST}
        dead = asked - answered
        assert 1 <= len(dead) <= 2
        retries = [sent for sent in one.sent if sent.is_retry]
        assert all(sent.unit in dead for sent in retries)


def test_one_wire_has_the_frames_of_one_side_only() -> None:
    roles = [{sent.role for sent in record("only one wire", seed, 60).sent} for seed in range(12)]
    assert {frozenset(one) for one in roles} == {
        frozenset({Role.REQUEST}), frozenset({Role.RESPONSE}),
    }  # fmt: skip


def test_a_repeater_gives_each_frame_twice() -> None:
    one = record("repeater", 1, REQUESTS)
    for at, sent in enumerate(one.sent):
        if sent.role is not Role.ECHO:
            assert (one.sent[at + 1].copies, one.sent[at + 1].raw) == (at, sent.raw)


def test_bytes_that_a_listener_lost_leave_a_damaged_frame() -> None:
    sent = [one for seed in range(6) for one in record("lost bytes", seed, 200).sent]
    damaged = {one.raw for one in sent if one.is_damaged}
    assert damaged
    assert not damaged & {one.raw for one in sent if one.role is not Role.NOISE}


def test_a_line_without_bias_has_a_byte_beside_a_frame() -> None:
    for seed in SEEDS:
        one = record("bias", seed, REQUESTS)
        ends = {sent.end_ns for sent in one.sent} | {sent.start_ns for sent in one.sent}
        noise = [sent for sent in one.sent if sent.role is Role.NOISE]
        assert noise
        assert all(sent.start_ns in ends or sent.end_ns in ends for sent in noise)


def test_the_same_rate_is_heard_as_it_was_sent() -> None:
    line = SerialFormat.parse("9600-8E1")
    assert at_another_rate(bytes(range(256)), line, line) == bytes(range(256))


def test_half_the_rate_is_heard_as_pairs_of_bits() -> None:
    # 01H at 4800-8N1 is the bits 0 1 0000000 1, each twice as long as at 9600: the start bit and
    # seven more of 0 1 1 0 0 0 0 0, then nothing but zeros up to the stop bit.
    slow, fast = (SerialFormat.parse(f"{baud}-8N1") for baud in (4800, 9600))
    assert at_another_rate(b"\x01", slow, fast)[0] == 0b00000110


@pytest.mark.parametrize("adapter", Adapter)
def test_an_adapter_delivers_every_byte_in_order(adapter: Adapter) -> None:
    one = record("mixed", 1, REQUESTS)
    reads = delivered(one, adapter)
    assert b"".join(data for data, _ in reads) == one.data
    if adapter is Adapter.BACK:
        assert any(before > after for (_, before), (_, after) in pairwise(reads))
        return
    assert all(before <= after for (_, before), (_, after) in pairwise(reads))
    if adapter is Adapter.NO_TIMES:
        return
    end = 0
    for data, ts_ns in reads:
        end += len(data)
        assert ts_ns >= one.times[end - 1]


def test_reads_of_64_bytes_with_a_timeout_tear_frames() -> None:
    one = record("clean", 1, REQUESTS)
    ends = {sent.offset + len(sent.raw) for sent in one.sent}
    offset, torn = 0, 0
    for data, _ in delivered(one, Adapter.FLUSHED):
        assert len(data) <= 64
        offset += len(data)
        torn += offset not in ends
    assert torn > 0


def test_seeds_are_drawn_from_a_text() -> None:
    assert drawn_seeds("a", 3) == drawn_seeds("a", 3)
    assert len(set(drawn_seeds("a", 5)) | set(drawn_seeds("b", 5))) == 10


def test_the_requests_of_a_plant_come_from_several_lines() -> None:
    drawn = list(lines("clean", [3, 4], 300))
    assert [seed for seed, _ in drawn] == [3000, 3001, 3002, 4000, 4001, 4002]
    assert all(100 <= one.requests < 200 for _, one in drawn)
