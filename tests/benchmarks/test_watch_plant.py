from __future__ import annotations

import os

from tests.benchmarks.watch_plant import PlantWatch, peak_memory, processor_s, told

SEEN = PlantWatch(
    asked=60_000, answered=60_000, shown=60_000, logged=60_000,
    seconds=60, processor_s=15, memory=80_000_000,
)  # fmt: skip


def test_the_line_says_if_all_counts_agree() -> None:
    assert told(SEEN).startswith("60,000 asked, 60,000 answered, 60,000 shown, 60,000 in the log (")
    assert "(equal); 1,000/s for 60 s; processor 25% of one core, memory 80 MB" in told(SEEN)
    for field in ("asked", "answered", "shown", "logged"):
        assert "(NOT equal)" in told(SEEN._replace(**{field: 59_999}))


def test_processor_time_and_memory_are_those_of_a_process() -> None:
    assert processor_s(os.getpid()) > 0
    assert peak_memory(os.getpid()) > 1_000_000
