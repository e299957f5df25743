"""Reads the intact records of a damaged log, repairs record heads, and skips the rest."""

# A record is sound (intact) if the lengths of its fields add up to its own length, and if its CRC
# matches where it has one. A record without such fields is sound if the bytes behind it may be the
# head of a record.
#
# If a record is not sound, these are tried in order:
#
#   1. Its opcode or a length may be damaged. If the bytes are a sound record of another kind or of
#      another length, that record is returned. A chunk and an attachment prove by their CRC that
#      they are sound, other records by a valid head of the record behind them.
#   2. If a record may begin at the end that its length states, the record is skipped, and reading
#      goes on there.
#   3. Otherwise the next record that proves to be sound is searched for, byte by byte.
#
# Skipped bytes are returned as a Hole. If nothing is found up to the end of the file, the error
# says whether the file was cut off.
#
# Memory: one record, the records of one chunk, and SEARCH_BYTES. Time: bytes that are checked as
# possible records count against the limit on unpacked bytes in chunks.py, which grows with the
# bytes of the log read so far.

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from typing import NamedTuple

from mcap.records import Metadata

from mbtool.core import DamageError, InputError
from mbtool.logs.chunks import DATA_LENGTH, ZSTD_DATA_AT, Unpacker, data_length, is_zstd
from mbtool.logs.layout import MAGIC, MAX_RECORD, PRIVATE, RECORD_HEAD, Opcode
from mbtool.logs.records import McapRecord, RecordStream

SEARCH_BYTES = 64 * 1024

_HEAD = RECORD_HEAD.size
_BLOCK_LENGTH = struct.Struct("<I")
_CRC = struct.Struct("<I")
_FOOTER_CONTENT = 20
_DATA_END_CONTENT = 4
_MESSAGE_FIELDS = 22
_LAST_OPCODE = 0x0F

_BLOCKS = {
    Opcode.HEADER: (0, 2),
    Opcode.SCHEMA: (2, 3),
    Opcode.CHANNEL: (4, 3),
    Opcode.MESSAGE_INDEX: (2, 1),
    Opcode.ATTACHMENT: (16, 2),
    Opcode.METADATA: (0, 2),
}
"""For each kind of record: the number of bytes before its blocks, and the number of its blocks. A
block is a 4-byte length followed by that many bytes. An attachment's data and CRC follow its
blocks."""

_FIXED = {Opcode.FOOTER: _FOOTER_CONTENT, Opcode.DATA_END: _DATA_END_CONTENT}

_REPAIRABLE = (
    Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.MESSAGE_INDEX, Opcode.DATA_END,
)  # fmt: skip

_WITHOUT_ITEMS = frozenset((Opcode.ATTACHMENT, Opcode.METADATA, Opcode.MESSAGE_INDEX))

_SUMMARY = frozenset(
    (
        Opcode.FOOTER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX,
        Opcode.STATISTICS, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
    )
)  # fmt: skip
"""The kinds of records that can follow the DataEnd record."""

_ONLY_IN_SUMMARY = _SUMMARY - {Opcode.FOOTER, Opcode.SCHEMA, Opcode.CHANNEL}

# The places where a record that can be verified may begin: one of five opcodes, and behind it a
# length below 80 MiB.
_CANDIDATE = re.compile(rb"(?=[\x02\x06\x09\x0c\x0f].{3}[\0-\x04]\0{4})", re.DOTALL)


class Hole(NamedTuple):
    """A range of damaged bytes that the reader skips, from file offset `offset` up to `end`."""

    offset: int
    end: int
    error: DamageError
    has_items: bool = True
    """False if the bytes are a record that holds no message: metadata, an attachment, an index."""


