"""Reads the records of an MCAP file one by one, and can look at the bytes behind the next one."""

# The mcap package's StreamReader accepts a truncated field, trusts every length, and cannot wait
# for more bytes. So only its record classes are used here.
#
# For any bytes the only errors are CutError (the file ends inside a record), DamageError (a record
# contradicts itself) and InputError (another kind of file, or one that cannot be read). A record
# has at most MAX_RECORD bytes.
#
# Memory: the bytes that were read ahead and not consumed, at most one record and what a search for
# the next intact record (healing.py) reads ahead.

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from mbtool.core import CutError, DamageError, InputError
from mbtool.core.errors import reason_of
from mbtool.logs.layout import MAGIC, MAX_RECORD, RECORD_HEAD

_T = TypeVar("_T")


class ByteStream(Protocol):
    """The methods of a binary stream that reading a log needs."""

    def read(self, size: int, /) -> bytes: ...

    def seek(self, offset: int, /) -> int:
        """Go to an offset in bytes; only following a log that is still being written calls this."""
        ...

    def close(self) -> None: ...


class McapRecord(NamedTuple):
    """One record of an MCAP file."""

    offset: int
    """The file offset of the record."""
    opcode: int
    content: bytes
    """The bytes behind the opcode and the length; for a chunk that was checked, its unpacked
    records."""


class RecordStream:
    """Reads the records of a stream in order; `name` appears in error messages."""

    def __init__(self, stream: ByteStream, name: str) -> None:
        self._stream = stream
        self._name = name
        self._held = bytearray()
        """The bytes from `position` on that were read from the stream and not yet consumed."""
        self.position = 0
        """The file offset of the next byte to consume."""
        self.crc = 0
        """The CRC-32 of all bytes consumed so far, or since the last call of `restart_crc`."""
        self._end: InputError | None = None
        """The error that stopped reading the stream; None if there was none so far."""

    @property
    def end(self) -> int:
        """The file offset behind the last byte that was read ahead."""
        return self.position + len(self._held)

    def read_magic(self) -> None:
        """Read the magic bytes at the beginning or the end of the file.

        Raises InputError for a file of another kind, CutError for a file that ends inside the
        magic, DamageError for other bytes at its end.
        """
        at = self.position
        magic = self.look(len(MAGIC))
        if not magic and self._end is not None:
            raise self._end
        if not magic and at == 0:
            raise InputError(f"{self._name}: the file is empty")
        if not MAGIC.startswith(magic):
            if at == 0:
                raise InputError(f"{self._name}: not an MCAP file, so not a log")
            raise self.damaged(at, "the file does not end as an MCAP file does")
        if len(magic) < len(MAGIC):
            raise self.cut(at)
        self.take(len(MAGIC))

    def look_at_record(self) -> McapRecord | None:
        """Return the next record without consuming it.

        Returns None if the file ends inside it, or if it states more than MAX_RECORD bytes.
        """
        head = self.look(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            return None
        opcode, length = RECORD_HEAD.unpack(head)
        if length > MAX_RECORD:
            return None
        content = self.look(length, RECORD_HEAD.size)
        return McapRecord(self.position, opcode, content) if len(content) == length else None

    def look(self, size: int, ahead: int = 0) -> bytes:
        """Return `size` bytes that begin `ahead` bytes after the position, without consuming them.

        Returns fewer bytes only where the file ends or cannot be read further.
        """
        missing = ahead + size - len(self._held)
        if missing > 0:
            self._fill(missing)
        with memoryview(self._held) as held:
            return bytes(held[ahead : ahead + size])

    def take(self, size: int) -> None:
        """Consume the next `size` bytes, which `look` must have returned before."""
        with memoryview(self._held) as held:
            self.crc = zlib.crc32(held[:size], self.crc)
        del self._held[:size]
        self.position += size

    def restart_crc(self) -> None:
        self.crc = 0

    def ends_as_a_file(self) -> bool:
        """True if the bytes that were read ahead end with the magic bytes, as a whole file does."""
        return self._held.endswith(MAGIC)

    def seek(self, offset: int) -> None:
        """Go back to a file offset, to read what the recorder has since written there."""
        self._stream.seek(offset)
        self._held.clear()
        self.position = offset

    def parse(self, record: McapRecord, read: Callable[[ReadDataStream], _T]) -> _T:
        """Parse a record with `read`, the class method of one of the mcap package's record classes.

        Raises DamageError if the record is too short for its fields.
        """
        try:
            return read(ReadDataStream(io.BytesIO(record.content)))
        except (McapError, struct.error, ValueError, OverflowError) as error:
            raise self.damaged(record.offset, "a record that ends too early") from error

    def damaged(self, offset: int, what: str) -> DamageError:
        return DamageError(f"{self._name}: damaged at byte {offset}: {what}")

    def cut(self, offset: int) -> InputError:
        """Return the error for a file that ends, or cannot be read further, inside a record.

        `offset` is the file offset at which that record begins.
        """
        if self._end is not None:
            return self._end
        return CutError(
            f"{self._name}: cut off at byte {self.end}, inside what begins at byte {offset}; "
            "all before that was read"
        )

    def _fill(self, missing: int) -> None:
        while missing > 0 and self._end is None:
            try:
                piece = self._stream.read(missing)
            except EOFError:
                return  # A gzip or zstd file that was cut off.
            except InputError as error:
                self._end = error
                return
            except (OSError, ValueError) as error:
                self._end = InputError(f"{self._name}: cannot be read: {reason_of(error)}")
                return
            if not piece:
                return
            self._held += piece
            missing -= len(piece)
