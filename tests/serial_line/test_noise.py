"""Long runs of bytes that are no Modbus."""

from __future__ import annotations

import time
from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, SerialFormat
from mbtool.framing.rtu_lengths import has_frame
from mbtool.modbus.adu import rtu_adu
from mbtool.serial_line import RtuSplitter
from mbtool.serial_line.rtu import LONG_NOISE
from tests.feeding import Line, feed_all
from tests.modbus.reading import adus

if TYPE_CHECKING:
    from mbtool.modbus.adu import Adu, Skipped

FORMAT = SerialFormat(19200, 8, "E", 1)
ROLES = (Direction.REQUEST, Direction.RESPONSE)
READ = rtu_adu(1, bytes.fromhex("03 0000 000A"))
ANSWER = rtu_adu(1, b"\x03\x14" + bytes(range(20)))
UNKNOWN = rtu_adu(1, bytes.fromhex("66 1234 5678 9A"))
MS = 1_000_000
SIZE = 16 * LONG_NOISE
NOISE = {
    "zeros": bytes(SIZE),
    "ones": b"\xff" * SIZE,
    "random": Random(1).randbytes(SIZE),
    "text": (b"2026-01-01 12:00:00 pump 3 started\n" * SIZE)[:SIZE],
}


def processor_s(data: bytes) -> float:
    splitter, sent = RtuSplitter(FORMAT, timed=False), Line(FORMAT).send(data)
    begin = time.process_time()
    feed_all(splitter, sent.reads())
    return time.process_time() - begin


@pytest.mark.parametrize("name", NOISE)
def test_noise_takes_at_most_ten_times_as_long_as_polling(name: str) -> None:
    polling = (READ + ANSWER) * (SIZE // len(READ + ANSWER))
    assert processor_s(NOISE[name]) < 10 * max(processor_s(polling) for _ in range(3))


def bursts_of_noise(chance: Random) -> list[bytes]:
    """Bursts of random bytes, as a line sounds that is heard with the wrong rate."""
    return [chance.randbytes(chance.randrange(20, 60)) for _ in range(SIZE // 40)]


def heard_in_bursts(splitter: RtuSplitter, bursts: list[bytes]) -> list[Adu | Skipped]:
    """What comes out if 5 ms of silence precede each burst."""
    line = Line(FORMAT)
    for burst in bursts:
        line.frame(burst, 5 * MS)
    return feed_all(splitter, line.reads())


def test_noise_in_bursts_takes_at_most_fifteen_times_as_long_as_polling() -> None:
    polling = [READ, ANSWER] * (SIZE // len(READ + ANSWER))

    def processor_of_bursts_s(bursts: list[bytes]) -> float:
        begin = time.process_time()
        heard_in_bursts(RtuSplitter(FORMAT), bursts)
        return time.process_time() - begin

    noise_s = min(processor_of_bursts_s(bursts_of_noise(Random(1))) for _ in range(2))
    assert noise_s < 15 * max(processor_of_bursts_s(polling) for _ in range(3))


@pytest.mark.parametrize("seed", range(5))
def test_frame_between_two_silences_is_found_behind_much_noise(seed: int) -> None:
    noise = bursts_of_noise(Random(seed))
    events = heard_in_bursts(RtuSplitter(FORMAT), [*noise, READ, *noise])
    assert b"".join(event.raw for event in events) == b"".join([*noise, READ, *noise])
    assert READ in [adu.raw for adu in adus(events)]


def test_frames_of_an_unknown_function_between_silences_are_found_behind_much_noise() -> None:
    noise = bursts_of_noise(Random(1))
    events = heard_in_bursts(RtuSplitter(FORMAT), [*noise, *[UNKNOWN] * 10])
    assert UNKNOWN in [adu.raw for adu in adus(events)]


@pytest.mark.parametrize("name", NOISE)
def test_frames_behind_noise_are_found_and_no_byte_is_lost(name: str) -> None:
    for cut in (0, 1, 100, 255):
        data = NOISE[name][cut:] + (READ + ANSWER) * 20
        events = feed_all(RtuSplitter(FORMAT, timed=False), Line(FORMAT).send(data).reads())
        assert b"".join(event.raw for event in events) == data
        assert [adu.raw for adu in adus(events)][-38:] == [READ, ANSWER] * 19


def test_frame_is_seen_anywhere_in_noise() -> None:
    noise = b"\x55" * 300
    assert not has_frame(noise, ROLES)
    for at in (0, 1, 150, 300):
        assert has_frame(noise[:at] + READ + noise[at:], ROLES)
        assert has_frame(noise[:at] + ANSWER + noise[at:], ROLES)
    assert not has_frame(ANSWER[:-1], ROLES)
    identification = rtu_adu(5, bytes.fromhex("2B 0E 01 02 00 00 01 00 03 61 62 63"))
    assert has_frame(noise + identification, (Direction.RESPONSE,))
