"""Reads a log: its items (chunks, packets, transactions, events) and its metadata."""

# A log is read from start to end, in the order in which it was written. So it can come from a pipe,
# and a log that is cut off yields all complete chunks before the cut. The metadata before the first
# item is known as soon as a LogReader is made; later metadata is added when it is reached.
#
# Errors: InputError for a file of another kind, CutError for a file that ends early, DamageError
# for damaged bytes. The last two are raised after all intact items were returned.
#
# Damage: damaged records are skipped (healing.py), and reading goes on at the next intact record.
# Where items may be missing, there is a GAP event without a link in their place. Each chunk has a
# CRC, so no wrong item is returned. Damage that costs no item is reported as well: the CRC of the
# data section and that of the summary show it at the end.
#
# Metadata and attachments are kept in memory, MAX_KEPT bytes of them; any beyond that are reported
# as damage and left out.
#
# An item with a value that nothing on a wire can have, such as unit -5, is left out. One UNREADABLE
# event at the end tells how many such items there were.
#
# If the recorder was killed, its log is complete nevertheless. Only `closed`, which is False then,
# shows that the recorder did not end normally.

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from heapq import merge
from itertools import chain, groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO, Self, cast

import msgspec
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from mbtool.core import Chunk, DamageError, InputError, Packet, WireEvent
from mbtool.core.closing import ClosesOnExit
from mbtool.core.errors import reason_of
from mbtool.devices import NamedTransaction
from mbtool.logs import layout, schemas
from mbtool.logs.damage import Damage, ImpossibleItems
from mbtool.logs.evidence_blocks import unpack_reads
from mbtool.logs.healing import Hole, SoundRecords
from mbtool.logs.layout import (
    EVIDENCE_ONLY,
    LIBRARY,
    MESSAGE_HEAD,
    PROFILE,
    READ_VERSIONS,
    RECORD_HEAD,
    Opcode,
)
from mbtool.logs.messages import ChunkMessage, DecodingMark, EventMessage, LogItem
from mbtool.logs.records import ByteStream, McapRecord, RecordStream
from mbtool.logs.summary import begins_log, check_end, is_open_end

# The code below decodes the messages of a log's chunks into items (packets, transactions ...),
# many at once.
#
# One walk over the records of a chunk collects the bytes of the wanted messages by their schema,
# and the order of the schemas. The messages of a JSON schema are then decoded by one call, as one
# array, and put back in order. If that fails, they are decoded one by one, so that a damaged
# message costs no other one.
#
# A chunk of more than BATCH messages yields several lists. A message of many joined serial reads
# counts as several messages, according to its bytes.
#
# The writer joins many reads of each serial line into one message (evidence_blocks.py), so the
# captured data of several links are not in the order of time in the file. Where messages with
# captured data follow one another, their reads and packets are merged by time.
#
# Memory: BATCH messages, and the schema of each channel (at most 65,535).
#
# Work: at most as many records are read as the log has bytes so far, plus MIN_RECORDS. If a chunk
# has more, the rest of it is reported as damaged: a chunk of zeros, which unpacks to a thousand
# times its size, would have millions of empty records.

BATCH = 4096
MIN_RECORDS = 1 << 18
_BYTES_PER_COUNTED_ITEM = 16
"""A message of joined serial reads becomes one item for each read, and a read takes at least 2
bytes. In the size of a batch, such a message counts as 1 plus its length in bytes divided by this
number. A batch ends as soon as its messages count BATCH in all."""

