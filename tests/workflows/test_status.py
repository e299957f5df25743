"""How a recording is doing, as its log tells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, InputError, WireEvent
from mbtool.logs import LogWriter, RotatingLog, Rotation
from mbtool.logs.status import read_status
from mbtool.workflows.shared.heartbeat import HEARTBEAT_NS, HeartbeatLog
from mbtool.workflows.status import RecordingState, heartbeat_numbers, recording_of
from tests.logs.samples import START_NS, chunk, transaction
from tests.logs.test_reader import small_log

if TYPE_CHECKING:
    from pathlib import Path

SECOND_NS = 1_000_000_000
MINUTE_NS = 60 * SECOND_NS
MINUTE = Rotation(time_ns=MINUTE_NS)


def heartbeat_log(path: Path, lost: list[str], now_ns: int = START_NS) -> HeartbeatLog:
    return HeartbeatLog(LogWriter(path, capture={"host": "plant"}), lambda: list(lost), now_ns)


def test_a_heartbeat_counts_what_was_heard_and_what_was_lost(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    log = heartbeat_log(path, [])
    log.write(chunk(0))
    log.write(transaction())
    lost = WireEvent(
        ts_ns=START_NS, link="rs485", kind=EventKind.DISCARDED, message="too late", missing=40
    )
    log.write(lost)
    log.tick(START_NS)
    log.tick(START_NS + SECOND_NS - 1)
    status = read_status(path)
    numbers = heartbeat_numbers(status)
    assert status.heartbeat["state"] == "recording"
    assert numbers["ts_ns"] == START_NS
    assert numbers["bytes"] == len(chunk(0).data)
    assert (numbers["transactions.ok"], numbers["lost_bytes"]) == (1, 40)
    log.tick(START_NS + HEARTBEAT_NS)
    log.tick(START_NS + HEARTBEAT_NS + SECOND_NS)
    assert heartbeat_numbers(read_status(path))["ts_ns"] == START_NS + HEARTBEAT_NS
    log.close({})
    assert read_status(path).heartbeat["state"] == "ended"


def test_a_recording_that_has_just_begun_has_a_heartbeat_soon(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    log = heartbeat_log(path, [])
    told = set()
    for second in range(200):
        log.write(chunk(second))
        log.tick(START_NS + second * SECOND_NS)
        told.add(heartbeat_numbers(read_status(path))["ts_ns"])
    log.close({})
    assert sorted((each - START_NS) // SECOND_NS for each in told) == [
        0, 1, 3, 7, 15, 31, 63, 123, 183,
    ]  # fmt: skip


def test_a_link_that_is_lost_is_told_at_once_and_so_is_its_return(tmp_path: Path) -> None:
    path, lost = tmp_path / "x.mcap", ["ttyUSB0"]
    log = heartbeat_log(path, lost)
    log.tick(START_NS)
    log.tick(START_NS + SECOND_NS)
    assert read_status(path).heartbeat["lost_links"] == "ttyUSB0"
    lost.clear()
    log.tick(START_NS + 2 * SECOND_NS)
    log.tick(START_NS + 3 * SECOND_NS)
    assert read_status(path).heartbeat["lost_links"] == ""
    log.close({})


def test_a_running_recording_is_told_from_one_that_was_killed(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    log = LogWriter(path, capture={"host": "plant"})
    assert recording_of(str(path)).state is RecordingState.RECORDING
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(path.read_bytes())
    assert recording_of(str(copy)).state is RecordingState.KILLED
    log.close()
    assert recording_of(str(path)).state is RecordingState.ENDED


def test_an_old_heartbeat_and_a_lost_link_are_not_well(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    log = heartbeat_log(path, ["ttyUSB0"])
    log.tick(START_NS)
    log.tick(START_NS + SECOND_NS)
    assert recording_of(str(path)).state is RecordingState.LATE
    soon_ns = recording_of(str(path)).now_ns + HEARTBEAT_NS
    log.tick(soon_ns)
    log.tick(soon_ns + SECOND_NS)
    assert recording_of(str(path)).state is RecordingState.LOST
    assert not recording_of(str(path)).is_well
    log.close({})


def test_of_a_log_in_parts_the_last_is_read_and_begins_with_the_last_heartbeat(
    tmp_path: Path,
) -> None:
    rotating = RotatingLog(tmp_path / "x.mcap", MINUTE, capture={"host": "plant"})
    log = HeartbeatLog(rotating, list, START_NS)
    log.tick(START_NS)
    log.write(chunk(0))
    log.tick(START_NS + MINUTE_NS)
    log.tick(START_NS + MINUTE_NS + SECOND_NS)
    last = recording_of(str(tmp_path / "x.mcap"))
    assert last.path.name == "x-0002.mcap"
    assert heartbeat_numbers(last.log)["bytes"] == len(chunk(0).data)
    log.close({})


def test_a_log_that_continues_begins_behind_the_parts_that_exist(tmp_path: Path) -> None:
    for number in (1, 2):
        path = tmp_path / "x.mcap"
        with RotatingLog(path, MINUTE, capture={}, continues=True) as log:
            assert log.path.name == f"x-000{number}.mcap"


def test_what_is_no_log_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with pytest.raises(InputError, match="no such log"):
        recording_of(str(path))
    path.write_bytes(b"\x89PNG")
    with pytest.raises(InputError, match="not an MCAP file"):
        recording_of(str(path))
    with pytest.raises(InputError, match="not a regular file"):
        recording_of(str(tmp_path))


def test_a_log_cut_or_damaged_at_any_byte_raises_nothing_else(tmp_path: Path) -> None:
    path, whole = tmp_path / "x.mcap", small_log()
    for at in range(0, len(whole), 7):
        for data in (whole[:at], whole[:at] + b"\xff" + whole[at + 1 :]):
            path.write_bytes(data)
            try:
                recording_of(str(path))
            except InputError:
                continue
