"""Reads the records of an MCAP file, whole ones only, however the file was damaged."""

# The stock StreamReader takes what is left of a file for a whole field, trusts every length, and
# cannot wait for more, so only its record classes are used here.
#
# Whatever the bytes, what is raised is CutError (the file ends inside a record), DamageError (a
# record says what cannot be) or InputError (a file of another kind, one that cannot be read). A
# record is at most MAX_RECORD long, packed or not.

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
from mbtool.logs.layout import MAGIC, MAX_RECORD, RECORD_HEAD

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_T = TypeVar("_T")

_DATA_END = struct.Struct("<I")
_FOOTER = struct.Struct("<QQI")


class ByteStream(Protocol):
    """What a log is read from."""

    def read(self, size: int, /) -> bytes: ...

    def seek(self, offset: int, /) -> int:
        """Used by `follow` only."""
        ...

    def close(self) -> None: ...


class McapRecord(NamedTuple):
    """One record of the file or of a chunk."""

    offset: int
    """Where it begins in the file; for a record in a chunk, where the chunk begins."""
    opcode: int
    content: bytes


class RecordStream:
    """Gives the records of a stream in order; `name` stands in errors."""

    def __init__(self, stream: ByteStream, name: str) -> None:
        self._stream = stream
        self._name = name
        self._position = 0
        self._crc = 0
        self._crc_before = 0
        """Of all that was read before the last record."""

    def read_magic(self) -> None:
        """Raise InputError where a file of another kind begins, CutError where it ends early."""
        at = self._position
        magic = self._read(len(MAGIC), at, partly=True)
        if not magic and at == 0:
            raise InputError(f"{self._name}: the file is empty")
        if not MAGIC.startswith(magic):
            if at == 0:
                raise InputError(f"{self._name}: no MCAP file, so no log")
            raise self.damaged(at, "the file does not end as an MCAP file does")
        if len(magic) < len(MAGIC):
            raise self._cut(at)

    def read(self) -> McapRecord:
        """The next record. Raises CutError; DamageError where what follows cannot be found."""
        offset = self._position
        self._crc_before = self._crc
        opcode, length = RECORD_HEAD.unpack(self._read(RECORD_HEAD.size, offset))
        if length > MAX_RECORD:
            raise self.damaged(
                offset,
                f"a record of {length} bytes; {MAX_RECORD} is the most, and what follows is lost",
            )
        return McapRecord(offset, opcode, self._read(length, offset))

    def check_crc(self, data_end: McapRecord) -> None:
        """Raise DamageError where a DataEnd, just read, says that what was before it is damaged."""
        expected = self._unpack(_DATA_END, data_end)[0]
        if expected not in (0, self._crc_before):
            raise self.damaged(data_end.offset, "the bytes before are not those that were written")

    def seek(self, offset: int) -> None:
        """Go to an offset, so that what has been written there meanwhile is read."""
        self._stream.seek(offset)
        self._position = offset

    def parse(self, record: McapRecord, read: Callable[[ReadDataStream], _T]) -> _T:
        """Take a record apart with one of mcap's classes. Raises DamageError."""
        try:
            return read(ReadDataStream(io.BytesIO(record.content)))
        except (McapError, struct.error, ValueError, OverflowError) as error:
            raise self.damaged(record.offset, "a record that ends too early") from error

    def summary_start(self, footer: McapRecord) -> int:
        """Where a Footer says that the summary starts; 0 where there is none."""
        return self._unpack(_FOOTER, footer)[0]

    def unpack_chunk(self, record: McapRecord) -> Iterator[McapRecord]:
        """The records of a chunk. Raises DamageError."""
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
                piece = b""  # A packed file that was cut.
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or str(error)
                raise InputError(f"{self._name}: cannot be read: {reason}") from error
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
        raise ValueError(f"{chunk.uncompressed_size} bytes; {MAX_RECORD} is the most")
    if chunk.compression == "":
        return chunk.data
    if chunk.compression != "zstd":
        raise ValueError(f"it is packed with {chunk.compression!r}; zstd would be right")
    # A frame that states its own size is unpacked to that size whatever the limit is.
    stated = zstandard.get_frame_parameters(chunk.data).content_size
    if stated not in (0, zstandard.CONTENTSIZE_UNKNOWN, chunk.uncompressed_size):
        raise ValueError("its size is not what its record says")
    return zstandard.ZstdDecompressor().decompress(
        chunk.data, max_output_size=chunk.uncompressed_size
    )