_TYPES: dict[str, Any] = {
    schemas.CHUNK: ChunkMessage,
    schemas.TRANSACTION: NamedTransaction,
    schemas.WIRE_EVENT: EventMessage,
    schemas.DECODING: DecodingMark,
}
_EVIDENCE = frozenset({schemas.EVIDENCE, schemas.CHUNK})
_ARE_ITEMS = frozenset({schemas.TRANSACTION, schemas.DECODING})
"""Schemas whose decoded messages are log items as they are, without a conversion."""
# Creating a msgspec decoder takes longer than reading a small log, so all readers share these.
_DECODERS: dict[str, msgspec.json.Decoder[Any]] = {
    name: msgspec.json.Decoder(type_) for name, type_ in _TYPES.items()
}
_LIST_DECODERS: dict[str, msgspec.json.Decoder[Any]] = {
    schemas.CHUNK: msgspec.json.Decoder(list[ChunkMessage]),
    schemas.TRANSACTION: msgspec.json.Decoder(list[NamedTransaction]),
    schemas.WIRE_EVENT: msgspec.json.Decoder(list[EventMessage]),
    schemas.DECODING: msgspec.json.Decoder(list[DecodingMark]),
}
# The fields of a Chunk have the same names in the log, so a Chunk is decoded directly, without a
# ChunkMessage in between. Only a Packet has the field link_type. A search for its name in quotes
# finds no text value, as quotes inside a JSON string are escaped.
_CHUNKS_DECODER: msgspec.json.Decoder[Any] = msgspec.json.Decoder(list[Chunk])
_OF_A_PACKET = b'"link_type"'
_NOT_DECODABLE = (msgspec.MsgspecError, ValueError, RecursionError)
"""The errors for bytes that are no message: those of msgspec, ValueError for text that is not
UTF-8, RecursionError for JSON that nests too deep."""

_MESSAGE = struct.Struct("<BQH4xQ")
"""The head of a record and of the message in it: opcode, length, channel id, log time (ns)."""
_HEAD = RECORD_HEAD.size
_DATA_AT = _HEAD + MESSAGE_HEAD.size
_IS_MESSAGE = int(Opcode.MESSAGE)
_DEFINITIONS = frozenset((int(Opcode.SCHEMA), int(Opcode.CHANNEL)))


