from __future__ import annotations

import sys

import pytest

from mbtool.core import Chunk, SerialFormat
from tests.benchmarks.serial_times import WAYS, compare, measure, report

LINE = SerialFormat(115200, 8, "N", 1)
CHARACTER_NS = LINE.character_ns


def heard(data: bytes, ts_ns: int) -> Chunk:
    return Chunk(ts_ns=ts_ns, link="line", data=data)


def test_a_frame_that_is_read_in_pieces_began_a_character_before_its_first_byte() -> None:
    notes = [(0, b"\x01\x02\x03"), (10**6, b"\x04")]
    chunks = [heard(b"\x01\x02", 2 * CHARACTER_NS), heard(b"\x03", 3 * CHARACTER_NS)]
    row = compare("terminal", notes, [*chunks, heard(b"\x04", 10**6 + 90_000)], LINE, busy=False)
    assert (row.frames, row.sent, row.lost) == (2, 4, 0)
    assert row.errors_ns == [0, 90_000 - CHARACTER_NS]


def test_what_is_missing_or_wrong_counts_as_lost() -> None:
    notes = [(0, b"\x01\x02\x03")]
    assert compare("line", notes, [heard(b"\x01\x03", 0)], LINE, busy=False).lost == 2
    assert compare("line", notes, [], LINE, busy=False).lost == 3


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need Linux or macOS")
@pytest.mark.parametrize("way", WAYS)
def test_no_byte_is_lost_while_every_core_is_busy(way: str) -> None:
    row = measure(way, LINE, 0.5, busy=True)
    assert row.frames
    assert row.lost == 0
    assert len(row.errors_ns) == row.frames
    assert report([row]).splitlines()[1].split()[:2] == [way, "busy"]
