"""Finds out from a log if the recording that writes it is running well."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from mbtool.core import InputError
from mbtool.logs.rotation import parts_of
from mbtool.logs.status import LogStatus, read_status
from mbtool.ports.clock import now_ns
from mbtool.workflows.shared.heartbeat import HEARTBEAT_NS

LATE_NS = 2 * HEARTBEAT_NS
"""If the last heartbeat in the log is older than this (ns), something is wrong with the recording.
A heartbeat is a record that `sniff --service` writes every minute."""


class RecordingState(StrEnum):
    """The state of a recording; the values are texts for the user."""

    RECORDING = "recording"
    LATE = "no heartbeat"
    LOST = "a link is lost"
    ENDED = "ended in order"
    KILLED = "ended without closing the log: killed, the disk was full, or the power failed"
    OPEN = "not closed; this system does not tell if it is being written"


@dataclass(frozen=True, slots=True)
class RecordingStatus:
    """The status of a log, and the state of the recording that writes it, or wrote it."""

    path: Path
    state: RecordingState
    log: LogStatus
    now_ns: int

    @property
    def is_well(self) -> bool:
        return self.state in (RecordingState.RECORDING, RecordingState.ENDED)


def recording_of(path: str) -> RecordingStatus:
    """Return the status of the recording that writes the log at `path`. If the log is rotated, its
    last part is looked at.

    Raises InputError if there is neither a log nor a part of one with that name.
    """
    found = _newest(Path(path))
    log, at_ns = read_status(found), now_ns()
    return RecordingStatus(found, _state(log, at_ns), log, at_ns)


def _newest(path: Path) -> Path:
    if path.exists():
        return path
    parts = parts_of(path)
    if not parts:
        raise InputError(f"{path}: there is no such log, nor parts of it")
    return parts[-1]


def _state(log: LogStatus, at_ns: int) -> RecordingState:
    if log.is_closed:
        return RecordingState.ENDED
    if not log.is_held:
        return RecordingState.OPEN if log.is_held is None else RecordingState.KILLED
    if not log.heartbeat:
        return RecordingState.RECORDING
    if at_ns - _number(log.heartbeat, "ts_ns") > LATE_NS:
        return RecordingState.LATE
    return RecordingState.LOST if log.heartbeat.get("lost_links") else RecordingState.RECORDING


def _number(values: dict[str, str], key: str) -> int:
    text = values.get(key, "")
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 20 else 0


def heartbeat_numbers(log: LogStatus) -> dict[str, int]:
    """Return the counters in the last heartbeat of a log, by name. A value that is no number counts
    as 0.
    """
    return {key: _number(log.heartbeat, key) for key in log.heartbeat if key not in _TEXTS}


_TEXTS = frozenset({"state", "lost_links"})
