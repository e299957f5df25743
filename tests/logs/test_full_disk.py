"""Logs on a disk that fills up: a real file system of 64 KiB, which only root can make."""

from __future__ import annotations

import random
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, OutputError
from mbtool.logs import LogWriter, RotatingLog, Rotation, read_log
from tests.logs.samples import START_NS, stock_messages

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

DISK_SIZE = 64 * 1024


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """The folder of a small disk."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_SIZE}", "mbtool-test", str(folder)]
    if sys.platform != "linux" or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("cannot make a file system: not root, or not Linux")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def reads() -> Iterator[Chunk]:
    """Reads that cannot be packed."""
    chance = random.Random(1)
    number = 0
    while True:
        yield Chunk(ts_ns=START_NS + number * 10_000, link="rs485", data=chance.randbytes(1000))
        number += 1


def test_with_a_limit_of_files_a_full_disk_costs_the_oldest(disk: Path) -> None:
    told: list[str] = []
    log = RotatingLog(
        disk / "x.mcap", Rotation(size=10_000), capture={}, keep=50, on_full=told.append
    )
    some = reads()
    written = [next(some) for _ in range(300)]
    for number, read in enumerate(written):
        log.write(read)
        log.tick(number * 10**9)
    log.close()
    kept = sorted(disk.iterdir())
    assert 1 < len(kept) < 8
    assert sum(path.stat().st_size for path in kept) <= DISK_SIZE
    assert told[0] == (
        f"the disk is full; {disk / 'x-0001.mcap'}, the oldest file of this log, was removed"
    )
    found = [item for path in kept for item in read_log(path)]
    assert found == written[-len(found) :]
    assert all(len(stock_messages(path)) for path in kept[:-1])


@pytest.mark.parametrize("is_rotated", [False, True])
def test_without_a_limit_a_full_disk_ends_the_recording(disk: Path, is_rotated: bool) -> None:
    log: LogWriter | RotatingLog
    if is_rotated:
        log = RotatingLog(disk / "x.mcap", Rotation(size=10_000), capture={})
    else:
        log = LogWriter(disk / "x.mcap", capture={})
    written: list[Chunk] = []

    def fill() -> None:
        for number, read in enumerate(reads()):
            written.append(read)
            log.write(read)
            log.tick(number * 10**9)

    with pytest.raises(OutputError, match="No space left on device"):
        fill()
    with pytest.raises(OutputError, match="No space left on device"):
        log.close()
    found = [item for path in sorted(disk.iterdir()) for item in read_log(path)]
    assert found == written[: len(found)]
    assert len(found) > 40
    assert all(path.stat().st_size for path in disk.iterdir())


def test_where_there_is_no_room_at_all_no_file_is_left(disk: Path) -> None:
    (disk / "full").write_bytes(bytes(DISK_SIZE - 4096))
    with (disk / "more").open("wb", buffering=0) as file:
        file.write(bytes(4096))
    with pytest.raises(OutputError, match=r"cannot be begun: No space left on device"):
        RotatingLog(disk / "x.mcap", Rotation(size=10_000), capture={}, keep=2)
    assert sorted(path.name for path in disk.iterdir()) == ["full", "more"]