class MessageDecoder:
    """Decodes the messages of a log into items; remembers the log's schemas and channels."""

    def __init__(self, records: RecordStream, damage: Damage) -> None:
        self._records = records
        self._damage = damage
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, str] = {}
        self._walked = 0
        """The number of records in all chunks so far."""
        self.end_ns = 0
        """The log time (ns) of the last item that was decoded; 0 before the first."""
        self.impossible = ImpossibleItems()
        """Counts the messages that were left out because a number in them is out of range."""

    def batches(self, record: McapRecord, wanted: frozenset[str]) -> Iterator[list[LogItem]]:
        """Yield the items of the wanted schemas in a chunk, or in a record outside of chunks.

        A message that cannot be decoded is left out and counted as damage; a GAP event, in a list
        of its own, takes its place.
        """
        data = record.content
        if record.opcode != Opcode.CHUNK:
            data = RECORD_HEAD.pack(record.opcode, len(data)) + data
        at = 0
        while at < len(data):
            batch = _Batch(record.offset)
            at = self._walk(data, at, wanted, batch)
            if batch.raw:
                yield from self._decode_batch(batch)

    def _walk(self, data: bytes, at: int, wanted: frozenset[str], batch: _Batch) -> int:
        """Collect up to BATCH messages of the wanted schemas into `batch`.

        The search begins at offset `at` of `data`, the records of a chunk. Returns the offset at
        which the next search begins; len(data) if there is nothing left.
        """
        # Half of the time of reading a log is spent in this loop, so it calls methods by local
        # names.
        end = len(data)
        last = end - _MESSAGE.size
        walked, allowed = self._walked, batch.offset + MIN_RECORDS
        unpack, schema_of = _MESSAGE.unpack_from, self._channels.get
        add, add_schema = batch.raw.append, batch.order.append
        left = BATCH
        last_ns = 0
        while at < end and left > 0:
            if at <= last:
                opcode, length, channel, log_ns = unpack(data, at)
            else:  # A record of a few bytes is not a message, but its head is unpacked as one.
                opcode, length, channel, log_ns = unpack(data[at:] + bytes(_MESSAGE.size))
            to = at + _HEAD + length
            walked += 1
            if to > end:
                self._hole(batch.offset, "a chunk that ends inside a record", end - at)
                at = end
                break
            if walked > allowed:
                self._hole(batch.offset, f"more than {allowed} records", end - at)
                at = end
                break
            if opcode == _IS_MESSAGE:
                schema = schema_of(channel)
                if schema is None:
                    schema = self._unknown(channel, batch.offset, data[at + _DATA_AT : to])
                if schema in wanted:
                    if left == BATCH:
                        batch.begin_ns = log_ns
                    left -= (
                        1 if schema != schemas.EVIDENCE else 1 + length // _BYTES_PER_COUNTED_ITEM
                    )
                    last_ns = log_ns
                    add(data[at + _DATA_AT : to])
                    add_schema(schema)
            elif opcode in _DEFINITIONS:
                self._learn(opcode, batch.offset, data[at + _HEAD : to])
            at = to
        batch.end_ns = last_ns
        self._walked = walked
        return at

    def _decode_batch(self, batch: _Batch) -> Iterator[list[LogItem]]:
        """Decode a batch; yield its items in one list, or in several if a message is damaged.

        If items between the previous batch and this one are lost, a list with a GAP event comes
        first.
        """
        if gap := self._damage.take_gap(batch.begin_ns):
            yield [*gap]
        try:
            items = self._decoded_at_once(batch)
        except _NOT_DECODABLE:
            yield from self._decoded_singly(batch)
        else:
            self._note_end(batch, items)
            yield items

    def _note_end(self, batch: _Batch, items: list[LogItem]) -> None:
        self.end_ns = batch.end_ns
        if batch.order[-1] == schemas.EVIDENCE and isinstance(items[-1], Chunk):
            # A message joins several chunks, and its log time is that of the first one.
            self.end_ns = items[-1].ts_ns

    def _decoded_at_once(self, batch: _Batch) -> list[LogItem]:
        order, raw = batch.order, batch.raw
        kinds = set(order)
        if kinds == {schemas.EVIDENCE}:
            return _merge_evidence(self._decoded_alike(schemas.EVIDENCE, raw))
        if len(kinds) == 1:
            return self._decoded_alike(order[0], raw)
        found = {}
        for kind in kinds:
            alike = [data for schema, data in zip(order, raw, strict=True) if schema == kind]
            found[kind] = iter(self._decoded_alike(kind, alike))
        if schemas.EVIDENCE not in kinds:
            return [next(found[schema]) for schema in order]
        items: list[LogItem] = []
        for is_evidence, run in groupby(order, _EVIDENCE.__contains__):
            some = [next(found[schema]) for schema in run]
            items += _merge_evidence(some) if is_evidence else some
        return items

    def _decoded_alike(self, schema: str, raw: list[bytes]) -> list[Any]:
        """Decode messages of one schema into items, or for EVIDENCE into lists of serial reads.

        Raises one of _NOT_DECODABLE if a message is damaged.
        """
        if schema == schemas.EVIDENCE:
            return [unpack_reads(data) for data in raw]
        array = b"[" + b",".join(raw) + b"]"
        found: list[Any]
        if schema == schemas.CHUNK and _OF_A_PACKET not in array:
            found = _CHUNKS_DECODER.decode(array)
        else:
            found = _LIST_DECODERS[schema].decode(array)
            if schema not in _ARE_ITEMS:
                found = [message.item() for message in found]
        if len(found) != len(raw):
            raise ValueError("a message that is not one JSON value")
        return found

    def _decoded_singly(self, batch: _Batch) -> Iterator[list[LogItem]]:
        for schema, data in zip(batch.order, batch.raw, strict=True):
            try:
                items = _items_of(schema, data)
            except _NOT_DECODABLE as error:
                if self.impossible.note(error, data):
                    continue
                self._hole(batch.offset, f"no {schema}: {error}", len(data))
                continue
            if gap := self._damage.take_gap(self.end_ns):
                yield [*gap]
            self._note_end(batch, items)
            yield items

    def _learn(self, opcode: int, offset: int, content: bytes) -> None:
        record = McapRecord(offset, opcode, content)
        try:
            if opcode == Opcode.SCHEMA:
                schema = self._records.parse(record, Schema.read)
                self._schemas[schema.id] = schema.name
            elif opcode == Opcode.CHANNEL:
                channel = self._records.parse(record, Channel.read)
                name = self._schemas.get(channel.schema_id)
                if name is not None or not channel.schema_id:
                    self._channels[channel.id] = name or ""
        except DamageError as error:
            self._damage.add_hole(error, offset, len(content))

    def _unknown(self, channel: int, offset: int, data: bytes) -> str:
        """Find the schema of a channel whose definition is lost by decoding one of its messages.

        `data` is that message, and `offset` the file offset of its chunk. Returns the schema's
        name, "" if the message is no item.
        """
        if not self._damage:
            what = f"a message of an unknown channel ({channel})"
            self._damage.add(self._records.damaged(offset, what))
        schema = self._channels[channel] = self._schema_of(data)
        return schema

    def _schema_of(self, data: bytes) -> str:
        """Return the name of a message's schema, found by trying to decode it; "" if it is no item.

        Each type of item has required fields that no other type has, so only one type fits.
        """
        for schema, decoder in _DECODERS.items():
            with suppress(*_NOT_DECODABLE):
                decoder.decode(data)
                return schema
        with suppress(ValueError):
            unpack_reads(data)
            return schemas.EVIDENCE
        return ""

    def _hole(self, offset: int, what: str, size: int) -> None:
        self._damage.add_hole(self._records.damaged(offset, what), offset, size)


