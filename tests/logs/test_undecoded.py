"""Which logs hold evidence that was not decoded when they were made."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.logs import LogReader, LogWriter, RotatingLog, Rotation
from mbtool.logs.messages import DecodingMark
from mbtool.logs.undecoded import ends_undecoded, undecoded_pieces
from tests.logs.samples import ONE_OF_EACH, chunk, stock_messages, transaction, write_log

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.logs.messages import LogItem


def mark(waiting: int, dropped: int = 0) -> DecodingMark:
    return DecodingMark(ts_ns=1, waiting=waiting, dropped=dropped)


@pytest.mark.parametrize(
    ("marks", "expected"),
    [
        ([], 0),
        ([mark(7)], 7),
        ([mark(7), mark(0)], 0),
        ([mark(7), mark(3, dropped=4), mark(0, dropped=1)], 5),
        ([mark(0), mark(2)], 2),
    ],
)
def test_the_last_mark_counts_and_everything_dropped(
    tmp_path: Path, marks: list[DecodingMark], expected: int
) -> None:
    path = write_log(tmp_path / "closed.mcap", (*ONE_OF_EACH, *marks))
    assert undecoded_pieces(path) == expected
    killed = tmp_path / "killed.mcap"
    log = LogWriter(killed, capture={})
    for item in (*ONE_OF_EACH, *marks):
        log.write(item)
    log.tick(0)
    log.tick(10**9)
    assert undecoded_pieces(killed) == expected
    log.close()


def _unclosed(path: Path, *items: LogItem) -> Path:
    """A log as it stands on the disk when its recorder is killed."""
    with LogWriter(path.with_name("open.mcap"), capture={}, replace=True) as log:
        for item in items:
            log.write(item)
        log.tick(0)
        log.tick(10**9)
        path.write_bytes(path.with_name("open.mcap").read_bytes())
    return path


def test_evidence_later_than_the_last_record_of_a_log_that_was_not_closed(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    row = transaction(1)
    assert row.response_ns is not None
    late = replace(chunk(), ts_ns=row.response_ns + 1)
    assert ends_undecoded(_unclosed(path, row, late))
    assert ends_undecoded(_unclosed(path, late, row))
    assert not ends_undecoded(_unclosed(path, replace(late, ts_ns=row.response_ns), row))
    assert not ends_undecoded(_unclosed(path, row))
    assert not ends_undecoded(_unclosed(path))
    assert not ends_undecoded(write_log(tmp_path / "closed.mcap", (row, late)))
    assert ends_undecoded(tmp_path / "absent.mcap") is None


def test_a_large_log_that_was_not_closed_is_not_looked_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _unclosed(tmp_path / "killed.mcap", chunk())
    assert ends_undecoded(path)
    monkeypatch.setattr("mbtool.logs.undecoded.MAX_LOOKED_THROUGH", path.stat().st_size - 1)
    assert ends_undecoded(path) is None


def test_marks_are_no_items_and_the_stock_reader_reads_them(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", (mark(5), *ONE_OF_EACH, mark(0)))
    with LogReader.open(path) as log:
        assert list(log.items()) == list(ONE_OF_EACH)
    topics = [topic for topic, _, _ in stock_messages(path)]
    assert topics.count("/decoding") == 2


def test_a_part_of_a_rotated_log_begins_as_the_part_before_ended(tmp_path: Path) -> None:
    with RotatingLog(tmp_path / "a.mcap", Rotation(size=1), capture={}) as log:
        for item in (chunk(), mark(9, dropped=2), mark(0), chunk()):
            log.write(item)
    counts = [undecoded_pieces(tmp_path / f"a-000{part}.mcap") for part in (1, 2, 3, 4)]
    assert counts == [0, 11, 0, 0]


def test_a_file_that_is_no_log_or_damaged_holds_nothing_undecoded(tmp_path: Path) -> None:
    assert undecoded_pieces(tmp_path / "absent") == 0
    path = write_log(tmp_path / "a.mcap", (*ONE_OF_EACH, mark(5)))
    data = path.read_bytes()
    for size in range(0, len(data), 97):
        path.write_bytes(data[:size])
        assert undecoded_pieces(path) in (0, 5)
