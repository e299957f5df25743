"""Copies the intact records of a damaged log into a new log, and reports what was lost."""

# Messages are copied unchanged, byte by byte, with their topics and times; metadata and attachments
# too. Chunks, indexes and the summary are made anew. Where something was lost, the new log has a
# GAP event, so that no decoder joins the bytes before the loss to those after it, and the metadata
# record `mbtool.recovered` says how much was lost in all.
#
# A file may hold several logs, one behind the other; the new log has the messages of all.
#
# The channel of a message tells its topic. A channel is defined in the chunk that first uses it. If
# that chunk is lost, the summary defines the channel; without a summary, the message's own fields
# show its type.
#
# Memory: as for reading and writing a log, and the summary (summary.py). At most MAX_TOPICS topics.

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

import msgspec
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from mbtool.core import DamageError, EventKind, InputError, WireEvent
from mbtool.logs import schemas
from mbtool.logs.chunks import records_in
from mbtool.logs.complete_file import CompleteFile
from mbtool.logs.container import Container, Topic
from mbtool.logs.creating import create_file
from mbtool.logs.evidence_blocks import unpack_reads
from mbtool.logs.healing import Hole, SoundRecords
from mbtool.logs.layout import (
    DATA_END_SIZE,
    LIBRARY,
    MAGIC,
    MESSAGE_HEAD,
    PROFILE,
    RECORD_HEAD,
    RECOVERED,
    Opcode,
    data_end,
    pack_records,
)
from mbtool.logs.messages import EventMessage
from mbtool.logs.records import McapRecord, RecordStream
from mbtool.logs.summary import LogSummary, begins_log, check_end, read_summary
from mbtool.logs.writer import topic_name
from mbtool.version import __version__

if TYPE_CHECKING:
    from pathlib import Path

MAX_TOPICS = 60_000

_KINDS = {
    schemas.CHUNK: "chunks",
    schemas.TRANSACTION: "transactions",
    schemas.WIRE_EVENT: "events",
    schemas.POINT_VALUE: "points",
    schemas.LOG: "findings",
}
_SHARED = frozenset((schemas.POINT_VALUE, schemas.LOG))
"""The schemas of messages whose topic is shared by all links."""

