"""Stray bytes beside frames, on a line that hardly ever has any."""

from __future__ import annotations

from copy import deepcopy

import pytest

from mbtool.core import SerialFormat
from mbtool.modbus.adu import rtu_adu
from mbtool.serial_line import RtuSplitter
from tests.feeding import Line, feed_all
from tests.modbus.reading import adus

FORMAT = SerialFormat(19200, 8, "E", 1)
MS = 1_000_000
PAUSE_NS, LATENCY_NS = 30 * MS, 3 * MS

UNITS_LIKE_FUNCTIONS = (1, 2, 8, 11, 12, 17, 20, 21, 24)
"""Units whose numbers are function codes too: a byte before such a unit looks like a unit, and the
unit like its function."""


def exchanges(unit: int) -> list[tuple[bytes, bytes]]:
    """Requests of three functions with their responses."""
    pdus = (
        ("03 0064 0002", "03 04 0001 00E7"),
        ("04 0000 000A", "04 14" + bytes(range(20)).hex()),
        ("01 0010 0008", "01 01 5A"),
    )
    return [
        (rtu_adu(unit, bytes.fromhex(request)), rtu_adu(unit, bytes.fromhex(response)))
        for request, response in pdus
    ]


def heard_for_a_while(polls: list[tuple[bytes, bytes]]) -> tuple[RtuSplitter, int]:
    """A splitter that has heard a clean line, and when the last byte ended."""
    sent = Line(FORMAT)
    for _ in range(30):
        for request, response in polls:
            sent.frame(request, PAUSE_NS).frame(response, LATENCY_NS)
    splitter = RtuSplitter(FORMAT)
    for data, ts_ns in sent.reads():
        splitter.feed(data, ts_ns)
    return splitter, sent.now_ns


@pytest.mark.parametrize("is_known", [True, False], ids=["known request", "new request"])
@pytest.mark.parametrize("unit", UNITS_LIKE_FUNCTIONS)
def test_one_stray_byte_of_any_value_loses_no_frame(unit: int, is_known: bool) -> None:
    """A right CRC outweighs a damaged frame of a unit that was never heard."""
    polls = exchanges(unit)
    trained, now_ns = heard_for_a_while(polls)
    read = rtu_adu(unit, bytes.fromhex("03 0700 0002"))
    asked = polls[0] if is_known else (read, polls[0][1])
    expected = [*asked, *polls[1]]
    for value in range(256):
        stray = bytes([value])
        for place in range(2):
            sent = Line(FORMAT, now_ns)
            for number, (raw, gap_ns) in enumerate(
                zip(expected, (PAUSE_NS, LATENCY_NS) * 2, strict=True)
            ):
                sent.frame(stray + raw if number == place else raw, gap_ns)
            events = feed_all(deepcopy(trained), sent.reads())
            found = [adu.raw for adu in adus(events)][-4:]
            assert found == expected, f"{value:02X} before frame {place}"
            assert b"".join(event.raw for event in events).endswith(sent.data)
