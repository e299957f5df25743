"""Reads a log: its items, and the metadata about them."""

# A log is read from start to end, in the order in which it was written. So it can come from a pipe,
# and a log that is cut off gives all complete chunks before the cut. The metadata before the first
# item is known as soon as a LogReader is made; later metadata is added when it is reached.
#
# Errors: InputError for a file of another kind, CutError for a file that ends early, DamageError
# for damaged bytes. The last two are raised after all intact items were returned.
#
# Damage: a chunk or an attachment with a wrong CRC is skipped. Where items may be missing there is
# a GAP event without a link in their place. Each chunk has a CRC, so no wrong item is returned.
# Damage between chunks can hide an item, which the CRC of the whole data section shows at the end;
# a wrong length of a record ends the reading there.
#
# The log of a recorder that was killed is complete, and only `closed` shows that it was.

from __future__ import annotations

import struct
import zlib
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self

import msgspec
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from mbtool.core import Chunk, DamageError, InputError, Packet, WireEvent
from mbtool.core.closing import ClosesOnExit
from mbtool.core.errors import reason_of
from mbtool.devices import NamedTransaction
from mbtool.logs import layout, schemas
from mbtool.logs.damage import Damage
from mbtool.logs.layout import FORMAT_VERSION, MESSAGE_HEAD, PROFILE, Opcode
from mbtool.logs.messages import ChunkMessage, EventMessage, LogItem
from mbtool.logs.records import ByteStream, McapRecord, RecordStream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_Message = ChunkMessage | NamedTransaction | EventMessage
_ITEMS = frozenset({schemas.CHUNK, schemas.TRANSACTION, schemas.WIRE_EVENT})
_ITEM_OPCODES = frozenset({Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
"""Records that hold items, or define their types."""


class LogReader(ClosesOnExit):
    """Reads a log once. A context manager whose exit closes the stream."""

    capture: dict[str, str]
    """The run's metadata: version, host, command, clock, drop counts."""
    links: dict[str, dict[str, str]]
    """The settings of each link, by the link's name."""
    devices: dict[str, str]
    """The name of each device's profile; the key names the device as `--device` does."""
    profiles: dict[str, bytes]
    """The profiles in use, by name, as JSON."""
    closed: bool
    """True if the recorder closed the log; False until the log was read to its end."""

    def __init__(
        self, stream: ByteStream, name: str, *, wait: Callable[[], bool] | None = None
    ) -> None:
        """Read the metadata before the first item; `wait` is as in `follow`.

        Raises InputError if the stream is not a log, CutError or DamageError if its head is not
        whole.
        """
        self._stream = stream
        self._records = RecordStream(stream, name)
        self._damage = Damage(name)
        self._now_ns = 0
        """The log time (ns) of the last item that was read."""
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, str] = {}
        self._decoders: dict[str, msgspec.json.Decoder[_Message]] = {
            schemas.CHUNK: msgspec.json.Decoder(ChunkMessage),
            schemas.TRANSACTION: msgspec.json.Decoder(NamedTransaction),
            schemas.WIRE_EVENT: msgspec.json.Decoder(EventMessage),
        }
        self.capture = {}
        self.links = {}
        self.devices = {}
        self.profiles = {}
        self.closed = False
        self._records.read_magic()
        self._read_header(name)
        data = self._data_section(wait)
        first = next((record for record in data if not self._learn(record)), None)
        self._check_version(name)
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
    def end_ns(self) -> int:
        """The log time (ns) of the last item that was read; 0 before the first."""
        return self._now_ns

    def items(self) -> Iterator[LogItem]:
        """Give all items in the order in which they were written. A second call gives nothing."""
        return self._read(_ITEMS)

    def transactions(self) -> Iterator[NamedTransaction]:
        """Give only the transactions.

        A log is read once: call this, `items` or `evidence`, and only one of them.
        """
        for item in self._read({schemas.TRANSACTION}):
            if isinstance(item, NamedTransaction):
                yield item

    def evidence(self) -> Iterator[Chunk | Packet | WireEvent]:
        """Give only the captured bytes, and GAP events where the log is damaged.

        A log is read once: call this, `items` or `transactions`, and only one of them.
        """
        for item in self._read({schemas.CHUNK}):
            if not isinstance(item, NamedTransaction):
                yield item

    def close(self) -> None:
        self._stream.close()

    def _read_header(self, name: str) -> None:
        record = self._records.read()
        if record.opcode != Opcode.HEADER:
            raise self._records.damaged(record.offset, "the header record is missing")
        header = self._records.parse(record, Header.read)
        if header.profile != PROFILE:
            raise InputError(
                f"{name}: an MCAP file of profile {header.profile!r}, "
                f"not a log of mbtool (profile {PROFILE!r})"
            )

    def _check_version(self, name: str) -> None:
        version = self.capture.get("log_format", str(FORMAT_VERSION))
        if version != str(FORMAT_VERSION):
            raise InputError(
                f"{name}: log format {version}, from another version of mbtool; "
                f"this one reads format {FORMAT_VERSION}"
            )

    def _data_section(self, wait: Callable[[], bool] | None) -> Iterator[McapRecord]:
        """Yield the records before DataEnd, then check the rest of the file.

        With `wait`, a log that is still open is read again from its DataEnd until it is closed or
        `wait` returns False.
        """
        while True:
            record = self._records.read()
            if record.opcode != Opcode.DATA_END:
                yield record
                continue
            if wait is None:
                self._check_crc(record)
            following = self._records.read()
            self.closed = not self._is_open_end(following)
            if wait is None or self.closed:
                break
            if not wait():
                return
            self._records.seek(record.offset)
        if wait is None:
            while following.opcode != Opcode.FOOTER:
                following = self._records.read()
            self._records.read_magic()

    def _check_crc(self, data_end: McapRecord) -> None:
        if self._damage:
            return  # The CRC of the data section would only report the same damage again.
        try:
            self._records.check_crc(data_end)
        except DamageError as error:
            self._damage.add(error)

    def _is_open_end(self, record: McapRecord) -> bool:
        """True for the Footer of a log that is being written, or whose recorder was killed."""
        return record.opcode == Opcode.FOOTER and self._records.summary_start(record) == 0

    def _learn(self, record: McapRecord) -> bool:
        """Take the metadata of a record; return False instead if the record may hold items."""
        if record.opcode in _ITEM_OPCODES:
            return False
        try:
            self._learn_from(record)
        except DamageError as error:
            self._damage.add(error, len(record.content))
        return True

    def _learn_from(self, record: McapRecord) -> None:
        match record.opcode:
            case Opcode.METADATA:
                metadata = self._records.parse(record, Metadata.read)
                self._learn_metadata(metadata.name, metadata.metadata)
            case Opcode.ATTACHMENT:
                attachment = self._records.parse(record, Attachment.read)
                (crc,) = struct.unpack("<I", record.content[-4:])
                if crc not in (0, zlib.crc32(record.content[:-4])):
                    raise self._records.damaged(record.offset, "an attachment whose CRC is wrong")
                self.profiles[attachment.name] = attachment.data

    def _learn_metadata(self, name: str, values: dict[str, str]) -> None:
        match name:
            case layout.CAPTURE:
                self.capture.update(values)
            case layout.LINK:
                self.links[values.pop("name", "")] = values
            case layout.DEVICE:
                self.devices[values.get("who", "")] = values.get("profile", "")

    def _read(self, wanted: frozenset[str] | set[str]) -> Iterator[LogItem]:
        try:
            for record in self._data:
                if not self._learn(record):
                    yield from self._items_of(record, wanted)
        except InputError as end:
            yield from self._damage.take_gap(self._now_ns)
            if self._damage:
                raise self._damage.added_to(end) from end
            raise
        yield from self._damage.take_gap(self._now_ns)
        if self._damage:
            raise self._damage.error()

    def _items_of(self, record: McapRecord, wanted: frozenset[str] | set[str]) -> Iterator[LogItem]:
        """The items of a record, up to the place where it is damaged."""
        is_chunk = record.opcode == Opcode.CHUNK
        try:
            for inner in self._records.unpack_chunk(record) if is_chunk else (record,):
                for item in self._take(inner, wanted):
                    yield from self._damage.take_gap(self._now_ns)
                    yield item
        except DamageError as error:
            self._damage.add_hole(error, record.offset, len(record.content))

    def _take(self, record: McapRecord, wanted: frozenset[str] | set[str]) -> Iterator[LogItem]:
        match record.opcode:
            case Opcode.MESSAGE:
                yield from self._decode(record, wanted)
            case Opcode.SCHEMA:
                schema = self._records.parse(record, Schema.read)
                self._schemas[schema.id] = schema.name
            case Opcode.CHANNEL:
                channel = self._records.parse(record, Channel.read)
                schema_name = self._schemas.get(channel.schema_id)
                if schema_name is not None or not channel.schema_id:
                    self._channels[channel.id] = schema_name or ""

    def _decode(self, record: McapRecord, wanted: frozenset[str] | set[str]) -> Iterator[LogItem]:
        if len(record.content) < MESSAGE_HEAD.size:
            raise self._records.damaged(record.offset, "a message shorter than its header")
        channel_id, _, log_ns, _ = MESSAGE_HEAD.unpack_from(record.content)
        data = record.content[MESSAGE_HEAD.size :]
        schema = self._channels.get(channel_id)
        if schema is None:
            if not self._damage:
                what = f"a message of an unknown channel ({channel_id})"
                self._damage.add(self._records.damaged(record.offset, what))
            schema = self._channels[channel_id] = self._schema_of(data)
        if schema not in wanted:
            return
        try:
            message = self._decoders[schema].decode(data)
        except msgspec.MsgspecError as error:
            raise self._records.damaged(record.offset, f"no {schema}: {error}") from None
        self._now_ns = log_ns
        yield message if isinstance(message, NamedTransaction) else message.item()

    def _schema_of(self, data: bytes) -> str:
        """The schema of a message whose channel was in a skipped chunk; "" if it is no item.

        Each type of item has required fields that no other has, so decoding finds the type.
        """
        for schema, decoder in self._decoders.items():
            with suppress(msgspec.MsgspecError):
                decoder.decode(data)
                return schema
        return ""


def read_log(path: str | Path) -> Iterator[LogItem]:
    """Give all items of a log in the order in which they were written.

    Raises InputError if the file cannot be read or is not a log; CutError or DamageError if it is
    not whole, after the items that could be read.
    """
    with LogReader.open(path) as log:
        yield from log.items()


def follow(path: str | Path, wait: Callable[[], bool]) -> Iterator[LogItem]:
    """Read a log that is being written; give items as they reach the disk.

    `wait` is called at the end of the file. It returns True to look again, or False to end. The
    iterator also ends when the log is closed. Raises InputError if the file cannot be read or is
    not a log, CutError or DamageError if it is not whole.
    """
    # Unbuffered, as the writer replaces the end of the file, and a buffer would keep the old end.
    with _open(path, buffering=0) as stream:
        yield from LogReader(stream, str(path), wait=wait).items()


def _open(path: str | Path, buffering: int = -1) -> BinaryIO:
    try:
        return Path(path).open("rb", buffering=buffering)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be opened: {reason_of(error)}") from error
