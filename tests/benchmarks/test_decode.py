from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from tests.benchmarks.decode import measure, report

if TYPE_CHECKING:
    from types import FrameType


def test_every_stage_gives_all_transactions() -> None:
    given = {one.stage: one.gives for one in measure(50, rounds=1)}
    packets_of_a_handshake_and_a_goodbye, heading_and_day = 6, 2
    assert given == {
        "read": 100 + packets_of_a_handshake_and_a_goodbye,
        "reassemble": 100,
        "decode": 50,
        "name": 50,
        "jsonl": 50,
        "table": 50 + heading_and_day,
        "log": 50,
        "anew": 50,
    }


def test_the_report_has_a_line_for_each_stage() -> None:
    lines = report(measure(10, rounds=1)).splitlines()
    assert [line.split()[0] for line in lines] == [
        "stage",
        "read",
        "reassemble",
        "decode",
        "name",
        "jsonl",
        "table",
        "log",
        "anew",
        "file",
        "naming",
        "naming",
    ]


def test_work_grows_no_faster_than_the_capture() -> None:
    few, many = _calls(100), _calls(1000)
    assert many < 11 * few


def _calls(transactions: int) -> int:
    """How many functions are called, which no other program's load changes."""
    count = 0

    def on_call(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(on_call)
    try:
        measure(transactions, rounds=1)
    finally:
        sys.setprofile(before)
    return count
