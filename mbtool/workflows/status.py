"""Finds the log that a recording writes, and says how the recording is doing."""

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
"""A recording whose last heartbeat is older than this, in ns, is not well."""


class RecordingState(StrEnum):
    """How a recording is doing."""

    RECORDING = "recording"
    LATE = "no heartbeat"
    LOST = "a link is lost"
    ENDED = "ended in order"
    KILLED = "ended without closing the log: killed, the disk was full, or the power failed"
    OPEN = "not closed; this system does not tell if it is being written"


@dataclass(frozen=True, slots=True)
class RecordingStatus:
    """A log and the state of its recording."""

    path: Path
    state: RecordingState
    log: LogStatus
    now_ns: int

    @property
    def is_well(self) -> bool:
        return self.state in (RecordingState.RECORDING, RecordingState.ENDED)


def recording_of(path: str) -> RecordingStatus:
    """The recording of a log; of a rotated one, that of its last part.

    Raises InputError if there is no log of that name, nor a part of it.
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
    """The counters of the last heartbeat; 0 for one that is no number."""
    return {key: _number(log.heartbeat, key) for key in log.heartbeat if key not in _TEXTS}


_TEXTS = frozenset({"state", "lost_links"})
