"""The reading loop, on a port made of a script."""

from __future__ import annotations

import os
from threading import Event
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError, SerialFormat
from mbtool.ports.line_errors import ErrorCounts
from mbtool.ports.serial_port import IDLE_S
from mbtool.ports.serial_records import RecordKind, RecordReader, RecordWriter, SerialRecord
from mbtool.sources.serial_reader import read_until

if TYPE_CHECKING:
    from collections.abc import Sequence

DAMAGED = 0xDA
LINE = SerialFormat(19200, 8, "N", 2)
"""Twice t3.5 is 4.01 ms."""


class ScriptedPort:
    """Gives what the script says, one piece for each read, and then tells the loop to end."""

    def __init__(self, script: list[bytes], told_to_end: Event) -> None:
        self._script = script
        self._told_to_end = told_to_end
        self.waits: list[float] = []
        self.damaged: Sequence[int] = ()
        self.overruns = 0

    def read(self, wait_s: float) -> bytes:
        self.waits.append(wait_s)
        if len(self._script) == 1:
            self._told_to_end.set()
        if not self._script:
            raise LinkError("unplugged")
        data = self._script.pop(0)
        self.damaged = [at for at, byte in enumerate(data) if byte == DAMAGED]
        return data

    def counts(self) -> ErrorCounts:
        counts = ErrorCounts(overrun=self.overruns)
        self.overruns += 2
        return counts

    def tune(self, format_: SerialFormat) -> None:
        raise NotImplementedError

    def close(self) -> None:
        pass


def run_loop(script: list[bytes]) -> tuple[list[SerialRecord], list[float]]:
    told_to_end = Event()
    port = ScriptedPort(script, told_to_end)
    reading, writing = os.pipe()
    try:
        writer = RecordWriter(writing)
        try:
            # The last piece is read after the loop was told to end.
            read_until(told_to_end, port, writer, LINE)
        except LinkError:
            writer.put(RecordKind.ERROR, 0)
        os.set_blocking(reading, False)
        return RecordReader().feed(os.read(reading, 2**16)), port.waits
    finally:
        os.close(reading)
        os.close(writing)


def test_every_read_is_a_record_of_its_own_with_a_time_that_does_not_go_back() -> None:
    records, _ = run_loop([b"\x01", b"\x03\x00", b"\x6b", b""])
    data = [record for record in records if record.kind is RecordKind.DATA]
    assert [record.data for record in data] == [b"\x01", b"\x03\x00", b"\x6b"]
    assert sorted(record.ts_ns for record in data) == [record.ts_ns for record in data]


def test_a_silence_is_told_only_after_a_look_that_waits_for_nothing() -> None:
    records, waits = run_loop([b"\x01", b"", b"", b"\x02", b""])
    kinds = [record.kind for record in records]
    assert kinds[:3] == [RecordKind.DATA, RecordKind.QUIET, RecordKind.DATA]
    # First the long wait, after data the short one, then the look, then the long wait again.
    assert waits[:4] == [IDLE_S, pytest.approx(0.00401, rel=0.01), 0, IDLE_S]


def test_a_byte_that_comes_while_looking_prevents_the_silence() -> None:
    records, _ = run_loop([b"\x01", b"", b"\x02", b""])
    assert [record.kind for record in records][:2] == [RecordKind.DATA, RecordKind.DATA]


def test_a_lost_port_ends_the_loop_after_what_came() -> None:
    told_never = Event()
    reading, writing = os.pipe()
    try:
        port = ScriptedPort([b"\x01", b"\x02"], Event())
        with pytest.raises(LinkError, match="unplugged"):
            read_until(told_never, port, RecordWriter(writing), LINE)
        records = RecordReader().feed(os.read(reading, 2**16))
        data = [record.data for record in records if record.kind is RecordKind.DATA]
        assert data == [b"\x01", b"\x02"]
    finally:
        os.close(reading)
        os.close(writing)


def test_damaged_bytes_are_told_behind_the_bytes_themselves() -> None:
    records, _ = run_loop([b"\x01\xda\x02", b""])
    assert [record.kind for record in records][:2] == [RecordKind.DATA, RecordKind.DAMAGE]
    assert records[0].data == b"\x01\xda\x02"
    assert records[1].data == b"parity or framing error at byte DAH"
    assert records[1].ts_ns == records[0].ts_ns - LINE.character_ns


def test_what_the_driver_lost_is_told_at_the_end_at_the_latest() -> None:
    records, _ = run_loop([b"\x01", b""])
    assert [
        (record.kind, record.lost) for record in records if record.kind is RecordKind.OVERRUN
    ] == [(RecordKind.OVERRUN, 2)]


def test_damage_on_a_port_that_goes_away_is_told() -> None:
    records, _ = run_loop([b"\xda", b"\xda"])
    told = [record.data for record in records if record.kind is RecordKind.DAMAGE]
    assert told[0] == b"parity or framing error at byte DAH"
    assert len(told) == 2


def test_a_process_that_was_stopped_tells_a_gap_before_the_bytes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    times = iter(range(0, 10**12, 3 * 10**9))  # Each look at the clock is 3 s after the last.
    monkeypatch.setattr("mbtool.sources.serial_reader.now_ns", lambda: next(times))
    records, _ = run_loop([b"\x01", b""])
    kinds = [record.kind for record in records if record.kind is not RecordKind.DAMAGE]
    assert kinds[:2] == [RecordKind.STOPPED, RecordKind.DATA]
    assert records[0].data == (b"nothing was read for 3.0 s: this program or machine was stopped")
