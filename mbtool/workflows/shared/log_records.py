"""Reads the transactions and events that are stored in a log, without decoding them again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Chunk, LineSettings, Packet, UsageError, WireEvent
from mbtool.devices import Assignments, Namer, Profile, profile_from_json
from mbtool.logs import LogReader, follow
from mbtool.sources.files import STANDARD_INPUT, CaptureKind, open_capture, place_of

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record


def log_records(
    items: Iterable[Record | Chunk | Packet], assignments: Assignments, file: str
) -> Iterator[Record]:
    """Yield the transactions and events among the items of a log; leave out packets and chunks.

    If the device of a transaction has a profile in `assignments`, the transaction gets names and
    values from that profile. `file` is the path of the log as the user wrote it.
    """
    namer = Namer(assignments)
    for item in items:
        if isinstance(item, WireEvent):
            yield item
        elif not isinstance(item, Chunk | Packet):
            yield replace(namer.rename(item), file=file)


def followed(path: str, assignments: Assignments, wait: Callable[[], bool]) -> Iterator[Record]:
    """Yield the transactions and events of a log that is still being written, as they are added.

    `wait` is called each time the end of the file is reached; it returns True to read on, False to
    end. Raises UsageError if the path is standard input, or is not an uncompressed log with
    transactions. Raises InputError if the log cannot be read.
    """
    if path == STANDARD_INPUT:
        raise UsageError("--follow reads a log on disk, not standard input; name the log")
    with open_capture(path) as capture:
        if capture.kind is not CaptureKind.MCAP or not capture.stream.seekable():
            raise UsageError(f"{path}: not a log (.mcap); only a plain one can be followed")
        if LogReader(capture.stream, capture.name).is_evidence_only:
            raise UsageError(
                f"{path}: a log of evidence only holds nothing decoded to follow; "
                "decode it without --follow"
            )
    yield from log_records(follow(path, wait), assignments, path)


def profiles_of_logs(paths: Sequence[str], line: LineSettings | None) -> list[Profile]:
    """Return the device profiles that are stored in the logs among the files.

    Pipes are not opened. `line` is needed to open files of serial bytes: the line settings that the
    user gave, None for none. Raises InputError if a file cannot be read.
    """
    profiles = []
    for path in paths:
        if place_of(path)[1]:
            continue
        with open_capture(path, line) as capture:
            if capture.kind is CaptureKind.MCAP:
                log = LogReader(capture.stream, capture.name)
                profiles += [
                    profile_from_json(data, f"profile {name}")
                    for name, data in log.profiles.items()
                ]
    return profiles
