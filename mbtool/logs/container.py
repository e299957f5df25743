"""Writes messages into MCAP chunks with their indexes, and the summary at the end."""

# Messages are collected in one open chunk. The chunk is sealed (compressed with zstd, followed by
# its message indexes) when it has CHUNK_SIZE bytes, before a record that must be outside chunks,
# and at a flush. Sealed bytes go to the file at the next flush; a full chunk causes a flush.
# Schemas and channels are in the chunk that first uses them.
#
# Memory: one chunk, and the chunk indexes for the summary, about 110 bytes for each chunk (two
# chunks a second for a day: 19 MB).

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

import zstandard
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from mbtool.logs.layout import MESSAGE_HEAD, RECORD_HEAD, Opcode, footer, pack_records

if TYPE_CHECKING:
    from mbtool.logs.complete_file import CompleteFile
    from mbtool.logs.schemas import TopicSchema

CHUNK_SIZE = 256 * 1024
SMALL = 8 * 1024
"""A chunk of at most this many bytes is compressed with zstd at level 19, which takes less than 2
ms. A larger chunk is compressed at zstd's default level, which is faster and packs less."""
MAX_CHANNELS = 0xFFFF
MAX_TIME = (1 << 64) - 1

_INDEX_ENTRY = struct.Struct("<QQ")
_INDEX_HEAD = struct.Struct("<HI")


class Topic:
    """An MCAP channel, with the index of its messages in the chunk that is being filled."""

    __slots__ = ("count", "id", "index")

    def __init__(self, channel_id: int) -> None:
        self.id = channel_id
        self.count = 0
        self.index = bytearray()
        """For each message of this channel in the chunk that is being filled: its log time (ns) and
        its offset (bytes) in the chunk, packed as an MCAP index entry."""


