"""Long runs of bytes that are no Modbus."""

from __future__ import annotations

import time
from random import Random

import pytest

from mbtool.core import Direction, SerialFormat
from mbtool.framing.rtu_lengths import has_frame
from mbtool.modbus.adu_bytes import rtu_adu
from mbtool.serial_line import RtuSplitter
from mbtool.serial_line.rtu import LONG_NOISE
from tests.feeding import Line, feed_all
from tests.modbus.reading import adus

FORMAT = SerialFormat(19200, 8, "E", 1)
ROLES = (Direction.REQUEST, Direction.RESPONSE)
READ = rtu_adu(1, bytes.fromhex("03 0000 000A"))
ANSWER = rtu_adu(1, b"\x03\x14" + bytes(range(20)))
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
