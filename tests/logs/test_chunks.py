"""Chunks that are unpacked, also where a field of their header is damaged."""

from __future__ import annotations

import zlib

import pytest
import zstandard
from mcap.records import Chunk, Metadata

from mbtool.logs.chunks import (
    CHUNK_HEAD,
    MAX_RATIO,
    ZSTD_DATA_AT,
    Unpacker,
    data_length,
    records_in,
)
from mbtool.logs.layout import MAX_RECORD, RECORD_HEAD, Opcode, pack_records

CONTENT = pack_records(Metadata("a", {}), Metadata("b", {"k": "v" * 50}))


@pytest.mark.parametrize("compression", ["", "zstd"])
def test_a_chunk_gives_its_records(compression: str) -> None:
    chunk = chunk_of(CONTENT, compression)
    assert Unpacker().unpack(chunk) == CONTENT
    assert data_length(chunk) == len(chunk)
    assert CHUNK_HEAD.unpack_from(chunk)[:2] == (5, 9)
    assert [opcode for opcode, _, _ in records_in(CONTENT)] == [Opcode.METADATA] * 2


def test_a_chunk_whose_frame_does_not_state_its_size_is_unpacked() -> None:
    compressor = zstandard.ZstdCompressor(write_content_size=False)
    chunk = chunk_of(CONTENT, "zstd", data=compressor.compress(CONTENT))
    assert Unpacker().unpack(chunk) == CONTENT


@pytest.mark.parametrize("at", range(ZSTD_DATA_AT))
def test_a_packed_chunk_is_whole_whichever_byte_of_its_header_has_a_changed_bit(at: int) -> None:
    chunk = bytearray(chunk_of(CONTENT, "zstd"))
    chunk[at] ^= 0x10
    assert Unpacker().unpack(bytes(chunk)) == CONTENT


@pytest.mark.parametrize(
    ("chunk", "message"),
    [
        (b"abc", "ends too early"),
        (lambda: chunk_of(b"abc", "lz4"), "its compression is 'lz4', not zstd"),
        (lambda: chunk_of(b"abc", "zstd", data=b"nonsense"), "no zstd frame"),
        (
            lambda: chunk_of(b"abc", "zstd", data=zstandard.compress(CONTENT)[:-1]),
            "cannot be unpacked",
        ),
        (lambda: chunk_of(b"abc", "", size=MAX_RECORD + 1), "is the maximum"),
        (lambda: chunk_of(CONTENT, "zstd", crc=zlib.crc32(CONTENT) ^ 3), "CRC does not match"),
        (lambda: chunk_of(CONTENT, "", crc=zlib.crc32(CONTENT) ^ 3), "CRC does not match"),
    ],
)
def test_a_damaged_chunk_is_refused_with_the_reason(chunk: object, message: str) -> None:
    content = chunk() if callable(chunk) else chunk
    assert isinstance(content, bytes)
    with pytest.raises(ValueError, match=message):
        Unpacker().unpack(content)


def test_chunks_that_amplify_are_unpacked_up_to_the_limit_and_then_refused() -> None:
    bomb = chunk_of(bytes(MAX_RECORD // 2), "zstd", crc=0)
    unpacker = Unpacker()
    assert len(unpacker.unpack(bomb)) == MAX_RECORD // 2
    with pytest.raises(ValueError, match="too many"):
        unpacker.unpack(bomb)
    unpacker.allow(MAX_RECORD // MAX_RATIO)
    assert len(unpacker.unpack(bomb)) == MAX_RECORD // 2


@pytest.mark.parametrize("data", [b"abc", RECORD_HEAD.pack(5, 1 << 63), CONTENT + b"\5"])
def test_the_records_of_a_chunk_end_with_an_error_inside_a_record(data: bytes) -> None:
    with pytest.raises(ValueError, match="ends inside a record"):
        list(records_in(data))


def chunk_of(
    content: bytes,
    compression: str,
    *,
    data: bytes | None = None,
    size: int | None = None,
    crc: int | None = None,
) -> bytes:
    if data is None:
        data = zstandard.compress(content) if compression == "zstd" else content
    chunk = Chunk(
        compression=compression,
        data=data,
        message_start_time=5,
        message_end_time=9,
        uncompressed_crc=zlib.crc32(content) if crc is None else crc,
        uncompressed_size=len(content) if size is None else size,
    )
    return pack_records(chunk)[RECORD_HEAD.size :]
