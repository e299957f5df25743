"""The order in which a log that was not decoded is decoded again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Chunk, EventKind, WireEvent
from mbtool.logs import LogReader, LogWriter
from mbtool.workflows.shared.undecoded_logs import evidence_and_events
from tests.logs.samples import START_NS

if TYPE_CHECKING:
    from pathlib import Path

MS = 1_000_000


def read(ms: int, link: str = "line") -> Chunk:
    return Chunk(ts_ns=START_NS + ms * MS, link=link, data=bytes([ms % 256]))


def back(ms: int, link: str = "line") -> WireEvent:
    return WireEvent(
        ts_ns=START_NS + ms * MS, link=link, kind=EventKind.GAP, message="is back after 5.6 s"
    )


def order(path: Path, *items: Chunk | WireEvent) -> list[tuple[str, int]]:
    with LogWriter(path, capture={}) as log:
        for item in items:
            log.write(item)
    with LogReader.open(path) as reader:
        return [
            (type(one).__name__, (one.ts_ns - START_NS) // MS)
            for one in evidence_and_events(reader)
        ]


def test_a_gap_that_was_written_late_stands_before_the_bytes_that_came_after_it(
    tmp_path: Path,
) -> None:
    found = order(tmp_path / "x.mcap", read(0), read(5000), read(5240), back(4980), read(6000))
    assert found == [
        ("Chunk", 0),
        ("WireEvent", 4980),
        ("Chunk", 5000),
        ("Chunk", 5240),
        ("Chunk", 6000),
    ]


def test_a_gap_leaves_the_bytes_of_other_links_in_their_order(tmp_path: Path) -> None:
    other = read(5000, "other")
    found = order(tmp_path / "x.mcap", read(0), other, back(4980), read(6000))
    assert found == [("Chunk", 0), ("Chunk", 5000), ("WireEvent", 4980), ("Chunk", 6000)]