def _items_of(schema: str, data: bytes) -> list[LogItem]:
    if schema == schemas.EVIDENCE:
        return [*unpack_reads(data)]
    message = _DECODERS[schema].decode(data)
    return [message if schema in _ARE_ITEMS else message.item()]


def _merge_evidence(evidence: list[list[Chunk] | Chunk | Packet]) -> list[LogItem]:
    """Return the captured chunks and packets of several messages in one list.

    An element of `evidence` is what one message holds: one item, or a list of serial reads. If the
    items come from several links, they are merged by their times.
    """
    by_link: dict[str, list[Chunk | Packet]] = {}
    for one in evidence:
        some = one if isinstance(one, list) else [one]
        by_link.setdefault(some[0].link, []).extend(some)
    lists = [*by_link.values()]
    return [*(lists[0] if len(lists) == 1 else merge(*lists, key=attrgetter("ts_ns")))]


class _Batch:
    """Messages of one chunk that were collected and are not yet decoded."""

    def __init__(self, offset: int) -> None:
        self.offset = offset
        """The file offset of the chunk that contains the messages."""
        self.order: list[str] = []
        """The name of each message's schema, in the order of the messages in `raw`."""
        self.raw: list[bytes] = []
        self.begin_ns = 0
        """The log time (ns) of the first message in the batch; 0 while the batch is empty."""
        self.end_ns = 0