class Container:
    """Collects the records of one MCAP file into chunks, and writes them to the file."""

    def __init__(self, file: CompleteFile) -> None:
        self._file = file
        self._compressor = zstandard.ZstdCompressor()
        self._thorough = zstandard.ZstdCompressor(level=19)
        self._sealed = bytearray()
        self._chunk = bytearray()
        self._chunk_times: tuple[int, int] | None = None
        self._times: tuple[int, int] | None = None
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._topics: list[Topic] = []
        self._in_chunk: list[Topic] = []
        self._chunks = 0
        self._chunk_indexes = bytearray()
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []

    @property
    def pending(self) -> int:
        """The number of bytes in memory that were added since the last flush to the file."""
        return len(self._chunk) + len(self._sealed)

    def add_topic(self, name: str, schema: TopicSchema) -> Topic:
        """Add the topic `name`, such as "/bus/events", with the schema of its messages.

        The caller adds at most MAX_CHANNELS topics: MCAP has 16 bits for a channel's id.
        """
        known = self._schemas.get(schema.name)
        if known is None:
            known = Schema(
                id=len(self._schemas) + 1,
                name=schema.name,
                encoding=schema.encoding,
                data=schema.data,
            )
            self._schemas[schema.name] = known
            self._chunk += pack_records(known)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=name,
            message_encoding=schema.message_encoding,
            metadata={},
            schema_id=known.id,
        )
        self._channels.append(channel)
        self._chunk += pack_records(channel)
        topic = Topic(channel.id)
        self._topics.append(topic)
        return topic

    def add_message(self, topic: Topic, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message, encoded as `data`, with its log time and its publish time (ns).

        Times outside 0 to MAX_TIME are set to the nearer limit.
        """
        log_ns = min(max(log_ns, 0), MAX_TIME)
        publish_ns = min(max(publish_ns, 0), MAX_TIME)
        if not topic.index:
            self._in_chunk.append(topic)
        topic.index += _INDEX_ENTRY.pack(log_ns, len(self._chunk))
        self._chunk += RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + len(data))
        self._chunk += MESSAGE_HEAD.pack(topic.id, topic.count & 0xFFFFFFFF, log_ns, publish_ns)
        self._chunk += data
        topic.count += 1
        self._chunk_times = _widened(self._chunk_times, log_ns, log_ns)
        if len(self._chunk) >= CHUNK_SIZE:
            self.flush(sync=False)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._seal()
        record = pack_records(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(
            MetadataIndex(offset=self._next_offset, length=len(record), name=name)
        )
        self._sealed += record

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        self._seal()
        record = pack_records(
            Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        )
        self._attachments.append(
            AttachmentIndex(
                offset=self._next_offset,
                length=len(record),
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._sealed += record

    def flush(self, *, sync: bool) -> None:
        """Write everything that was added since the last flush to the file.

        With `sync` the method returns only when the data are on the disk. Raises OutputError if the
        data cannot be written; they are then lost.
        """
        self._seal()
        if self._sealed:
            sealed, self._sealed = bytes(self._sealed), bytearray()
            self._file.append(sealed, sync=sync)

    def finish(self) -> None:
        """Flush and write the summary. Raises OutputError if the file cannot be written."""
        self.flush(sync=False)
        self._file.finish(self._summary)

    @property
    def _next_offset(self) -> int:
        """The file offset of the next record outside a chunk: behind all sealed bytes."""
        return self._file.position + len(self._sealed)

    def _seal(self) -> None:
        if self._chunk_times is None:
            return  # No message yet: its schemas and channels wait for the first one.
        content, self._chunk = self._chunk, bytearray()
        (start_ns, end_ns), self._chunk_times = self._chunk_times, None
        compressor = self._compressor if len(content) > SMALL else self._thorough
        data = compressor.compress(content)
        offset = self._next_offset
        record = pack_records(
            Chunk(
                compression="zstd",
                data=data,
                message_start_time=start_ns,
                message_end_time=end_ns,
                uncompressed_crc=zlib.crc32(content),
                uncompressed_size=len(content),
            )
        )
        self._sealed += record
        indexes_at = self._next_offset
        index_offsets = self._seal_indexes()
        self._chunk_indexes += pack_records(
            ChunkIndex(
                chunk_start_offset=offset,
                chunk_length=len(record),
                compression="zstd",
                compressed_size=len(data),
                uncompressed_size=len(content),
                message_start_time=start_ns,
                message_end_time=end_ns,
                message_index_offsets=index_offsets,
                message_index_length=self._next_offset - indexes_at,
            )
        )
        self._chunks += 1
        self._times = _widened(self._times, start_ns, end_ns)

    def _seal_indexes(self) -> dict[int, int]:
        offsets = {}
        for topic in self._in_chunk:
            offsets[topic.id] = self._next_offset
            size = len(topic.index)
            self._sealed += RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, _INDEX_HEAD.size + size)
            self._sealed += _INDEX_HEAD.pack(topic.id, size)
            self._sealed += topic.index
            topic.index = bytearray()
        self._in_chunk.clear()
        return offsets

    def _summary(self, start: int) -> tuple[bytes, bytes]:
        groups = (
            (Opcode.SCHEMA, pack_records(*self._schemas.values())),
            (Opcode.CHANNEL, pack_records(*self._channels)),
            (Opcode.STATISTICS, pack_records(self._statistics())),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, pack_records(*self._attachments)),
            (Opcode.METADATA_INDEX, pack_records(*self._metadata)),
        )
        at = start
        offsets = []
        for opcode, group in groups:
            if group:
                offsets.append(SummaryOffset(opcode, at, len(group)))
                at += len(group)
        section = b"".join(group for _, group in groups) + pack_records(*offsets)
        # The CRC covers the summary, and the footer up to its CRC field.
        crc = zlib.crc32(section + footer(start, at)[: RECORD_HEAD.size + 16])
        return section, footer(start, at, crc)

    def _statistics(self) -> Statistics:
        start_ns, end_ns = self._times or (0, 0)
        counts = {topic.id: topic.count for topic in self._topics if topic.count}
        return Statistics(
            message_count=sum(counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=len(self._attachments),
            metadata_count=len(self._metadata),
            chunk_count=self._chunks,
            message_start_time=start_ns,
            message_end_time=end_ns,
            channel_message_counts=counts,
        )


def _widened(times: tuple[int, int] | None, start: int, end: int) -> tuple[int, int]:
    return (start, end) if times is None else (min(times[0], start), max(times[1], end))