_IS_MESSAGE = int(Opcode.MESSAGE)
MAX_HEAD_RECORDS = 100
"""The most records at the beginning of a file that are searched for a sign that it is a log of
mbtool. If none of them has one, the file counts as no log."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LogLoss:
    """A part of a log that is lost."""

    offset: int
    """The file offset of the first lost byte."""
    end: int
    """The file offset behind the last lost byte."""
    what: str
    """A text for the user that says what is damaged."""
    begin_ns: int | None
    """The log time (ns) at which the lost part begins: the earliest one of the lost chunks, as the
    summary says, else that of the last message before the loss. None if unknown."""
    end_ns: int | None
    """The log time (ns) at which the lost part ends: the latest one of the lost chunks, as the
    summary says, else that of the next message. None if unknown."""


@dataclass(slots=True, kw_only=True)
class Recovered:
    """The result of a recovery: what was copied and what was lost."""

    messages: int = 0
    """The number of messages copied."""
    lost_messages: int | None = None
    """The number of messages lost; None if unknown."""
    losses: int = 0
    lost_bytes: int = 0
    remark: str = ""
    """The first damage that cost no data, in words for the user; "" if there is none."""


class Recovery:
    """Reads a damaged log once, and writes its intact records to a new log."""

    def __init__(self, stream: BinaryIO, name: str, report: Callable[[LogLoss], None]) -> None:
        """Prepare to read the damaged log from `stream`; `name` is its name for error messages.

        `run` calls `report` for each lost part, in the order of the file.
        """
        self._name = name
        self._report = report
        self._summary = read_summary(stream, name) or LogSummary()
        self._records = RecordStream(stream, name)
        self._sound = SoundRecords(self._records, self._note_damage)
        self._schemas = dict(self._summary.schemas)
        self._channels = dict(self._summary.channels)
        self._topics: dict[tuple[str, str], Topic] = {}
        self._by_channel: dict[int, Topic | None] = {}
        self._now_ns: int | None = None
        self._waiting: Hole | None = None
        """A lost part that is not yet reported: its end is the log time of the next message that is
        read. None if there is none."""
        self._begin = 0
        """The file offset at which the log begins that is being read."""
        self._ends = False
        self.result = Recovered()

    def run(self, path: Path, *, replace: bool = False) -> Recovered:
        """Write the intact records to a new log; with `replace`, in place of an existing file.

        Raises InputError if the input is no log, UsageError or OutputError if the new log cannot be
        created or written.
        """
        head = self._head()
        file = create_file(path, replace=replace)
        header = Header(profile=PROFILE, library=f"{LIBRARY}{__version__}")
        target = CompleteFile(file, str(path), MAGIC + pack_records(header))
        try:
            self._container = Container(target)
            for record in head:
                self._copy(record)
            while not self._ends:
                self._copy(self._next_record())
            self._finish()
        finally:
            target.close()
        return self.result

    def _head(self) -> list[McapRecord | Hole]:
        """Return the records up to the first one that shows that the file is a log of mbtool.

        Raises InputError if the first MAX_HEAD_RECORDS records do not show it.
        """
        if self._records.look(len(MAGIC)) != MAGIC:
            self._note_damage(self._records.damaged(0, "the first bytes of the file"))
        self._records.take(min(len(MAGIC), len(self._records.look(len(MAGIC)))))
        head: list[McapRecord | Hole] = []
        while not self._ends and len(head) < MAX_HEAD_RECORDS:
            record = self._next_record()
            head.append(record)
            if isinstance(record, McapRecord) and self._is_of_log(record):
                return head
            if isinstance(record, McapRecord) and record.opcode == Opcode.CHUNK:
                break
        raise InputError(f"{self._name}: nothing of a log of mbtool is in it")

    def _is_of_log(self, record: McapRecord) -> bool:
        with suppress(DamageError):
            if record.opcode == Opcode.HEADER:
                header = self._records.parse(record, Header.read)
                return bool(header.profile == PROFILE or header.library.startswith(LIBRARY))
            if record.opcode == Opcode.METADATA:
                metadata = self._records.parse(record, Metadata.read)
                return bool(metadata.name.startswith(f"{PROFILE}."))
        return record.opcode == Opcode.CHUNK and b'"mbtool.' in record.content

    def _next_record(self) -> McapRecord | Hole:
        """Return the next record, or a hole for damaged bytes that were skipped.

        The last one is a DataEnd record, or a hole up to the end of the file.
        """
        start = self._records.position
        try:
            record = self._sound.read()
        except InputError as error:
            self._ends = True
            rest = self._records.look(DATA_END_SIZE)
            if rest and data_end(0)[: RECORD_HEAD.size].startswith(rest[: RECORD_HEAD.size]):
                # The file is cut off inside the DataEnd, so that nothing before it is missing.
                return McapRecord(start, Opcode.DATA_END, bytes(4))
            return Hole(start, max(self._records.end, start), DamageError(str(error)))
        if isinstance(record, McapRecord) and record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
            self._ends = True
        return record

    def _copy(self, record: McapRecord | Hole) -> None:
        if isinstance(record, Hole):
            self._note_lost(record)
            return
        try:
            self._copy_record(record)
        except DamageError as error:
            self._note_lost(Hole(record.offset, self._records.position, error))

    def _copy_record(self, record: McapRecord) -> None:
        match record.opcode:
            case Opcode.CHUNK:
                self._copy_chunk(record)
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._learn(record)
            case Opcode.MESSAGE:
                self._copy_message(record.offset, record.content)
            case Opcode.METADATA:
                metadata = self._records.parse(record, Metadata.read)
                self._container.add_metadata(metadata.name, metadata.metadata)
            case Opcode.ATTACHMENT:
                one = self._records.parse(record, Attachment.read)
                self._container.add_attachment(one.name, one.media_type, one.data)
            case Opcode.DATA_END:
                self._check_end(record)

    def _copy_chunk(self, record: McapRecord) -> None:
        data = record.content
        try:
            for opcode, begin, end in records_in(data):
                if opcode == _IS_MESSAGE:
                    self._copy_message(record.offset, data[begin:end])
                else:
                    self._learn(McapRecord(record.offset, opcode, data[begin:end]))
        except ValueError as error:
            what = self._records.damaged(record.offset, str(error))
            self._note_lost(Hole(record.offset, self._records.position, what))

    def _learn(self, record: McapRecord) -> None:
        with suppress(DamageError):
            if record.opcode == Opcode.SCHEMA:
                schema = self._records.parse(record, Schema.read)
                self._schemas[schema.id] = schema
            elif record.opcode == Opcode.CHANNEL:
                channel = self._records.parse(record, Channel.read)
                self._channels[channel.id] = channel
                self._by_channel.pop(channel.id, None)

    def _copy_message(self, offset: int, content: bytes) -> None:
        topic = None
        if len(content) >= MESSAGE_HEAD.size:
            channel, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(content)
            data = content[MESSAGE_HEAD.size :]
            topic = self._by_channel.get(channel) or self._topic_of(channel, data)
        if topic is None:
            what = self._records.damaged(offset, "a message of an unknown channel")
            self._note_lost(Hole(offset, self._records.position, what))
            return
        self._report_lost(log_ns)
        self._container.add_message(topic, log_ns, publish_ns, data)
        self._now_ns = log_ns
        self.result.messages += 1

    def _topic_of(self, channel_id: int, data: bytes) -> Topic | None:
        """Find the topic of a message by its channel, else by its data.

        Returns None if neither tells it, or if the new log already has MAX_TOPICS topics.
        """
        channel = self._channels.get(channel_id)
        schema = self._schemas.get(channel.schema_id) if channel is not None else None
        if channel is not None and schema is not None:
            encodings = schema.encoding, channel.message_encoding
            known = schemas.TopicSchema(schema.name, *encodings, schema.data)
            topic = self._topic(channel.topic, known)
            self._by_channel[channel_id] = topic
            return topic
        for name, type_ in schemas.MESSAGE_TYPES.items():
            if name in _KINDS:
                with suppress(msgspec.MsgspecError, ValueError, RecursionError):
                    message: Any = msgspec.json.decode(data, type=type_)
                    link = "" if name in _SHARED else message.link
                    return self._topic(topic_name(link, _KINDS[name]), schemas.schema_of(name))
        with suppress(ValueError):
            kind = topic_name(unpack_reads(data)[0].link, "evidence")
            return self._topic(kind, schemas.schema_of(schemas.EVIDENCE))
        return None

    def _topic(self, name: str, schema: schemas.TopicSchema) -> Topic | None:
        key = (name, schema.name)
        if key not in self._topics:
            if len(self._topics) >= MAX_TOPICS:
                return None
            self._topics[key] = self._container.add_topic(name, schema)
        return self._topics[key]

    def _note_damage(self, error: DamageError) -> None:
        self.result.remark = self.result.remark or f"{error}; nothing is lost there"

    def _note_lost(self, hole: Hole) -> None:
        """Note damaged bytes as lost; join them to a lost part that is not yet reported.

        If the summary shows that the bytes held no data, they become a remark instead.
        """
        if self._summary.messages is not None and not self._summary.has_record_in(
            hole.offset, hole.end
        ):
            self._note_damage(hole.error)
            return
        if self._waiting is not None:
            hole = Hole(self._waiting.offset, hole.end, self._waiting.error)
        self._waiting = hole

    def _report_lost(self, next_ns: int | None) -> None:
        """Report the lost part in `_waiting`, if there is one, and write a GAP event in its place.

        `next_ns` is the log time (ns) of the first message behind it; None at the end of the log.
        """
        hole, self._waiting = self._waiting, None
        if hole is None:
            return
        chunks = self._summary.chunks_in(hole.offset, hole.end)
        begin_ns = min((chunk.begin_ns for chunk in chunks), default=self._now_ns)
        end_ns = max((chunk.end_ns for chunk in chunks), default=next_ns)
        what = str(hole.error).removeprefix(f"{self._name}: ")
        loss = LogLoss(
            offset=hole.offset, end=hole.end, what=what, begin_ns=begin_ns, end_ns=end_ns
        )  # fmt: skip
        self.result.losses += 1
        self.result.lost_bytes += hole.end - hole.offset
        self._report(loss)
        if self._now_ns is not None:
            self._add_gap(loss, self._now_ns)

    def _add_gap(self, loss: LogLoss, ts_ns: int) -> None:
        size = loss.end - loss.offset
        message = f"{size} bytes of the log, from byte {loss.offset} on, were damaged and are lost"
        gap = WireEvent(ts_ns=ts_ns, link="", kind=EventKind.GAP, message=message)
        topic = self._topic(topic_name("", "events"), schemas.schema_of(schemas.WIRE_EVENT))
        if topic is not None:
            data = msgspec.json.encode(EventMessage.of(gap))
            self._container.add_message(topic, ts_ns, ts_ns, data)

    def _check_end(self, record: McapRecord) -> None:
        is_whole = self._waiting is None and not self.result.losses
        if is_whole and int.from_bytes(record.content, "little") not in (0, self._sound.crc_before):
            what = "the CRC of the data section does not match"
            self._note_damage(self._records.damaged(record.offset, what))
        try:
            check_end(self._records, self._begin)
        except InputError as error:
            self.result.remark = self.result.remark or str(error)
            return
        if begins_log(self._records):
            self._begin_next()

    def _begin_next(self) -> None:
        """Go on with the log that begins behind the end of this one."""
        self._begin = self._records.position
        self._records.restart_crc()
        self._records.take(len(MAGIC))
        self._schemas.clear()
        self._channels.clear()
        self._by_channel.clear()
        self._ends = False

    def _finish(self) -> None:
        self._report_lost(None)
        result = self.result
        if self._summary.messages is not None:
            result.lost_messages = max(self._summary.messages - result.messages, 0)
        self._container.add_metadata(
            RECOVERED,
            {
                "version": __version__,
                "messages": str(result.messages),
                "lost_bytes": str(result.lost_bytes),
                "lost_parts": str(result.losses),
            },
        )
        self._container.finish()