MAX_KEPT = 32 << 20
_ITEMS = _EVIDENCE | {schemas.TRANSACTION, schemas.WIRE_EVENT}
_ITEM_OPCODES = frozenset({Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
"""The kinds of records that contain items, or that define the schemas and channels of items."""


class LogReader(ClosesOnExit):
    """Reads a log once. A context manager whose exit closes the stream."""

    capture: dict[str, str]
    """Metadata of the capture: version, host, command, clock, numbers of dropped bytes and
    packets."""
    links: dict[str, dict[str, str]]
    """The settings of each link (its LINK as text, its TCP ports), by the link's name."""
    devices: dict[str, str]
    """The name of each device's profile. A key names a device in the form of the option
    `--device`."""
    profiles: dict[str, bytes]
    """The device profiles in use, by name, as JSON."""
    closed: bool
    """True if the recorder closed the log; False until the log was read to its end."""

    def __init__(
        self, stream: ByteStream, name: str, *, wait: Callable[[], bool] | None = None
    ) -> None:
        """Read the metadata before the first item. `name` is the file's name for error messages.

        With `wait` the reader follows a log that is still being written: it calls `wait` at the end
        of the file, and reads on if it returns True. Raises InputError if the stream is not a log,
        CutError or DamageError if its beginning is not whole.
        """
        self._stream = stream
        self._name = name
        self._records = RecordStream(stream, name)
        self._damage = Damage(name)
        self._sound = SoundRecords(self._records, self._damage.add)
        self._messages = MessageDecoder(self._records, self._damage)
        self._kept = 0
        """The number of bytes of metadata and attachments read so far."""
        self.capture = {}
        self.links = {}
        self.devices = {}
        self.profiles = {}
        self.closed = False
        self._records.read_magic()
        self._read_header()
        data = self._data_section(wait)
        first = next((record for record in data if not self._learn(record)), None)
        self._check_version()
        self._data = data if first is None else chain([first], data)

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a log. Raises InputError if the file cannot be read or is not a log."""
        stream = _open(path)
        try:
            return cls(stream, str(path))
        except BaseException:
            stream.close()
            raise

    @property
    def is_evidence_only(self) -> bool:
        """True if the log contains captured bytes only, so that its reader has to decode them."""
        return self.capture.get(EVIDENCE_ONLY) == "true"

    @property
    def end_ns(self) -> int:
        """The log time (ns) of the last item that was read; 0 before the first."""
        return self._messages.end_ns

    def items(self) -> Iterator[LogItem]:
        """Yield all items in the order in which they were written. A second call yields nothing."""
        return chain.from_iterable(self._read(_ITEMS))

    def transactions(self) -> Iterator[NamedTransaction]:
        """Yield only the transactions.

        A log is read once: call only one of `items`, `transactions` and `evidence`.
        """
        for batch in self.transaction_batches():
            yield from batch

    def transaction_batches(self) -> Iterator[list[NamedTransaction]]:
        """Yield only the transactions, in lists of up to some thousands; the fastest way to read.

        A log is read once: call only one of `items`, `transactions`, `evidence` and this.
        """
        for batch in self._read(frozenset({schemas.TRANSACTION})):
            # GAP events come in lists of their own; they are left out here.
            if isinstance(batch[0], NamedTransaction):
                yield cast("list[NamedTransaction]", batch)

    def evidence(self) -> Iterator[Chunk | Packet | WireEvent]:
        """Yield only the captured bytes, and GAP events where the log is damaged.

        A log is read once: call only one of `items`, `transactions` and `evidence`.
        """
        for batch in self._read(_EVIDENCE):
            for item in batch:
                if not isinstance(item, NamedTransaction):
                    yield item

    def captured_items(self) -> Iterator[Chunk | Packet | WireEvent]:
        """Yield the captured bytes and the events, in the order in which they were written.

        A log is read once: call only one of `items`, `transactions`, `evidence` and this.
        """
        for batch in self._read(_EVIDENCE | {schemas.WIRE_EVENT}):
            for item in batch:
                if not isinstance(item, NamedTransaction):
                    yield item

    def undecoded(self) -> int:
        """Count the chunks and packets that the recorder captured but did not decode.

        This reads the whole log; call no other method that reads it. The count is an estimate for a
        log whose recorder still writes or was killed: the last moments are not counted.
        """
        waiting = dropped = 0
        for batch in self._read(frozenset({schemas.DECODING})):
            for mark in batch:
                if isinstance(mark, DecodingMark):
                    waiting = mark.waiting
                    dropped += mark.dropped
        return waiting + dropped

    def close(self) -> None:
        self._stream.close()

    def _read_header(self) -> None:
        record = self._sound.read()
        if isinstance(record, Hole) or record.opcode != Opcode.HEADER:
            raise self._records.damaged(len(layout.MAGIC), "the header record is missing")
        header = self._records.parse(record, Header.read)
        # Either field shows that the file is a log of mbtool; a damaged byte may have changed the
        # other.
        if header.profile != PROFILE and not header.library.startswith(LIBRARY):
            raise InputError(
                f"{self._name}: an MCAP file of profile {header.profile!r}, "
                f"not a log of mbtool (profile {PROFILE!r})"
            )

    def _check_version(self) -> None:
        version = self.capture.get("log_format", READ_VERSIONS[-1])
        if version not in READ_VERSIONS:
            raise InputError(
                f"{self._name}: log format {version}, from another version of mbtool; "
                f"this one reads the formats {' and '.join(READ_VERSIONS)}"
            )

    def _data_section(self, wait: Callable[[], bool] | None) -> Iterator[McapRecord | Hole]:
        """Yield the records before DataEnd, and holes for skipped bytes.

        Without `wait`, the records from DataEnd on are then checked. With `wait`, the reader
        follows a log that is still being written: at each DataEnd record it calls `wait` and reads
        again from there, until `wait` returns False or the log is closed.
        """
        while True:
            record = self._sound.read()
            if isinstance(record, Hole) or record.opcode not in (Opcode.DATA_END, Opcode.FOOTER):
                yield record
                continue
            if wait is None:
                self._check_end(record)
                return
            is_open = is_open_end(self._records)
            self._records.seek(record.offset)
            # If the end that was read is not that of an open log, either the log was closed, or the
            # recorder was just replacing the end. In the second case another record is now at the
            # offset of the DataEnd record.
            self.closed = not is_open and self._records.look_at_record() == record
            if self.closed or (is_open and not wait()):
                return

    def _check_end(self, record: McapRecord) -> None:
        """Check the CRC of the data section, then the summary and the footer behind it."""
        if record.opcode == Opcode.FOOTER:
            self._damage.add(self._records.damaged(record.offset, "the end of the data is missing"))
            self.closed = True
            return
        expected = int.from_bytes(record.content, "little")
        # Damaged records, which were reported before, make this CRC wrong, too.
        if not self._damage and expected not in (0, self._sound.crc_before):
            what = "the CRC of the data section does not match"
            self._damage.add(self._records.damaged(record.offset, what))
        self.closed = not is_open_end(self._records)
        try:
            check_end(self._records)
            if begins_log(self._records):
                what = "another log begins here, behind the end of the first, and is not read"
                raise self._records.damaged(self._records.position, what)
        except DamageError as error:
            self._damage.add(error)

    def _learn(self, record: McapRecord | Hole) -> bool:
        """Return False if the record or hole may hold items.

        Otherwise keep the record's metadata, or count the hole as damage, and return True.
        """
        if isinstance(record, Hole):
            if not record.has_items:
                self._damage.add(record.error, record.end - record.offset)
            return not record.has_items
        if record.opcode in _ITEM_OPCODES:
            return False
        try:
            self._learn_from(record)
        except DamageError as error:
            self._damage.add(error, len(record.content))
        return True

    def _learn_from(self, record: McapRecord) -> None:
        if record.opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            self._kept += len(record.content)
            if self._kept > MAX_KEPT:
                what = f"more than {MAX_KEPT} bytes of metadata and profiles"
                raise self._records.damaged(record.offset, what)
        match record.opcode:
            case Opcode.METADATA:
                metadata = self._records.parse(record, Metadata.read)
                self._learn_metadata(metadata.name, metadata.metadata)
            case Opcode.ATTACHMENT:
                attachment = self._records.parse(record, Attachment.read)
                self.profiles[attachment.name] = attachment.data

    def _learn_metadata(self, name: str, values: dict[str, str]) -> None:
        match name:
            case layout.CAPTURE:
                self.capture.update(values)
            case layout.LINK:
                self.links[values.pop("name", "")] = values
            case layout.DEVICE:
                self.devices[values.get("who", "")] = values.get("profile", "")

    def _read(self, wanted: frozenset[str]) -> Iterator[list[LogItem]]:
        """Yield the items of the wanted schemas in lists, with GAP events where items may be
        missing.

        `wanted` has the names of the schemas. At the end, raises DamageError or CutError if the log
        is not whole.
        """
        messages, damage = self._messages, self._damage
        try:
            for record in self._data:
                if isinstance(record, Hole):
                    damage.add_hole(record.error, record.offset, record.end - record.offset)
                elif not self._learn(record):
                    yield from messages.batches(record, wanted)
        except InputError as end:
            yield from self._last_gap()
            if damage:
                raise damage.added_to(end) from end
            raise
        yield from self._last_gap()
        if damage:
            raise damage.error()

    def _last_gap(self) -> Iterator[list[LogItem]]:
        if left_out := [*self._messages.impossible.events(self._messages.end_ns)]:
            yield [*left_out]
        if gap := self._damage.take_gap(self._messages.end_ns):
            yield [*gap]


def read_log(path: str | Path) -> Iterator[LogItem]:
    """Yield all items of a log in the order in which they were written.

    Raises InputError if the file cannot be read or is not a log; CutError or DamageError if it is
    not whole, after the items that could be read.
    """
    with LogReader.open(path) as log:
        yield from log.items()


def follow(path: str | Path, wait: Callable[[], bool]) -> Iterator[LogItem]:
    """Read a log that is still being written; yield its items as they reach the disk.

    `wait` is called at the end of the file. It returns True to look again, or False to end. The
    iterator also ends when the log is closed. Raises InputError if the file cannot be read or is
    not a log, CutError or DamageError if it is not whole.
    """
    # Unbuffered, as the writer replaces the end of the file, and a buffer would keep the old end.
    with _open(path, buffering=0) as stream:
        while not stream.read(1) and wait():
            pass  # The recorder has created the file and written nothing yet.
        stream.seek(0)
        yield from LogReader(stream, str(path), wait=wait).items()


def _open(path: str | Path, buffering: int = -1) -> BinaryIO:
    try:
        return Path(path).open("rb", buffering=buffering)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be opened: {reason_of(error)}") from error
