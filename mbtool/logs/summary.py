"""Reads the summary at the end of a log, which says what the log holds and where."""

# The summary is used where the log before it is damaged: to find the channels of messages whose own
# definition is lost, and to tell how much was lost. It is used only if its CRC matches.
#
# Memory: the summary's bytes, at most MAX_RECORD, and a few numbers for each chunk. A longer
# summary is not used; two chunks a second for a week make one of 130 MB.

from __future__ import annotations

import io
import os
import struct
import zlib
from bisect import bisect_left
from typing import BinaryIO, NamedTuple

from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    MetadataIndex,
    Schema,
    Statistics,
)

from mbtool.core import InputError
from mbtool.logs.layout import FOOTER_SIZE, MAGIC, MAX_RECORD, PRIVATE, RECORD_HEAD, Opcode
from mbtool.logs.records import RecordStream

# The code below reads what follows the data section of a log: the summary, the footer and the magic
# bytes.
#
# The summary repeats what is in the data section, so damage in it loses no captured or decoded
# data. It is reported nevertheless: other readers find the chunks by the summary, and a disk that
# has changed one byte may change more. The CRC in the footer covers the summary and the footer
# itself.
#
# Memory: one record.

_FOOTER = struct.Struct("<QQI")
_CRC_SIZE = 4
_LAST_OPCODE = 0x0F

_SUMMARY_WRONG = "the summary, which repeats what is in the log; all else was read"
_FOOTER_WRONG = "the footer, which tells where the summary is; all else was read"


def is_open_end(records: RecordStream) -> bool:
    """True if the next record is the Footer of a log without a summary.

    The recorder of such a log is still writing it, or ended without closing it.
    """
    record = records.look_at_record()
    return (
        record is not None
        and record.opcode == Opcode.FOOTER
        and len(record.content) == _FOOTER.size
        and _FOOTER.unpack(record.content)[0] == 0
    )


def check_end(records: RecordStream, begin: int = 0) -> None:
    """Check the summary, the footer and the magic bytes that follow the DataEnd record.

    The log begins at file offset `begin`, which is 0 unless other logs are before it.
    Raises CutError if the file ends before they are complete, DamageError if anything in them is
    damaged.
    """
    start = records.position
    records.restart_crc()
    while True:
        record = records.look_at_record()
        if record is None or not _is_known(record.opcode):
            raise _broken(records, start, is_whole=record is not None)
        if record.opcode == Opcode.FOOTER:
            break
        records.take(RECORD_HEAD.size + len(record.content))
    offset = records.position
    if len(record.content) != _FOOTER.size:
        raise records.damaged(offset, _FOOTER_WRONG)
    summary_start, offsets_start, crc = _FOOTER.unpack(record.content)
    records.take(RECORD_HEAD.size + _FOOTER.size - _CRC_SIZE)
    found = records.crc
    records.take(_CRC_SIZE)
    if summary_start == 0:
        # A log that was not closed has summary_start 0, even if it was ended while its summary was
        # being written.
        if offsets_start or crc:
            raise records.damaged(offset, _FOOTER_WRONG)
    elif summary_start + begin != start or crc not in (0, found):
        raise records.damaged(start, _SUMMARY_WRONG)
    records.read_magic()


def begins_log(records: RecordStream) -> bool:
    """True if another log follows behind the end of a log, as in a file made with `cat`."""
    return records.look(len(MAGIC)) == MAGIC


def _is_known(opcode: int) -> bool:
    return 0 < opcode <= _LAST_OPCODE or opcode >= PRIVATE


def _broken(records: RecordStream, start: int, *, is_whole: bool) -> InputError:
    records.look(MAX_RECORD)
    if is_whole or records.ends_as_a_file():
        return records.damaged(start, _SUMMARY_WRONG)
    return records.cut(records.position)


class ChunkPlace(NamedTuple):
    """The offset in the file at which a chunk begins, and the log times (ns) of its messages."""

    offset: int
    begin_ns: int
    end_ns: int


class LogSummary:
    """The contents of a log's summary, the section at its end that lists its chunks."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkPlace] = []
        """The chunks of the log, sorted by offset."""
        self.other_offsets: list[int] = []
        """The file offsets of the attachment and metadata records, in ascending order."""
        self.messages: int | None = None
        """The number of messages in the log; None if the summary does not tell."""

    def chunks_in(self, begin: int, end: int) -> list[ChunkPlace]:
        """The chunks that begin at a file offset from `begin` up to, but not including, `end`."""
        first, last = (bisect_left(self.chunks, (offset,)) for offset in (begin, end))
        return self.chunks[first:last]

    def has_record_in(self, begin: int, end: int) -> bool:
        """True if a chunk, an attachment or metadata begins at an offset from `begin` up to `end`.

        `end` itself is not included.
        """
        first, last = (bisect_left(self.other_offsets, offset) for offset in (begin, end))
        return first < last or bool(self.chunks_in(begin, end))


def read_summary(stream: BinaryIO, name: str) -> LogSummary | None:
    """Read the summary of a log, then set the stream back to the position that it had.

    Returns None if the stream cannot seek, or if there is no intact summary.
    """
    try:
        if not stream.seekable():
            return None
        before = stream.tell()
        try:
            return _read(stream, name)
        finally:
            stream.seek(before)
    except (OSError, InputError):
        return None


def _read(stream: BinaryIO, name: str) -> LogSummary | None:
    size = stream.seek(0, os.SEEK_END)
    if size < FOOTER_SIZE:
        return None
    stream.seek(size - FOOTER_SIZE)
    footer = stream.read(FOOTER_SIZE)
    opcode, length = RECORD_HEAD.unpack_from(footer)
    start, _, crc = _FOOTER.unpack_from(footer, RECORD_HEAD.size)
    if opcode != Opcode.FOOTER or length != _FOOTER.size or footer[-len(MAGIC) :] != MAGIC:
        return None
    if not 0 < start <= size - FOOTER_SIZE or size - start > MAX_RECORD or not crc:
        return None
    stream.seek(start)
    data = stream.read(size - len(MAGIC) - _CRC_SIZE - start)
    return _parse_summary(data, name) if zlib.crc32(data) == crc else None


def _parse_summary(data: bytes, name: str) -> LogSummary:
    """Parse the bytes of a summary, up to the footer; `name` is the file's, for error messages.

    Raises DamageError if a record is too short for its fields.
    """
    summary = LogSummary()
    records = RecordStream(io.BytesIO(data), name)
    while (record := records.look_at_record()) is not None:
        records.take(RECORD_HEAD.size + len(record.content))
        match record.opcode:
            case Opcode.SCHEMA:
                schema = records.parse(record, Schema.read)
                summary.schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = records.parse(record, Channel.read)
                summary.channels[channel.id] = channel
            case Opcode.CHUNK_INDEX:
                chunk = records.parse(record, ChunkIndex.read)
                times = chunk.message_start_time, chunk.message_end_time
                summary.chunks.append(ChunkPlace(chunk.chunk_start_offset, *times))
            case Opcode.ATTACHMENT_INDEX:
                attachment = records.parse(record, AttachmentIndex.read)
                summary.other_offsets.append(attachment.offset)
            case Opcode.METADATA_INDEX:
                metadata = records.parse(record, MetadataIndex.read)
                summary.other_offsets.append(metadata.offset)
            case Opcode.STATISTICS:
                summary.messages = records.parse(record, Statistics.read).message_count
    summary.chunks.sort()
    summary.other_offsets.sort()
    return summary
