"""Reads the complete records of an MCAP file, even if the file is damaged."""

# The mcap package's StreamReader accepts a truncated field, trusts every length, and cannot wait
# for more bytes. So only its record classes are used here.
#
# For any bytes the only errors are CutError (the file ends inside a record), DamageError (a record
# contradicts itself) and InputError (another kind of file, or one that cannot be read). A record
# has at most MAX_RECORD bytes, compressed or not.

from __future__ import annotations

import io
import struct
import zlib
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Chunk

from mbtool.core import CutError, DamageError, InputError
from mbtool.core.errors import reason_of
from mbtool.logs.layout import MAGIC, MAX_RECORD, RECORD_HEAD

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_T = TypeVar("_T")

_DATA_END = struct.Struct("<I")
_FOOTER = struct.Struct("<QQI")


class ByteStream(Protocol):
    """A source of a log's bytes."""

    def read(self, size: int, /) -> bytes: ...

    def seek(self, offset: int, /) -> int:
        """Go to an offset in bytes; only `follow` calls this."""
        ...

    def close(self) -> None: ...


class McapRecord(NamedTuple):
    """One record of the file or of a chunk."""

    offset: int
    """The file offset of the record; for a record in a chunk, of the chunk."""
    opcode: int
    content: bytes


class RecordStream:
    """Reads the records of a stream in order; `name` stands in errors."""

    def __init__(self, stream: ByteStream, name: str) -> None:
        self._stream = stream
        self._name = name
        self._position = 0
        self._crc = 0
        self._crc_before = 0
        """The CRC of all bytes before the record that was read last."""

    def read_magic(self) -> None:
        """Read the magic bytes at the beginning or the end of the file.

        Raises InputError for a file of another kind, CutError for a file that ends inside the
        magic, DamageError for other bytes at its end.
        """
        at = self._position
        magic = self._read(len(MAGIC), at, partly=True)
        if not magic and at == 0:
            raise InputError(f"{self._name}: the file is empty")
        if not MAGIC.startswith(magic):
            if at == 0:
                raise InputError(f"{self._name}: not an MCAP file, so not a log")
            raise self.damaged(at, "the file does not end as an MCAP file does")
        if len(magic) < len(MAGIC):
            raise self._cut(at)

    def read(self) -> McapRecord:
        """Return the next record.

        Raises CutError if the file ends inside it, DamageError if its length is above MAX_RECORD.
        """
        offset = self._position
        self._crc_before = self._crc
        opcode, length = RECORD_HEAD.unpack(self._read(RECORD_HEAD.size, offset))
        if length > MAX_RECORD:
            raise self.damaged(
                offset,
                f"a record of {length} bytes; {MAX_RECORD} is the maximum, and the rest is lost",
            )
        return McapRecord(offset, opcode, self._read(length, offset))

    def check_crc(self, data_end: McapRecord) -> None:
        """Check the CRC of all bytes before a DataEnd, which must be the record read last.

        Raises DamageError if they do not match the CRC in the DataEnd.
        """
        expected = self._unpack(_DATA_END, data_end)[0]
        if expected not in (0, self._crc_before):
            raise self.damaged(data_end.offset, "the CRC of the data section does not match")

    def seek(self, offset: int) -> None:
        """Go back to an offset, to read what was written there meanwhile."""
        self._stream.seek(offset)
        self._position = offset

    def parse(self, record: McapRecord, read: Callable[[ReadDataStream], _T]) -> _T:
        """Parse a record with `read`, the method of one of mcap's classes.

        Raises DamageError if the record is too short for its fields.
        """
        try:
            return read(ReadDataStream(io.BytesIO(record.content)))
        except (McapError, struct.error, ValueError, OverflowError) as error:
            raise self.damaged(record.offset, "a record that ends too early") from error

    def summary_start(self, footer: McapRecord) -> int:
        """Return the offset of the summary that a Footer gives; 0 if there is no summary.

        Raises DamageError if the Footer is too short.
        """
        return self._unpack(_FOOTER, footer)[0]

    def unpack_chunk(self, record: McapRecord) -> Iterator[McapRecord]:
        """Give the records of a chunk.

        Raises DamageError if the chunk cannot be unpacked, has a wrong CRC or ends inside a record.
        """
        chunk = self.parse(record, Chunk.read)
        try:
            data = _decompress(chunk)
        except (ValueError, zstandard.ZstdError) as error:
            raise self.damaged(record.offset, f"a chunk that cannot be unpacked: {error}") from None
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise self.damaged(record.offset, "a chunk whose CRC does not match")
        at = 0
        while at < len(data):
            body = at + RECORD_HEAD.size
            if body > len(data):
                raise self.damaged(record.offset, "a chunk that ends inside a record")
            opcode, length = RECORD_HEAD.unpack_from(data, at)
            at = body + length
            if at > len(data):
                raise self.damaged(record.offset, "a chunk that ends inside a record")
            yield McapRecord(record.offset, opcode, data[body:at])

    def damaged(self, offset: int, what: str) -> DamageError:
        return DamageError(f"{self._name}: damaged at byte {offset}: {what}")

    def _cut(self, offset: int) -> CutError:
        return CutError(
            f"{self._name}: cut off at byte {self._position}, inside what begins at byte {offset}; "
            "all before that was read"
        )

    def _unpack(self, layout: struct.Struct, record: McapRecord) -> tuple[int, ...]:
        if len(record.content) < layout.size:
            raise self.damaged(record.offset, "a record that ends too early")
        return layout.unpack_from(record.content)

    def _read(self, size: int, start: int, *, partly: bool = False) -> bytes:
        pieces = []
        missing = size
        while missing:
            try:
                piece = self._stream.read(missing)
            except EOFError:
                piece = b""  # A compressed file that was cut off.
            except (OSError, ValueError) as error:
                raise InputError(f"{self._name}: cannot be read: {reason_of(error)}") from error
            if not piece:
                break
            pieces.append(piece)
            missing -= len(piece)
            self._position += len(piece)
            self._crc = zlib.crc32(piece, self._crc)
        data = b"".join(pieces)
        if missing and not partly:
            raise self._cut(start)
        return data


def _decompress(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > MAX_RECORD:
        raise ValueError(f"{chunk.uncompressed_size} bytes; {MAX_RECORD} is the maximum")
    if chunk.compression == "":
        return chunk.data
    if chunk.compression != "zstd":
        raise ValueError(f"its compression is {chunk.compression!r}, not zstd")
    # zstd unpacks a frame that states its own size to that size, regardless of the limit.
    stated = zstandard.get_frame_parameters(chunk.data).content_size
    if stated not in (0, zstandard.CONTENTSIZE_UNKNOWN, chunk.uncompressed_size):
        raise ValueError("its frame states another size than its record")
    return zstandard.ZstdDecompressor().decompress(
        chunk.data, max_output_size=chunk.uncompressed_size
    )
