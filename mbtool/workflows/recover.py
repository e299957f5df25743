"""Copies the undamaged parts of a damaged log to a new log."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from mbtool.core import InputError, UsageError
from mbtool.core.errors import reason_of
from mbtool.core.moments import clock_time, day
from mbtool.core.replacing import replacing
from mbtool.logs.creating import demand_unlocked
from mbtool.logs.opening import check_log_path
from mbtool.logs.recovery import LogLoss, Recovered, Recovery
from mbtool.sources.files import STANDARD_INPUT, CaptureFile, CaptureKind, open_capture

_SIGN = b"mbtool.capture"
"""The name of the metadata record at the beginning of each log. A file that contains this name in
its first 64 KiB is taken as a log, even if its very first bytes are damaged."""
_SIGN_WITHIN = 64 * 1024


def recover(
    broken: str, good: str, report: Callable[[LogLoss], None], *, replace: bool = False
) -> Recovered:
    """Copy the undamaged parts of the log `broken` to the new log `good`.

    `report` is called for each lost part. With `replace`, an existing file `good` is replaced.
    Raises UsageError if `good` cannot be created, InputError if `broken` is no log or cannot be
    read, OutputError if writing fails.
    """
    check_log_path(good, overwrite=replace)
    with suppress(OSError, ValueError):
        if os.path.samefile(0 if broken == "-" else broken, good):
            raise UsageError(f"{good}: the damaged log itself; give the new one another name")
    with _open_log(broken) as capture:
        if capture.kind is not CaptureKind.MCAP:
            raise InputError(f"{capture.name}: a capture, not a log (.mcap)")
        recovery = Recovery(capture.stream, capture.name, report)
        if not Path(good).exists():
            return recovery.run(Path(good))
        demand_unlocked(Path(good))
        with replacing(good) as beside:
            return recovery.run(beside, replace=True)


def loss_text(loss: LogLoss) -> str:
    """Describe a lost part of a log in one line: its bytes in the file, its times, and the
    damage.
    """
    size = loss.end - loss.offset
    return f"lost: bytes {loss.offset} to {loss.end} ({size:,} bytes), {_times(loss)}: {loss.what}"


def _times(loss: LogLoss) -> str:
    begin = "" if loss.begin_ns is None else _time(loss.begin_ns)
    end = "" if loss.end_ns is None else _time(loss.end_ns)
    if begin and end:
        return f"{begin} to {end} UTC"
    if begin:
        return f"from {begin} UTC on"
    return f"up to {end} UTC" if end else "of unknown time"


def _time(ts_ns: int) -> str:
    return f"{day(ts_ns)} {clock_time(ts_ns)}"


def _open_log(path: str) -> CaptureFile:
    """Open the log at `path`, even if its first bytes are damaged so that its kind is not
    recognised.
    """
    try:
        return open_capture(path)
    except InputError:
        if path == STANDARD_INPUT or not _has_sign(path):
            raise
    try:
        file = open(path, "rb")  # noqa: SIM115 - the capture closes it
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason_of(error)}") from error
    return CaptureFile(path, CaptureKind.MCAP, file, file)


def _has_sign(path: str) -> bool:
    with suppress(OSError, ValueError), open(path, "rb") as file:
        return _SIGN in file.read(_SIGN_WITHIN)
    return False
