from __future__ import annotations

from itertools import pairwise

import pytest

from mbtool.core import Direction, SerialFormat
from mbtool.decode.pairing import Pairing
from mbtool.decode.transactions import Ends
from mbtool.modbus import Adu, Outcome, Transaction, Transport, parse_pdu
from mbtool.modbus.adu import DirectionBy, crc
from tests.benchmarks.bus_traffic import (
    EXCEPTIONS,
    RATES,
    VENDOR,
    VENDOR_EXCEPTIONS,
    Frame,
    Traffic,
    bus_traffic,
)

SEEDS = range(5)
STANDARD = {*range(0x01, 0x09), 0x0B, 0x0C, *range(0x0F, 0x12), *range(0x14, 0x19), 0x2B}


@pytest.fixture(scope="module")
def lines() -> list[Traffic]:
    return [bus_traffic(seed, 1000) for seed in SEEDS]


def test_a_seed_gives_the_same_line_again_and_another_seed_another() -> None:
    assert bus_traffic(7, 50) == bus_traffic(7, 50)
    assert bus_traffic(7, 50).data != bus_traffic(8, 50).data


def test_the_bytes_of_a_line_are_its_frames_in_order(lines: list[Traffic]) -> None:
    for traffic in lines:
        assert b"".join(frame.raw for frame in traffic.frames) == traffic.data
        assert len(traffic.times) == len(traffic.data)
        for frame in traffic.frames:
            assert traffic.data.startswith(frame.raw, frame.offset)
            assert crc(frame.raw) == 0
            assert 4 <= len(frame.raw) <= 256


@pytest.mark.parametrize("line", [SerialFormat(), SerialFormat(115200, 8, "N", 1)], ids=str)
def test_nobody_speaks_while_another_does(line: SerialFormat) -> None:
    traffic = bus_traffic(3, 500, line)
    for before, after in pairwise(traffic.frames):
        assert after.start_ns - before.end_ns >= (
            1_000_000 if after.direction is Direction.RESPONSE else line.t3_5_ns
        )
    for frame in traffic.frames:
        times = traffic.times[frame.offset : frame.offset + len(frame.raw)]
        assert times[0] >= frame.start_ns + line.character_ns
        assert times[-1] == frame.end_ns
        for one, next_one in pairwise(times):
            assert 0 <= next_one - one - line.character_ns <= line.t1_5_ns


def test_every_frame_has_the_form_of_its_function(lines: list[Traffic]) -> None:
    for frame in frames_of(lines):
        assert parse_pdu(frame.raw[1:-2], frame.direction).problem is None, frame.raw.hex(" ")


def test_every_function_is_asked_and_answered(lines: list[Traffic]) -> None:
    said = {(frame.raw[1], frame.direction) for frame in frames_of(lines)}
    for direction in Direction.REQUEST, Direction.RESPONSE:
        assert {code for code in STANDARD if (code, direction) not in said} == set()
        assert {code for code in VENDOR if (code, direction) in said}
    codes = {frame.raw[2] for frame in frames_of(lines) if frame.raw[1] & 0x80}
    assert codes == {*EXCEPTIONS, *VENDOR_EXCEPTIONS}
    identification = {frame.raw[2] for frame in frames_of(lines) if frame.raw[1] == 0x2B}
    assert identification == {0x0D, 0x0E}


def test_what_is_hard_to_tell_comes_more_often_than_by_chance(lines: list[Traffic]) -> None:
    frames = frames_of(lines)
    zero_ended = [frame for frame in frames if frame.raw[-1] == 0]
    assert len(zero_ended) > 5 * len(frames) / 256
    requests = [frame.raw for frame in frames if frame.direction is Direction.REQUEST]
    assert [raw for raw in requests if raw[1] in (1, 2) and raw[2] == 3 and 17 <= raw[5] <= 24]
    assert [raw for raw in requests if raw[1] in (1, 2, 3, 4) and raw[2] == 2 and raw[-1] == 0]
    assert [raw for raw in requests if raw[1] == 8 and len(raw) > 8]
    assert [raw for raw in requests if raw[0] == 0]
    held = [raw for raw in {frame.raw for frame in frames} if holds_a_frame(raw, set(requests))]
    assert len(held) > RATES.embedded * len(frames) / 10


def test_every_outcome_happens(lines: list[Traffic]) -> None:
    happened = {exchange.outcome for traffic in lines for exchange in traffic.exchanges}
    assert happened == set(Outcome) - {Outcome.MALFORMED, Outcome.NOT_CAPTURED}


def test_the_truth_is_what_pairing_makes_of_frames_of_known_direction(
    lines: list[Traffic],
) -> None:
    for traffic in lines:
        pairing = Pairing(Ends("line"))
        told: list[Transaction] = []
        for frame in traffic.frames:
            told += [one for one in pairing.feed(adu(frame)) if isinstance(one, Transaction)]
        told += pairing.close()
        paired = {(one.request_ns, one.response_ns): one.outcome for one in told}
        ends = [frame.end_ns for frame in traffic.frames]
        truth = {
            (
                None if one.request is None else ends[one.request],
                None if one.response is None else ends[one.response],
            ): one.outcome
            for one in traffic.exchanges
        }
        assert paired == truth


def frames_of(lines: list[Traffic]) -> list[Frame]:
    return [frame for traffic in lines for frame in traffic.frames]


def holds_a_frame(raw: bytes, others: set[bytes]) -> bool:
    return any(raw[at : at + 8] in others for at in range(3, len(raw) - 9))


def adu(frame: Frame) -> Adu:
    return Adu(
        start_ns=frame.start_ns,
        end_ns=frame.end_ns,
        transport=Transport.RTU,
        direction=frame.direction,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=frame.raw[0],
        pdu=frame.raw[1:-2],
        raw=frame.raw,
    )
