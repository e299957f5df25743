"""The size of logs, and the memory for decoding them, on a few minutes of a polled line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mbtool.logs import LogReader
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.benchmarks.log_size import polling, write_line


@pytest.mark.parametrize("size", [1, 8, 64])
def test_evidence_takes_at_most_three_times_the_bytes_of_ten_polls_a_second(
    tmp_path: Path, size: int
) -> None:
    path = tmp_path / "x.mcap"
    log = write_line(path, 10, 300, size, decoded=False)
    assert log.ratio < 3
    with LogReader.open(path) as reader:
        assert list(reader.evidence()) == list(polling(10, 300, size))
    records = list(Reading([str(path)], ReadingOptions()).records())
    assert len(records) == 300
    whole = write_line(tmp_path / "whole.mcap", 10, 300, size, decoded=True)
    assert whole.size > log.size
    again = Reading([str(tmp_path / "whole.mcap")], ReadingOptions())
    assert [repr(one).replace("whole", "x") for one in again.records()] == list(map(repr, records))


_TRACED = """
import sys, tracemalloc
from mbtool.workflows.shared.reading import Reading, ReadingOptions
for path in sys.argv[1:]:
    tracemalloc.start()
    sum(1 for _ in Reading([path], ReadingOptions(raw=True)).records())
    print(tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
"""


def test_decoding_a_longer_log_takes_no_more_memory(tmp_path: Path) -> None:
    """Measured in a process of its own: threads of other tests would be measured as well."""
    paths = []
    for number, polls in enumerate((200, 200, 400, 1200)):
        paths.append(str(tmp_path / f"{number}.mcap"))
        write_line(Path(paths[-1]), 10, polls, 8, decoded=False)
    told = subprocess.run(
        [sys.executable, "-c", _TRACED, *paths], check=True, capture_output=True, text=True
    )
    _, *peaks = map(int, told.stdout.split())  # the first log also costs what is imported
    assert peaks[2] < 1.3 * max(peaks[:2])
