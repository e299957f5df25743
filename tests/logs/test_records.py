"""Records one by one, and a look at bytes before they are taken."""

from __future__ import annotations

import gzip
import io
import zlib

import pytest
from mcap.records import Metadata

from mbtool.core import CutError, InputError
from mbtool.logs.layout import MAGIC, MAX_RECORD, RECORD_HEAD, Opcode, data_end, pack_records
from mbtool.logs.records import McapRecord, RecordStream


def test_records_have_their_file_offset() -> None:
    stream = opened(MAGIC + pack_records(Metadata("a", {})) + data_end(0))
    stream.read_magic()
    first = stream.look_at_record()
    assert first is not None
    assert first[:2] == (8, Opcode.METADATA)
    stream.take(RECORD_HEAD.size + len(first.content))
    assert stream.look_at_record() == McapRecord(8 + 9 + 4 + 1 + 4, Opcode.DATA_END, bytes(4))


def test_looking_takes_nothing_and_taking_counts_into_the_crc() -> None:
    stream = opened(b"abcdef")
    assert stream.look(2, 3) == b"de"
    assert stream.look(9, 4) == b"ef"
    assert (stream.position, stream.end, stream.crc) == (0, 6, 0)
    stream.take(3)
    assert (stream.position, stream.crc) == (3, zlib.crc32(b"abc"))
    assert stream.look(1) == b"d"
    stream.restart_crc()
    stream.take(3)
    assert stream.crc == zlib.crc32(b"def")


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


def test_a_record_that_is_cut_is_none_and_its_cut_names_both_places() -> None:
    stream = opened(data_end(0)[:-1])
    assert stream.look_at_record() is None
    assert "cut off at byte 12, inside what begins at byte 0" in str(stream.cut(0))


def test_a_record_longer_than_the_bound_is_not_read() -> None:
    stream = opened(RECORD_HEAD.pack(Opcode.CHUNK, MAX_RECORD + 1) + bytes(100))
    assert stream.look_at_record() is None
    assert stream.end == RECORD_HEAD.size


@pytest.mark.parametrize("content", [b"", b"\x05", b"\xff\xff\xff\xff", b"\x01\x00\x00\x00\xff"])
def test_a_record_that_ends_too_early_is_damage(content: bytes) -> None:
    with pytest.raises(InputError, match="damaged at byte 5"):
        opened(b"").parse(McapRecord(5, Opcode.METADATA, content), Metadata.read)


def test_a_packed_file_that_is_cut_is_a_cut() -> None:
    whole = MAGIC + pack_records(Metadata("a", {"k": "".join(map(str, range(1000)))}))
    file = io.BytesIO(gzip.compress(whole)[:-200])
    with gzip.open(file) as unpacked:
        stream = RecordStream(unpacked, "x.mcap.gz")
        stream.read_magic()
        assert stream.look_at_record() is None
        assert isinstance(stream.cut(8), CutError)


def test_a_stream_that_cannot_be_read_is_an_input_error() -> None:
    with gzip.open(io.BytesIO(b"nonsense")) as unpacked:
        stream = RecordStream(unpacked, "x.mcap.gz")
        with pytest.raises(InputError, match="cannot be read: Not a gzipped file"):
            stream.read_magic()


class FailsLater(io.BytesIO):
    """A stream that gives its bytes, and then cannot be read."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if not data:
            raise InputError("x.mcap.gz: damaged, it cannot be unpacked")
        return data


def test_what_stood_before_an_unreadable_place_is_given_and_the_cut_is_its_error() -> None:
    stream = RecordStream(FailsLater(b"abc"), "x.mcap.gz")
    assert stream.look(10) == b"abc"
    assert str(stream.cut(0)) == "x.mcap.gz: damaged, it cannot be unpacked"


def opened(data: bytes) -> RecordStream:
    return RecordStream(io.BytesIO(data), "x.mcap")
