"""The records of a log, decoded when the log was made, with names from today's profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Chunk, Packet, UsageError, WireEvent
from mbtool.devices import Namer
from mbtool.logs import follow
from mbtool.sources.files import STANDARD_INPUT, CaptureKind, open_capture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mbtool.decode.decoder import Record
    from mbtool.devices import Assignments


def log_records(
    items: Iterable[Record | Chunk | Packet], assignments: Assignments, file: str
) -> Iterator[Record]:
    """The transactions and events among a log's items; `file` is the log, as the user named it.

    A transaction is named again if the user has assigned a profile to its device.
    """
    namer = Namer(assignments)
    for item in items:
        if isinstance(item, WireEvent):
            yield item
        elif not isinstance(item, Chunk | Packet):
            yield replace(namer.rename(item), file=file)


def followed(path: str, assignments: Assignments, wait: Callable[[], bool]) -> Iterator[Record]:
    """Yield the records of a log that is still being written, as they are added.

    `wait` is called at the end of the file; it returns True to read on, False to end.
    Raises UsageError if the path is standard input or not a plain log, InputError if it cannot be
    read.
    """
    if path == STANDARD_INPUT:
        raise UsageError("--follow reads a log on disk, not standard input; name the log")
    with open_capture(path) as capture:
        if capture.kind is not CaptureKind.MCAP or not capture.stream.seekable():
            raise UsageError(f"{path}: not a log (.mcap); only a plain one can be followed")
    yield from log_records(follow(path, wait), assignments, path)
