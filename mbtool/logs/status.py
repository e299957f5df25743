"""Reads the state of a recording from its log, also while the log is being written."""

# Only the heads of records are read, and metadata records in full, so a log of a gigabyte takes a
# moment. Reading ends at the first record that reaches beyond the file; damaged metadata is
# skipped.

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Metadata

from mbtool.core import InputError
from mbtool.core.errors import reason_of
from mbtool.logs import layout
from mbtool.logs.layout import MAGIC, MAX_RECORD, RECORD_HEAD, Opcode

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(slots=True)
class LogStatus:
    """The state of a recording, as its log shows it."""

    size: int
    """The size of the file in bytes."""
    is_held: bool | None
    """True if a recorder has the log open; None if the system cannot tell."""
    capture: dict[str, str] = field(default_factory=dict)
    links: dict[str, str] = field(default_factory=dict)
    """The LINK of each link as text, by the link's name."""
    heartbeat: dict[str, str] = field(default_factory=dict)
    """The values of the last heartbeat that `sniff --service` wrote; empty if there is none."""
    is_closed: bool = False
    """True if the log has a summary, which it gets when it is closed."""


def read_status(path: Path) -> LogStatus:
    """Read the state of a recording from its log.

    Raises InputError if the file cannot be read or is no log.
    """
    try:
        if not path.is_file():
            path.stat()  # Raises FileNotFoundError if nothing is there.
            raise InputError(f"{path}: not a regular file, so not a log")
        with path.open("rb") as stream:
            size = stream.seek(0, io.SEEK_END)
            status = LogStatus(size, _is_held(stream))
            stream.seek(0)
            if stream.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: not an MCAP file, so not a log")
            for opcode, content in _records(stream, size):
                _learn(status, opcode, content)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {reason_of(error)}") from error
    if not status.capture:
        raise InputError(f"{path}: not a log of mbtool")
    return status


def _learn(status: LogStatus, opcode: int, content: bytes) -> None:
    if opcode == Opcode.FOOTER:
        status.is_closed = any(content[:8])  # The offset of the summary; 0 means none.
        return
    try:
        record = Metadata.read(ReadDataStream(io.BytesIO(content)))
    except (McapError, struct.error, UnicodeDecodeError):
        return
    values = {str(key): str(value) for key, value in record.metadata.items()}
    match record.name:
        case layout.CAPTURE:
            status.capture |= values
        case layout.LINK:
            status.links[values.get("name", "")] = values.get("spec", "")
        case layout.STATUS:
            status.heartbeat = values


def _records(stream: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield the opcode and the content of metadata records and of the footer; skip all others."""
    at = len(MAGIC)
    while at + RECORD_HEAD.size <= size:
        stream.seek(at)
        opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
        at += RECORD_HEAD.size + length
        if at > size or length > MAX_RECORD:
            return
        if opcode in (Opcode.METADATA, Opcode.FOOTER):
            yield opcode, stream.read(length)
        if opcode == Opcode.FOOTER:
            return


def _is_held(stream: BinaryIO) -> bool | None:
    """True if a recorder has locked the file (creating.py); None if the system has no locks."""
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return None  # This file system has no locks.
    return False
