"""Plays a recording's slaves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import InputError
from mbtool.replay import OnMiss, RecordedSlave, Recording
from mbtool.slave import open_shell
from mbtool.workflows.recorded import read_recorded

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import CutError, DamageError, LinkSpec
    from mbtool.devices import NamedTransaction
    from mbtool.slave import Shell
    from mbtool.workflows.reading import ReadingOptions


def read_recording(
    path: str,
    options: ReadingOptions,
    wanted: Callable[[NamedTransaction], bool],
    on_cut: Callable[[CutError | DamageError], None],
    on_remark: Callable[[str], None] = lambda _: None,
) -> Recording:
    """The transactions of a capture or a log, ready to be played.

    Of a file that is cut or damaged what is there is played, and `on_cut` is told; `on_remark`
    is told what else there is to know of it. Raises InputError, UsageError.
    """
    transactions, _ = read_recorded(path, options, wanted, on_cut, on_remark)
    recording = Recording.of(transactions)
    if not recording.answers:
        raise InputError(f"{path}: no request to play an answer for; see what it holds with decode")
    return recording


def recorded_slave(
    recording: Recording,
    link: LinkSpec,
    *,
    on_miss: OnMiss,
    speed: float | None,
    allow_remote: bool,
) -> Shell:
    """The recording's slaves on a link, not yet started. Raises UsageError."""
    responder = RecordedSlave(recording, on_miss=on_miss, speed=speed)
    return open_shell(link, responder, allow_remote=allow_remote)
