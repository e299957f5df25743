"""Decodes the messages of a log's chunks into items (packets, transactions ...), many at once."""

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

from __future__ import annotations

import struct
from contextlib import suppress
from heapq import merge
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import msgspec
from mcap.records import Channel, Schema

from mbtool.core import Chunk, DamageError, Packet
from mbtool.devices import NamedTransaction
from mbtool.logs import schemas
from mbtool.logs.damage import ImpossibleItems
from mbtool.logs.evidence_blocks import separated
from mbtool.logs.layout import MESSAGE_HEAD, RECORD_HEAD, Opcode
from mbtool.logs.messages import ChunkMessage, DecodingMark, EventMessage
from mbtool.logs.records import McapRecord

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.logs.damage import Damage
    from mbtool.logs.messages import LogItem
    from mbtool.logs.records import RecordStream

BATCH = 4096
MIN_RECORDS = 1 << 18
_COUNTED = 16
"""A message with joined serial reads becomes many items, one for each read, which takes at least 2
bytes of the message. So it counts as 1 plus its length in bytes divided by this number. A batch
ends as soon as its messages count BATCH in all."""

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
                yield from self._decoded(batch)

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
                    left -= 1 if schema != schemas.EVIDENCE else 1 + length // _COUNTED
                    last_ns = log_ns
                    add(data[at + _DATA_AT : to])
                    add_schema(schema)
            elif opcode in _DEFINITIONS:
                self._learn(opcode, batch.offset, data[at + _HEAD : to])
            at = to
        batch.end_ns = last_ns
        self._walked = walked
        return at

    def _decoded(self, batch: _Batch) -> Iterator[list[LogItem]]:
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
            return _merged(self._decoded_alike(schemas.EVIDENCE, raw))
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
            items += _merged(some) if is_evidence else some
        return items

    def _decoded_alike(self, schema: str, raw: list[bytes]) -> list[Any]:
        """Decode messages of one schema into items, or for EVIDENCE into lists of serial reads.

        Raises one of _NOT_DECODABLE if a message is damaged.
        """
        if schema == schemas.EVIDENCE:
            return [separated(data) for data in raw]
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
            separated(data)
            return schemas.EVIDENCE
        return ""

    def _hole(self, offset: int, what: str, size: int) -> None:
        self._damage.add_hole(self._records.damaged(offset, what), offset, size)


def _items_of(schema: str, data: bytes) -> list[LogItem]:
    if schema == schemas.EVIDENCE:
        return [*separated(data)]
    message = _DECODERS[schema].decode(data)
    return [message if schema in _ARE_ITEMS else message.item()]


def _merged(evidence: list[list[Chunk] | Chunk | Packet]) -> list[LogItem]:
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
