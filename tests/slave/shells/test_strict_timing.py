"""The requests that a slave with strict timing answers."""

from __future__ import annotations

import pytest

from mbtool.core import SerialFormat
from mbtool.modbus import rtu_adu
from mbtool.modbus.adu import Adu
from mbtool.serial_line.rtu import RtuSplitter
from mbtool.slave.shells.serial_shell import StrictTiming

LINE = SerialFormat(9600)
MS = 1_000_000
REQUEST = rtu_adu(5, bytes.fromhex("03 0000 0001"))


def answered(*reads: tuple[float, bytes]) -> list[bytes]:
    """The requests that get an answer; each read is the silence before it (ms), and its bytes."""
    splitter, strict = RtuSplitter(LINE), StrictTiming(LINE)
    now_ns, taken = 0, list[bytes]()
    for silence_ms, data in (*reads, (1000.0, b"")):
        begin_ns = now_ns + round(silence_ms * MS)
        events = splitter.advance(begin_ns)
        now_ns = begin_ns + len(data) * LINE.character_ns
        due = strict.due(begin_ns)
        if data:
            strict.hear(len(data), now_ns)
            events += splitter.feed(data, now_ns)
        for event in events:
            if isinstance(event, Adu):
                strict.hold(event)
        taken += [] if due is None else [due.raw]
        due = strict.due(now_ns)
        taken += [] if due is None else [due.raw]
    return taken


def test_a_request_between_two_silences_is_answered() -> None:
    assert answered((10, REQUEST)) == [REQUEST]
    assert answered((10, REQUEST), (4.1, REQUEST)) == [REQUEST, REQUEST]


@pytest.mark.parametrize("pause_ms", [5, 50, 200])
def test_a_request_with_a_silence_of_t3_5_inside_is_not_answered(pause_ms: float) -> None:
    assert answered((10, REQUEST[:4]), (pause_ms, REQUEST[4:])) == []
    again = answered((10, REQUEST[:4]), (pause_ms, REQUEST[4:]), (50, REQUEST))
    assert again == [REQUEST]


def test_a_late_read_inside_a_request_is_tolerated() -> None:
    assert answered((10, REQUEST[:4]), (3.0, REQUEST[4:])) == [REQUEST]


@pytest.mark.parametrize("pause_ms", [0.0, 1.0, 3.9])
def test_two_requests_without_a_silence_between_them_get_no_answer(pause_ms: float) -> None:
    assert answered((10, REQUEST), (pause_ms, REQUEST)) == []
    assert answered((10, REQUEST + REQUEST)) == []


def test_noise_just_before_a_request_makes_it_unreadable() -> None:
    assert answered((10, b"\x00\x55"), (1.0, REQUEST)) == []