class SoundRecords:
    """Reads the data section of a log; returns intact records, and holes for the skipped bytes.

    A damaged record that could be restored without a loss is returned as intact; `repaired` is then
    called with an error that describes the damage.
    """

    def __init__(self, records: RecordStream, repaired: Callable[[DamageError], None]) -> None:
        self._records = records
        self._repaired = repaired
        self._unpacker = Unpacker()
        self._why = ""
        """The reason, as a text for the user, why the record that was checked last is not intact;
        "" before the first such record."""
        self.crc_before = 0
        """The CRC of all bytes of the file before the record that was returned last."""

    def read(self) -> McapRecord | Hole:
        """Return the next intact record (a chunk unpacked), or a hole for skipped bytes.

        Raises CutError where the file ends without a DataEnd record, DamageError where no further
        record can be found. Both name the file offset.
        """
        self.crc_before = self._records.crc
        self._why = "a record of a wrong length"
        head = self._records.look(_HEAD)
        is_allowed = len(head) < _HEAD or self._unpacker.spend(RECORD_HEAD.unpack(head)[1])
        record = self._records.look_at_record() if is_allowed else None
        if record is not None:
            sound = self._sound(record)
            if sound is not None:
                self._take(_HEAD + len(record.content))
                return sound
        return self._corrected_record(record) or self._passed_over(record) or self._search()

    def search(self) -> Hole:
        """Skip to the next record that can be verified, and return the skipped bytes as a hole.

        A record is verified by its CRC, or by a valid head of the record behind it.
        """
        self._why = "no record"
        return self._search()

    def _take(self, size: int) -> None:
        self._records.take(size)
        self._unpacker.allow(size)

    def _sound(self, record: McapRecord) -> McapRecord | None:
        """Return the record if it is intact, with a chunk unpacked; otherwise None."""
        opcode, content = record.opcode, record.content
        if opcode in _ONLY_IN_SUMMARY or not opcode:
            self._why = f"a record of kind {opcode:02X}H in a wrong place"
            return None
        if opcode == Opcode.CHUNK:
            return self._sound_chunk(record)
        if opcode in _BLOCKS or opcode in _FIXED:
            return record if self._is_sound(opcode, len(content)) else None
        if opcode == Opcode.MESSAGE and len(content) < _MESSAGE_FIELDS:
            self._why = "a message shorter than its header"
            return None
        if opcode == Opcode.MESSAGE and _is_index(content):
            return None  # A message index with one wrong bit in its opcode.
        if opcode == PRIVATE and not content.strip(b"\0"):
            return record  # A filler record of zeros. The record behind it may be damaged.
        if not self._may_begin(_HEAD + len(content)):
            return None
        # One changed bit in the opcode can turn a chunk into a kind of record that readers ignore.
        # So zstd data under such an opcode are not accepted.
        return None if is_zstd(content) and opcode != Opcode.MESSAGE else record

    def _sound_chunk(self, record: McapRecord) -> McapRecord | None:
        try:
            data = self._unpacker.unpack(record.content)
        except ValueError as error:
            self._why = str(error)
            return None
        if data_length(record.content) != len(record.content):
            return None
        return record._replace(content=data)

    def _is_sound(self, opcode: int, length: int) -> bool:
        if self._length_by_fields(opcode, 0) != length:
            return False
        if opcode != Opcode.ATTACHMENT:
            return True
        self._why = "an attachment whose CRC is wrong"
        return self._attachment_crc(0, length) is not False

    def _corrected_record(self, record: McapRecord | None) -> McapRecord | None:
        """Return the record at the current position with its opcode or length corrected.

        `record` is that record as it was read; None if its length is too long for the file or for
        the limits. Returns None if no other opcode or length makes the record intact.
        """
        offset, why = self._records.position, self._why
        head = self._records.look(_HEAD)
        stated = len(record.content) if record is not None else None
        kinds = sorted(_REPAIRABLE, key=lambda kind: kind != head[0]) if head else ()
        for opcode in kinds:
            for length in dict.fromkeys((self._length_by_fields(opcode, 0), stated)):
                content = self._proven(opcode, 0, length)
                if content is not None and length is not None:
                    self._take(_HEAD + length)
                    self._repaired(self._records.damaged(offset, "the head of a record"))
                    return McapRecord(offset, opcode, content)
        self._why = why
        return None

    def _passed_over(self, record: McapRecord | None) -> Hole | None:
        """Skip the damaged record at the current position, and return it as a hole.

        Returns None, and skips nothing, if the bytes behind the record cannot be the head of
        another one, or if `record` is None because its length is too long.
        """
        if record is None or not self._may_begin(_HEAD + len(record.content)):
            return None
        self._take(_HEAD + len(record.content))
        hole = self._hole(record.offset)
        return hole._replace(has_items=record.opcode not in _WITHOUT_ITEMS)

    def _search(self) -> Hole:
        start, why = self._records.position, self._why
        ahead = 1
        while True:
            window = self._records.look(SEARCH_BYTES + _HEAD, ahead)
            for match in _CANDIDATE.finditer(window, 0, SEARCH_BYTES + _HEAD):
                at = ahead + match.start()
                if match.start() < SEARCH_BYTES and self._verifiable_record_begins_at(at):
                    self._take(at)
                    self._why = why
                    return self._hole(start)
            if len(window) < SEARCH_BYTES + _HEAD:
                raise self._nothing_found(start, why)
            self._take(SEARCH_BYTES)

    def _nothing_found(self, start: int, why: str) -> InputError:
        if self._records.ends_as_a_file():
            return self._records.damaged(start, f"{why}; the rest is lost")
        return self._records.cut(start)

    def _hole(self, start: int) -> Hole:
        end = self._records.position
        return Hole(start, end, self._records.damaged(start, self._why))

    def _verifiable_record_begins_at(self, ahead: int) -> bool:
        """True if a record that can be verified begins `ahead` bytes after the current position."""
        opcode, length = RECORD_HEAD.unpack(self._records.look(_HEAD, ahead))
        if self._length_by_fields(opcode, ahead) != length:
            return False
        if opcode == Opcode.FOOTER:
            return self._records.look(len(MAGIC), ahead + _HEAD + length) == MAGIC
        return self._proven(opcode, ahead, length) is not None

    def _proven(self, opcode: int, ahead: int, length: int | None) -> bytes | None:
        """Return the content of the record that begins `ahead` bytes after the current position.

        `opcode` and `length` (of the content, in bytes) are tried values; those in the record's
        head may be damaged. A `length` of None is unknown. The content of a chunk is returned
        unpacked. Returns None if the record cannot be verified with these values.
        """
        if length is None or length > MAX_RECORD or not self._unpacker.spend(length):
            return None
        content = self._records.look(length, ahead + _HEAD)
        if len(content) < length:
            return None
        end = ahead + _HEAD + length
        match opcode:
            case Opcode.CHUNK:
                return self._proven_chunk(content, end)
            case Opcode.ATTACHMENT:
                is_proven = self._attachment_crc(ahead, length) is True
            case Opcode.METADATA:
                is_proven = self._is_metadata(content) and self._may_begin(end)
            case Opcode.MESSAGE_INDEX:
                is_proven = self._length_by_fields(opcode, ahead) == length
                is_proven = is_proven and (length - 6) % 16 == 0 and self._may_begin(end)
            case Opcode.DATA_END:
                head = self._records.look(1, end)
                is_proven = bool(head) and head[0] in _SUMMARY and self._may_begin(end)
            case _:
                is_proven = False
        return content if is_proven else None

    def _proven_chunk(self, content: bytes, end: int) -> bytes | None:
        has_crc = content[24:28] != bytes(4)
        if not (has_crc or (is_zstd(content) and self._may_begin(end))):
            return None
        try:
            return self._unpacker.unpack(content)
        except ValueError:
            return None

    def _is_metadata(self, content: bytes) -> bool:
        if content[4:11] != b"mbtool.":
            return False
        try:
            self._records.parse(McapRecord(0, Opcode.METADATA, content), Metadata.read)
        except DamageError:
            return False
        return True

    def _attachment_crc(self, ahead: int, length: int) -> bool | None:
        """True if an attachment's CRC matches, None if the attachment has no CRC, otherwise False.

        The record begins `ahead` bytes after the current position; its content has `length` bytes.
        """
        if length < _CRC.size or not self._unpacker.spend(length):
            return False
        content = self._records.look(length, ahead + _HEAD)
        if len(content) < length:
            return False
        (crc,) = _CRC.unpack_from(content, length - _CRC.size)
        return bool(crc == zlib.crc32(content[: -_CRC.size])) if crc else None

    def _may_begin(self, ahead: int) -> bool:
        """True if a record may begin `ahead` bytes after the current position.

        Also True if the file is cut off before the end of that record's head.
        """
        head = self._records.look(_HEAD, ahead)
        if len(head) < _HEAD and self._records.ends_as_a_file():
            return False
        if head and not (0 < head[0] <= _LAST_OPCODE or head[0] >= PRIVATE):
            return False
        # If the file is cut off inside the head, the length is missing and cannot be checked.
        return len(head) < _HEAD or RECORD_HEAD.unpack(head)[1] <= MAX_RECORD

    def _length_by_fields(self, opcode: int, ahead: int) -> int | None:
        """Compute a record's content length (bytes) from the lengths of its fields.

        The record begins `ahead` bytes after the current position. Returns None if a record of this
        kind, such as a message, has no such fields, or if the file ends inside them.
        """
        if opcode in _FIXED:
            return _FIXED[Opcode(opcode)]
        ahead += _HEAD
        if opcode == Opcode.CHUNK:
            return data_length(self._records.look(ZSTD_DATA_AT + 4, ahead))
        if opcode not in _BLOCKS:
            return None
        at, blocks = _BLOCKS[Opcode(opcode)]
        for _ in range(blocks):
            block = self._records.look(_BLOCK_LENGTH.size, ahead + at)
            if len(block) < _BLOCK_LENGTH.size:
                return None
            at += _BLOCK_LENGTH.size + _BLOCK_LENGTH.unpack(block)[0]
            if at > MAX_RECORD:
                return None
        if opcode != Opcode.ATTACHMENT:
            return at
        data = self._records.look(DATA_LENGTH.size, ahead + at)
        if len(data) < DATA_LENGTH.size:
            return None
        return at + DATA_LENGTH.size + int(DATA_LENGTH.unpack(data)[0]) + _CRC.size


def _is_index(content: bytes) -> bool:
    """True if the content of a record with the opcode of a message is that of a message index.

    One changed bit turns the one opcode into the other.
    """
    (size,) = _BLOCK_LENGTH.unpack_from(content, 2)
    is_whole = size == len(content) - 6 and size % 16 == 0
    return is_whole and content[_MESSAGE_FIELDS : _MESSAGE_FIELDS + 1] not in (b"{", b"\x09")
