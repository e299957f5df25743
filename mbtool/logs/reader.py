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

from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self, cast

from mcap.records import Attachment, Header, Metadata

from mbtool.core import Chunk, DamageError, InputError, Packet, WireEvent
from mbtool.core.closing import ClosesOnExit
from mbtool.core.errors import reason_of
from mbtool.devices import NamedTransaction
from mbtool.logs import layout, schemas
from mbtool.logs.damage import Damage
from mbtool.logs.healing import Hole, SoundRecords
from mbtool.logs.layout import EVIDENCE_ONLY, LIBRARY, PROFILE, READ_VERSIONS, Opcode
from mbtool.logs.message_decoder import MessageDecoder
from mbtool.logs.messages import DecodingMark
from mbtool.logs.records import RecordStream
from mbtool.logs.summary import begins_log, check_end, is_open_end

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.logs.messages import LogItem
    from mbtool.logs.records import ByteStream, McapRecord

MAX_KEPT = 32 << 20
_EVIDENCE = frozenset({schemas.CHUNK, schemas.EVIDENCE})
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

    def heard(self) -> Iterator[Chunk | Packet | WireEvent]:
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
