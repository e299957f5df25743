"""A disk that takes long to sync delays nothing; one that refuses is told."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest

from mbtool.core import OutputError
from mbtool.logs import FLUSH_AFTER_NS, LogWriter, complete_file
from tests.logs.samples import chunk, stock_messages
from tests.sources.live_helpers import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path


def test_a_log_grows_while_the_disk_syncs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def sync(_descriptor: int) -> None:
        begun.set()
        assert may_end.wait(PATIENCE_S)

    log = LogWriter(tmp_path / "a.mcap", capture={})
    monkeypatch.setattr(complete_file, "sync_data", sync)
    for number in range(1, 4):
        log.write(chunk())
        log.tick(2 * number * FLUSH_AFTER_NS)
        log.tick((2 * number + 1) * FLUSH_AFTER_NS)
        assert begun.wait(PATIENCE_S)
        assert len(stock_messages(tmp_path / "a.mcap")) == number
    may_end.set()
    log.close()


def test_everything_is_synced_also_when_nothing_comes_behind_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = LogWriter(tmp_path / "a.mcap", capture={})
    requests: list[int] = []
    monkeypatch.setattr(complete_file.DiskSync, "request", lambda _self: requests.append(log.size))
    for tenth in range(20):
        if tenth < 12:
            log.write(chunk())
        log.tick(tenth * FLUSH_AFTER_NS // 5)
    assert requests[-1] == log.size
    assert len(requests) <= 5
    log.close()


def test_a_disk_that_refuses_to_sync_ends_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sync(_descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    log = LogWriter(tmp_path / "a.mcap", capture={})
    monkeypatch.setattr(complete_file, "sync_data", sync)
    log.write(chunk())
    log.tick(0)
    log.tick(FLUSH_AFTER_NS)
    thread = log._file._disk._thread
    assert thread is not None
    thread.join(PATIENCE_S)
    log.write(chunk())
    with pytest.raises(OutputError, match="Input/output error"):
        log.tick(2 * FLUSH_AFTER_NS)
    with pytest.raises(OutputError, match="Input/output error"):
        log.close()
    assert len(stock_messages(tmp_path / "a.mcap")) >= 1
