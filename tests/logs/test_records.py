from __future__ import annotations

import gzip
import io
import zlib

import pytest
import zstandard
from mcap.records import Chunk, Metadata

from mbtool.core import CutError, InputError
from mbtool.logs.layout import MAGIC, MAX_RECORD, RECORD_HEAD, Opcode, data_end, footer, packed
from mbtool.logs.records import McapRecord, RecordStream


def test_records_have_their_file_offset() -> None:
    stream = opened(MAGIC + packed(Metadata("a", {})) + data_end(0))
    stream.read_magic()
    assert stream.read()[:2] == (8, Opcode.METADATA)
    assert stream.read() == McapRecord(8 + 9 + 4 + 1 + 4, Opcode.DATA_END, bytes(4))


def test_an_empty_file_is_said_to_be_empty() -> None:
    with pytest.raises(InputError, match=r"x\.mcap: the file is empty"):
        opened(b"").read_magic()


@pytest.mark.parametrize("data", [b"\xd4\xc3\xb2\xa1", b"\x89PNG\r\n\x1a\n", b"\x00" * 100])
def test_a_file_of_another_kind_is_told(data: bytes) -> None:
    with pytest.raises(InputError, match="not an MCAP file"):
        opened(data).read_magic()


@pytest.mark.parametrize("size", range(1, 8))
def test_a_magic_that_is_cut_is_told_as_a_cut(size: int) -> None:
    with pytest.raises(CutError, match=f"cut off at byte {size}"):
        opened(MAGIC[:size]).read_magic()


def test_a_record_that_is_cut_is_told_with_both_places() -> None:
    stream = opened(data_end(0) + data_end(0)[:-1])
    stream.read()
    with pytest.raises(CutError, match="cut off at byte 25, inside what begins at byte 13"):
        stream.read()


def test_a_record_longer_than_the_bound_is_not_read() -> None:
    stream = opened(RECORD_HEAD.pack(Opcode.CHUNK, MAX_RECORD + 1))
    with pytest.raises(InputError, match="damaged at byte 0: a record of 67108865 bytes"):
        stream.read()


@pytest.mark.parametrize("expected", [0, zlib.crc32(b"abc")])
def test_a_data_section_of_the_right_crc_passes(expected: int) -> None:
    stream = opened(b"abc" + data_end(expected))
    assert stream._read(3, 0) == b"abc"
    stream.check_crc(stream.read())


def test_a_data_section_of_another_crc_is_told() -> None:
    stream = opened(data_end(77))
    with pytest.raises(InputError, match="damaged at byte 0: the CRC of the data section"):
        stream.check_crc(stream.read())


@pytest.mark.parametrize("content", [b"", b"\x05", b"\xff\xff\xff\xff", b"\x01\x00\x00\x00\xff"])
def test_a_record_that_ends_too_early_is_damage(content: bytes) -> None:
    with pytest.raises(InputError, match="damaged at byte 5"):
        opened(b"").parse(McapRecord(5, Opcode.METADATA, content), Metadata.read)


def test_a_short_data_end_or_footer_is_damage() -> None:
    with pytest.raises(InputError, match="ends too early"):
        opened(b"").check_crc(McapRecord(0, Opcode.DATA_END, b"\x01"))
    with pytest.raises(InputError, match="ends too early"):
        opened(b"").summary_start(McapRecord(0, Opcode.FOOTER, b"\x01"))


def test_a_footer_tells_where_the_summary_starts() -> None:
    stream = opened(footer(77, 88))
    assert stream.summary_start(stream.read()) == 77


@pytest.mark.parametrize("compression", ["", "zstd"])
def test_a_chunk_gives_its_records(compression: str) -> None:
    content = packed(Metadata("a", {}), Metadata("b", {}))
    inner = list(opened(b"").unpack_chunk(chunk_of(content, compression)))
    assert [(record.offset, record.opcode) for record in inner] == [(7, Opcode.METADATA)] * 2


def test_a_chunk_whose_frame_does_not_state_its_size_is_unpacked() -> None:
    content = packed(Metadata("a", {}))
    compressor = zstandard.ZstdCompressor(write_content_size=False)
    record = chunk_of(content, "zstd", data=compressor.compress(content))
    assert len(list(opened(b"").unpack_chunk(record))) == 1


BOMB = zstandard.compress(bytes(1 << 24))


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (lambda: chunk_of(b"abc", "lz4"), "its compression is 'lz4', not zstd"),
        (lambda: chunk_of(b"abc", "zstd", data=b"nonsense"), "cannot be unpacked"),
        (lambda: chunk_of(b"abc", "zstd", data=BOMB), "another size than its record"),
        (lambda: chunk_of(b"abc", "", size=MAX_RECORD + 1), "is the maximum"),
        (lambda: chunk_of(b"abc", "", crc=1), "CRC does not match"),
        (lambda: chunk_of(b"abc", ""), "ends inside a record"),
        (lambda: chunk_of(RECORD_HEAD.pack(5, 1 << 63), ""), "ends inside a record"),
    ],
)
def test_a_damaged_chunk_is_told_with_its_place(record: object, message: str) -> None:
    assert callable(record)
    with pytest.raises(InputError, match=f"damaged at byte 7: .*{message}"):
        list(opened(b"").unpack_chunk(record()))


def test_a_packed_file_that_is_cut_is_a_cut() -> None:
    whole = MAGIC + packed(Metadata("a", {"k": "".join(map(str, range(1000)))}))
    file = io.BytesIO(gzip.compress(whole)[:-200])
    with gzip.open(file) as unpacked:
        stream = RecordStream(unpacked, "x.mcap.gz")
        stream.read_magic()
        with pytest.raises(CutError):
            stream.read()


def test_a_stream_that_cannot_be_read_is_an_input_error() -> None:
    with gzip.open(io.BytesIO(b"nonsense")) as unpacked:
        stream = RecordStream(unpacked, "x.mcap.gz")
        with pytest.raises(InputError, match="cannot be read: Not a gzipped file"):
            stream.read_magic()


def opened(data: bytes) -> RecordStream:
    return RecordStream(io.BytesIO(data), "x.mcap")


def chunk_of(
    content: bytes,
    compression: str,
    *,
    data: bytes | None = None,
    size: int | None = None,
    crc: int | None = None,
) -> McapRecord:
    if data is None:
        data = zstandard.compress(content) if compression == "zstd" else content
    chunk = Chunk(
        compression=compression,
        data=data,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=zlib.crc32(content) if crc is None else crc,
        uncompressed_size=len(content) if size is None else size,
    )
    return McapRecord(7, Opcode.CHUNK, packed(chunk)[RECORD_HEAD.size :])
