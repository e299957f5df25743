"""Unpacks an MCAP chunk, even if its header is damaged, and walks over its records."""

# Content of a chunk record, as mbtool writes it (MCAP specification, section Chunk):
#
#     start time   end time   unpacked size   CRC       compression   data length   data
#     8 bytes      8 bytes    8 bytes         4 bytes   4 + 4 bytes   8 bytes       a zstd frame
#
# A chunk without compression has no bytes in its field "compression", so its data begin 4 bytes
# earlier. The CRC is that of the unpacked data, and a zstd frame states its own unpacked size. So a
# chunk whose CRC matches is intact, even if its header or the header of its record is damaged. If
# the stored CRC and the computed one differ in one bit, the stored CRC is taken as damaged, not the
# data: a changed byte of the data gives such a CRC in only 32 of 4,294,967,296 cases.
#
# Limits, in unpacked bytes: MAX_RECORD for one chunk. For all chunks of a log together: MAX_RECORD,
# plus MAX_RATIO times the bytes of the log read so far, so that a small file cannot unpack for
# hours. Polling that repeats the same values is compressed to 1/60.

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import zstandard

from mbtool.logs.layout import MAX_RECORD, RECORD_HEAD

MAX_RATIO = 200

CHUNK_HEAD = struct.Struct("<QQQII")
"""The beginning of a chunk's content: start time, end time, unpacked size, CRC, and the length of
the field "compression"."""
DATA_LENGTH = struct.Struct("<Q")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
ZSTD_DATA_AT = CHUNK_HEAD.size + 4 + DATA_LENGTH.size
PLAIN_DATA_AT = CHUNK_HEAD.size + DATA_LENGTH.size


class Unpacker:
    """Decompresses the chunks of one log.

    A limit on the unpacked bytes protects against decompression bombs.
    """

    def __init__(self) -> None:
        self._zstd = zstandard.ZstdDecompressor()
        self._left = MAX_RECORD
        """The number of bytes that may still be unpacked before the limit is reached."""

    def allow(self, size: int) -> None:
        """Raise the limit on unpacked bytes by MAX_RATIO times `size`.

        Call this when `size` more bytes of the log file have been read.
        """
        self._left += MAX_RATIO * size

    def spend(self, size: int) -> bool:
        """Take `size` bytes from those that may still be unpacked, and return True.

        If fewer than `size` are left, the method takes none and returns False.
        """
        if size > self._left:
            return False
        self._left -= size
        return True

    def unpack(self, content: bytes) -> bytes:
        """Return the unpacked records of a chunk.

        `content` is the chunk record without its opcode and length.

        Raises ValueError if the chunk is damaged, too large or packed in another way than by zstd;
        the text of the error is for the user.
        """
        if len(content) < PLAIN_DATA_AT:
            raise ValueError("a record that ends too early")
        size, crc, packed = _fields(content)
        if packed:
            records = self._unpacked(content, size)
        elif size > MAX_RECORD or not self.spend(len(content)):
            raise ValueError(f"a chunk that cannot be unpacked: {MAX_RECORD} is the maximum")
        else:
            records = content[PLAIN_DATA_AT:]
        if crc and (crc ^ zlib.crc32(records)).bit_count() > 1:
            raise ValueError("a chunk whose CRC does not match")
        return records

    def _unpacked(self, content: bytes, size: int) -> bytes:
        frame = content[ZSTD_DATA_AT:]
        try:
            # If the frame states its own unpacked size, zstd ignores max_output_size. So the stated
            # size is compared with the limits before.
            stated = zstandard.get_frame_parameters(frame).content_size
            if stated in (0, zstandard.CONTENTSIZE_UNKNOWN):
                stated = size
            if stated > MAX_RECORD or not self.spend(stated + len(frame)):
                raise ValueError(f"a chunk of {stated} bytes from {len(frame)}, which is too many")
            return self._zstd.decompress(frame, max_output_size=stated, allow_extra_data=False)
        except zstandard.ZstdError as error:
            raise ValueError(f"a chunk that cannot be unpacked: {error}") from None


def data_length(content: bytes) -> int | None:
    """Compute the length (bytes) of a chunk's content from its field "data length".

    `content` is the beginning of the chunk's content: its first ZSTD_DATA_AT + 4 bytes, or all of a
    shorter one. Returns None if these bytes cannot be the beginning of a chunk.
    """
    if len(content) < PLAIN_DATA_AT:
        return None
    at = ZSTD_DATA_AT if is_zstd(content) else PLAIN_DATA_AT
    if at == PLAIN_DATA_AT and CHUNK_HEAD.unpack_from(content)[4]:
        return None
    (length,) = DATA_LENGTH.unpack_from(content, at - DATA_LENGTH.size)
    return at + int(length)


def is_zstd(content: bytes) -> bool:
    return content.startswith(ZSTD_MAGIC, ZSTD_DATA_AT)


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, begin, end) of each record in an unpacked chunk.

    `begin` and `end` are the offsets in `data` of the record's content. Raises ValueError after the
    last whole record if the data end inside one.
    """
    at = 0
    while at < len(data):
        body = at + RECORD_HEAD.size
        if body > len(data):
            raise ValueError("a chunk that ends inside a record")
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        at = body + length
        if at > len(data):
            raise ValueError("a chunk that ends inside a record")
        yield opcode, body, at


def _fields(content: bytes) -> tuple[int, int, bool]:
    """Return a chunk's unpacked size (bytes), its CRC, and True if it is packed with zstd.

    Raises ValueError if the chunk is packed in another way.
    """
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(content)
    if is_zstd(content):
        return size, crc, True
    name = content[CHUNK_HEAD.size : CHUNK_HEAD.size + min(name_length, 8)]
    if name == b"zstd":
        raise ValueError("a chunk that cannot be unpacked: its data are no zstd frame")
    if name:
        text = name.decode(errors="replace")
        raise ValueError(f"a chunk that cannot be unpacked: its compression is {text!r}, not zstd")
    return size, crc, False
