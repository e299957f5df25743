from __future__ import annotations

import io
import zlib
from typing import TYPE_CHECKING, TypeVar

import pytest
from mcap.data_stream import ReadDataStream
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from mbtool.logs.complete_file import CompleteFile
from mbtool.logs.container import CHUNK_SIZE, MAX_TIME, Container
from mbtool.logs.creating import create_file
from mbtool.logs.layout import MAGIC, RECORD_HEAD
from tests.logs.test_complete_file import HEAD, SCHEMA

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_T = TypeVar("_T")


class Log:
    """A container in a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file = CompleteFile(create_file(path), str(path), HEAD)
        self.container = Container(self.file)

    def finish(self) -> bytes:
        self.container.finish()
        self.file.close()
        return self.path.read_bytes()


@pytest.fixture
def log(tmp_path: Path) -> Log:
    return Log(tmp_path / "x.mcap")


def test_the_stock_reader_finds_messages_by_topic_and_time_through_the_indexes(log: Log) -> None:
    one = log.container.add_topic("/one", SCHEMA)
    two = log.container.add_topic("/two", SCHEMA)
    for number in range(10):
        log.container.add_message(one, number, number, b"%d" % number)
        log.container.add_message(two, number, number, b"%d" % -number)
        if number % 3 == 0:
            log.container.flush(sync=False)
    reader = make_reader(io.BytesIO(log.finish()), validate_crcs=True)
    assert isinstance(reader, SeekingReader)
    found = reader.iter_messages(topics=["/two"], reverse=True)
    assert [message.data for _, _, message in found] == [b"%d" % -number for number in range(10)][
        ::-1
    ]


def test_message_indexes_point_at_the_messages(log: Log) -> None:
    one = log.container.add_topic("/one", SCHEMA)
    two = log.container.add_topic("/two", SCHEMA)
    for number in range(6):
        log.container.add_message(two if number % 3 else one, number, number, b"%d" % number)
    data = log.finish()
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    (chunk_index,) = summary.chunk_indexes
    chunk = record_at(data, chunk_index.chunk_start_offset, Chunk.read)
    content, _ = get_chunk_data_stream(chunk, validate_crc=True)
    unpacked = content.read(chunk.uncompressed_size)
    found = {}
    for channel, offset in chunk_index.message_index_offsets.items():
        index = record_at(data, offset, MessageIndex.read)
        assert index.channel_id == channel
        found[channel] = [unpacked[at + 9 + 22 :][:1] for _, at in index.records]
    assert found == {1: [b"0", b"3"], 2: [b"1", b"2", b"4", b"5"]}


def test_the_summary_counts_what_is_in_the_file(log: Log) -> None:
    topic = log.container.add_topic("/one", SCHEMA)
    log.container.add_topic("/two", SCHEMA)
    log.container.add_metadata("m", {"key": "value"})
    for number in (5, 3, 9):
        log.container.add_message(topic, number, number, b"{}")
        log.container.flush(sync=False)
    log.container.add_attachment("a", "text/plain", b"text")
    summary = make_reader(io.BytesIO(log.finish())).get_summary()
    assert summary is not None
    statistics = summary.statistics
    assert statistics is not None
    assert statistics.message_count == 3
    assert statistics.channel_message_counts == {1: 3}
    assert (statistics.message_start_time, statistics.message_end_time) == (3, 9)
    assert (statistics.chunk_count, len(summary.chunk_indexes)) == (3, 3)
    assert (statistics.schema_count, statistics.channel_count) == (1, 2)
    assert (statistics.metadata_count, statistics.attachment_count) == (1, 1)


def test_the_stock_reader_finds_metadata_and_attachments(log: Log) -> None:
    log.container.add_metadata("m", {"key": "välue"})
    log.container.add_attachment("a", "text/plain", b"text")
    data = log.finish()
    reader = make_reader(io.BytesIO(data))
    assert [record.metadata for record in reader.iter_metadata()] == [{"key": "välue"}]
    assert [record.data for record in reader.iter_attachments()] == [b"text"]


def test_every_crc_is_right(log: Log) -> None:
    topic = log.container.add_topic("/one", SCHEMA)
    log.container.add_message(topic, 1, 1, b"{}")
    data = log.finish()
    assert list(StreamReader(io.BytesIO(data), validate_crcs=True).records)
    at = data.index(b"/one", len(MAGIC) + 100)  # In the summary, outside the zstd chunk.
    wrong = data[:at] + b"/two" + data[at + 4 :]
    assert summary_crc(data) == stated_summary_crc(data)
    assert summary_crc(wrong) != stated_summary_crc(wrong)


def test_a_chunk_goes_to_the_file_when_it_is_full(log: Log) -> None:
    topic = log.container.add_topic("/one", SCHEMA)
    message = bytes(CHUNK_SIZE // 10)
    for number in range(25):
        log.container.add_message(topic, number, number, message)
    with log.path.open("rb") as stream:
        on_disk = sum(1 for _ in make_reader(stream).iter_messages())
    assert on_disk == 20
    assert log.container.pending
    log.finish()


def test_records_keep_the_order_in_which_they_were_added(log: Log) -> None:
    topic = log.container.add_topic("/one", SCHEMA)
    log.container.add_message(topic, 1, 1, b"{}")
    log.container.add_metadata("m", {})
    log.container.add_message(topic, 2, 2, b"{}")
    records = StreamReader(io.BytesIO(log.finish())).records
    kinds = [type(record).__name__ for record in records]
    assert [kind for kind in kinds if kind in ("Message", "Metadata")] == [
        "Message",
        "Metadata",
        "Message",
    ]


@pytest.mark.parametrize(("given", "written"), [(-1, 0), (MAX_TIME + 1, MAX_TIME)])
def test_a_time_outside_the_range_of_mcap_is_set_to_the_limit(
    log: Log, given: int, written: int
) -> None:
    topic = log.container.add_topic("/one", SCHEMA)
    log.container.add_message(topic, given, given, b"{}")
    ((_, _, message),) = NonSeekingReader(io.BytesIO(log.finish())).iter_messages()
    assert (message.log_time, message.publish_time) == (written, written)


def test_an_empty_file_has_a_summary(log: Log) -> None:
    summary = make_reader(io.BytesIO(log.finish())).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 0


def test_a_topic_is_announced_once_with_its_schema(log: Log) -> None:
    for name in ("/one", "/two"):
        topic = log.container.add_topic(name, SCHEMA)
        log.container.add_message(topic, 1, 1, b"{}")
    data = log.finish()
    announced = [type(record).__name__ for record in StreamReader(io.BytesIO(data)).records]
    assert announced[:6] == ["Header", "Schema", "Channel", "Message", "Channel", "Message"]


def summary_crc(data: bytes) -> int:
    start = int.from_bytes(data[-28:-20], "little")
    return zlib.crc32(data[start : -len(MAGIC) - 4])


def stated_summary_crc(data: bytes) -> int:
    return int.from_bytes(data[-12:-8], "little")


def record_at(data: bytes, offset: int, read: Callable[[ReadDataStream], _T]) -> _T:
    return read(ReadDataStream(io.BytesIO(data[offset + RECORD_HEAD.size :])))
