"""A log of a sick serial line: one slave is well, one slow, one dead, one has bad CRCs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Quiet, SerialFormat, SerialLink
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.logs import LogWriter
from mbtool.modbus import rtu_adu
from tests.workflows.evidence import MS, START_NS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


LINE = SerialLink("/dev/rs485", SerialFormat())
WELL, SLOW, DEAD, BAD_CRC = 1, 2, 3, 4
SLOW_MS = 180
CYCLE_MS = 1000
SOUND_SHARE = 3
"""One in so many responses of BAD_CRC is damaged, from the middle of the recording on."""


def sick_line(path: Path, cycles: int = 60, name: str = LINE.name) -> Path:
    """Write the log; the master asks each slave once a cycle and waits 200 ms for an answer."""
    return _write(path, _evidence(cycles), name)


def asked_twice(path: Path, cycles: int = 30) -> Path:
    """Write a log in which the master asks DEAD once more at once in each cycle."""
    return _write(path, _asked_twice(cycles), LINE.name)


def _write(path: Path, evidence: Iterator[Chunk | Quiet], name: str) -> Path:
    decoder = Decoder(Namer(), lines={name: LINE})
    with LogWriter(
        path, capture={"version": "1", "host": "bench", "command": "mbtool sniff"}
    ) as log:
        log.add_link(name, {"spec": str(LINE)})
        for item in evidence:
            item = replace(item, link=name)
            if isinstance(item, Chunk):
                log.write(item)
            for record in decoder.feed(item):
                log.write(record)
        for record in decoder.close():
            log.write(record)
    return path


def _evidence(cycles: int) -> Iterator[Chunk | Quiet]:
    for cycle in range(cycles):
        at_ms = cycle * CYCLE_MS
        is_damaged = cycle >= cycles // 2 and cycle % SOUND_SHARE == 0
        yield from _poll(at_ms, WELL, 8, cycle)
        yield from _poll(at_ms + 100, SLOW, SLOW_MS, cycle)
        yield from _poll(at_ms + 400, DEAD, None, cycle)
        yield from _poll(at_ms + 700, BAD_CRC, 9, cycle, is_damaged=is_damaged)


def _asked_twice(cycles: int) -> Iterator[Chunk | Quiet]:
    for cycle in range(cycles):
        at_ms = cycle * CYCLE_MS
        yield from _poll(at_ms, WELL, 8, cycle)
        yield from _poll(at_ms + 100, DEAD, None, cycle)
        yield from _poll(at_ms + 400, DEAD, None, cycle)


def _poll(
    at_ms: float, unit: int, late_ms: float | None, value: int, *, is_damaged: bool = False
) -> Iterator[Chunk | Quiet]:
    request = rtu_adu(unit, bytes.fromhex("03 0000 0002"))
    yield _heard(at_ms, request)
    if late_ms is not None:
        data = bytes.fromhex("03 04 0102") + value.to_bytes(2, "big")
        response = bytearray(rtu_adu(unit, data))
        if is_damaged:
            response[5] ^= 0x10
        yield _heard(at_ms + late_ms + len(response) * 11 / 19.2, bytes(response))
    yield Quiet(START_NS + round((at_ms + 250) * MS), LINE.name)


def _heard(at_ms: float, data: bytes) -> Chunk:
    return Chunk(ts_ns=START_NS + round(at_ms * MS), link=LINE.name, data=data)
