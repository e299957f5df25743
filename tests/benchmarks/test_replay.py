from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest

from tests.benchmarks.replay import WAYS, Row, measure, recording, report

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need Linux or macOS")
@pytest.mark.parametrize("way", WAYS)
def test_all_of_a_recording_is_played(way: str, tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(recording(50, 500))
    row = measure(way, path, 50, busy=False)
    assert (row.way, row.sent) == (way, row.asked)
    assert row.sent == (100 if way == "as-bus" else 50)
    assert row.late_p99_us >= 0


def test_a_row_says_how_late() -> None:
    told = report([Row("as-bus", True, 10, 9, 123.4)]).splitlines()
    assert [line.split() for line in told] == [
        ["way", "machine", "asked", "sent", "late", "p99", "us"],
        ["as-bus", "busy", "10", "9", "123"],
    ]
