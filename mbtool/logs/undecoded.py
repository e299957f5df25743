"""Finds out if a log contains captured bytes that were not decoded when the log was made."""

# A recorder writes a mark (DecodingMark) when its decoder falls behind the capture, and another one
# when it has caught up. Few logs have such marks. A closed log lists its topics in its summary, so
# a log is searched for marks only if its summary lists their topic or if it was not closed.
#
# A log that was not closed, because its recorder was killed or is still writing, may lack the
# decoded records of its last moments without a mark: the recorder writes a mark only when its
# decoder is later than BEHIND_NS. If such a log is small, it is read to see whether any of its
# captured bytes are later than its last decoded record.

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Footer, SummaryOffset

from mbtool.core import Chunk, InputError, Packet, WireEvent
from mbtool.logs.layout import (
    DECODING_TOPIC,
    FOOTER_SIZE,
    MAGIC,
    MAX_RECORD,
    RECORD_HEAD,
    Opcode,
)
from mbtool.logs.reader import LogReader

MAX_LOOKED_THROUGH = 16 << 20
"""The largest size, in bytes, of a log that was not closed and that mbtool searches for captured
bytes without a decoded record, and then decodes; this takes some seconds. For a larger log, a
message tells the user how to do it."""

if TYPE_CHECKING:
    from pathlib import Path

UNDECODED_PIECES = "undecoded_pieces"
"""A key of the metadata at the end of a log: the number of chunks and packets not decoded."""


def undecoded_pieces(path: str | Path) -> int:
    """Count the chunks and packets of a log that were not decoded when it was made.

    Returns 0 for a file that is damaged or no log.
    """
    try:
        with open(path, "rb") as stream:
            if not _may_have_marks(stream):
                return 0
            stream.seek(0)
            return LogReader(stream, str(path)).undecoded()
    except (OSError, InputError):
        return 0


def ends_undecoded(path: str | Path) -> bool | None:
    """True if a log that was not closed has captured bytes later than its last decoded record.

    Returns None for a file that is larger than MAX_LOOKED_THROUGH, damaged or no log.
    """
    try:
        with open(path, "rb") as stream:
            end = stream.seek(0, os.SEEK_END)
            if not FOOTER_SIZE + len(MAGIC) <= end <= MAX_LOOKED_THROUGH:
                return None
            if _footer(stream, end).summary_start:
                return False
            stream.seek(0)
            return _has_late_evidence(LogReader(stream, str(path)))
    except (OSError, InputError, McapError, ValueError, struct.error):
        return None


def _has_late_evidence(log: LogReader) -> bool:
    heard_ns = recorded_ns = 0
    for item in log.items():
        if isinstance(item, Chunk | Packet):
            heard_ns = max(heard_ns, item.ts_ns)
        elif isinstance(item, WireEvent):
            recorded_ns = max(recorded_ns, item.ts_ns)
        else:
            recorded_ns = max(recorded_ns, item.request_ns or 0, item.response_ns or 0)
    return heard_ns > recorded_ns and not log.closed


def _may_have_marks(stream: BinaryIO) -> bool:
    """True if the summary of a log lists the topic of decoding marks, or if there is no summary."""
    end = stream.seek(0, os.SEEK_END)
    if end < FOOTER_SIZE + len(MAGIC):
        return False
    try:
        offsets_start = _footer(stream, end).summary_offset_start
        if not 0 < offsets_start <= end:
            return True
        for opcode, content in _records(stream, offsets_start, end - FOOTER_SIZE):
            group = SummaryOffset.read(ReadDataStream(BytesIO(content)))
            if opcode == Opcode.SUMMARY_OFFSET and group.group_opcode == Opcode.CHANNEL:
                return _has_topic(stream, group)
    except (McapError, ValueError, struct.error):
        return True
    return False


def _footer(stream: BinaryIO, end: int) -> Footer:
    ((_, content),) = _records(stream, end - FOOTER_SIZE, end - len(MAGIC))
    footer: Footer = Footer.read(ReadDataStream(BytesIO(content)))
    return footer


def _has_topic(stream: BinaryIO, group: SummaryOffset) -> bool:
    start = group.group_start
    return any(
        Channel.read(ReadDataStream(BytesIO(content))).topic == f"/{DECODING_TOPIC}"
        for _, content in _records(stream, start, start + group.group_length)
    )


def _records(stream: BinaryIO, start: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Yield the opcode and the content of each record between two file offsets.

    Raises ValueError if these bytes are not a sequence of whole records.
    """
    if not 0 <= end - start <= MAX_RECORD:
        raise ValueError("a part of a summary that is too long")
    stream.seek(start)
    data = stream.read(end - start)
    at = 0
    while at < len(data):
        if at + RECORD_HEAD.size > len(data):
            raise ValueError("a part of a record")
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        at += RECORD_HEAD.size + length
        if at > len(data):
            raise ValueError("a part of a record")
        yield opcode, data[at - length : at]
