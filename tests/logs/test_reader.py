from __future__ import annotations

import io
import os
import tempfile
import threading
from contextlib import closing
from functools import cache
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from mbtool.core import (
    Chunk,
    CutError,
    DamageError,
    EventKind,
    InputError,
    Packet,
    WireEvent,
)
from mbtool.devices import NamedTransaction
from mbtool.logs import reader
from mbtool.logs.layout import DATA_END_SIZE, FOOTER_SIZE, Opcode
from mbtool.logs.reader import BATCH, LogReader, follow, read_log
from mbtool.logs.writer import LogWriter
from tests.logs.samples import (
    ONE_OF_EACH,
    START_NS,
    changed,
    chunk,
    items,
    reads,
    records_of,
    transaction,
    write_log,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.logs.messages import LogItem

T = TypeVar("T")


@given(st.lists(st.one_of(items, reads), max_size=6))
def test_what_was_written_is_read_back(written: list[LogItem]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = list(read_log(write_log(Path(folder) / "x.mcap", written)))
    # Reads of a line are joined, and stand before what was written between them.
    for link in {item.link for item in written}:
        assert _evidence(found, link) == _evidence(written, link)
    assert _without_evidence(found) == _without_evidence(written)
    for number, item in enumerate(written):
        if isinstance(item, Chunk):
            behind = _without_evidence(written[number:])
            after = _without_evidence(found[found.index(item) :])
            assert after[len(after) - len(behind) :] == behind


def test_a_log_gives_only_transactions_or_only_evidence(tmp_path: Path) -> None:
    path = write_log(tmp_path / "x.mcap", ONE_OF_EACH)
    with LogReader.open(path) as log:
        assert list(log.transactions()) == [ONE_OF_EACH[1], ONE_OF_EACH[5]]
        assert list(log.items()) == []
    with LogReader.open(path) as log:
        assert list(log.evidence()) == [ONE_OF_EACH[0], ONE_OF_EACH[3], ONE_OF_EACH[4]]


def test_metadata_before_the_first_item_is_known_at_once(tmp_path: Path) -> None:
    with LogReader.open(write_log(tmp_path / "x.mcap", ONE_OF_EACH)) as log:
        assert log.capture["host"] == "bench"
        assert log.links == {"rs485": {"spec": "rtu:/dev/ttyUSB0@19200-8E1"}}
        assert log.profiles == {"idec-ft1a-touch": b'{"name": "idec-ft1a-touch"}'}


def test_a_link_that_is_added_later_is_known_when_it_is_reached(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "x.mcap", capture={}) as writer:
        writer.write(chunk(1))
        writer.add_link("late", {})
        writer.write(chunk(2))
    with LogReader.open(tmp_path / "x.mcap") as log:
        items = log.items()
        assert next(items) == chunk(1)
        assert "late" not in log.links
        assert next(items) == chunk(2)
        assert "late" in log.links


def test_a_log_can_be_read_from_a_pipe(tmp_path: Path) -> None:
    data = write_log(tmp_path / "x.mcap", ONE_OF_EACH).read_bytes()
    reading, writing = os.pipe()

    def feed() -> None:
        with open(writing, "wb", buffering=0) as stream:
            for at in range(0, len(data), 100):
                stream.write(data[at : at + 100])

    feeder = threading.Thread(target=feed)
    feeder.start()
    with LogReader(open(reading, "rb", buffering=0), "-") as log:
        assert list(log.items()) == list(ONE_OF_EACH)
    feeder.join(10)
    assert not feeder.is_alive()


def test_a_log_cut_at_any_byte_gives_a_prefix_and_a_cut(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, error = read(data)
    assert error is None
    assert len(whole) == 6
    lengths = []
    for size in range(len(data)):
        found, error = read(data[:size])
        assert found == whole[: len(found)]
        assert isinstance(error, InputError if size == 0 else CutError)
        lengths.append(len(found))
    assert lengths == sorted(lengths)
    # All items are there long before the end, which is the summary.
    assert set(lengths) == {0, 2, 4, 6}


def test_a_log_that_was_never_closed_is_whole(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "x.mcap", capture={})
    writer.write(chunk())
    writer.tick(10**18)
    data = (tmp_path / "x.mcap").read_bytes()
    writer.close()
    log = LogReader(io.BytesIO(data), "x.mcap")
    assert list(log.items()) == [chunk()]
    assert not log.closed
    for size in range(1, len(data)):
        assert isinstance(read(data[:size])[1], CutError)


def test_a_log_with_any_byte_damaged_returns_no_wrong_item_and_an_error(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    for at in range(len(data)):
        found, error = read(data[:at] + bytes([data[at] ^ 0x40]) + data[at + 1 :])
        rest = iter(whole)
        assert all(item in rest for item in found if not _is_hole(item))
        assert error is not None


@pytest.mark.parametrize("number", range(3))
def test_a_damaged_chunk_costs_only_its_own_items(tmp_path: Path, number: int) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    offset, size = records_of(data, Opcode.CHUNK)[number]
    found, error = read(changed(data, offset + 9 + size - 20))
    (hole,) = (item for item in found if _is_hole(item))
    assert [item for item in found if item is not hole] == [
        *whole[: 2 * number],
        *whole[2 * number + 2 :],
    ]
    assert found.index(hole) == 2 * number
    assert isinstance(hole, WireEvent)
    # The time is that of what follows, or at the end of what came last.
    assert hole.ts_ns == _known_ns(found[2 * number + (1 if number < 2 else -1)])
    assert hole.message == (
        f"{9 + size} bytes of the log, from byte {offset} on, are damaged and left out"
    )
    assert isinstance(error, DamageError)
    assert str(error).startswith(f"x.mcap: damaged at byte {offset}: a chunk ")
    assert f"; {9 + size} bytes of the log are left out, all else was read; " in str(error)


def test_adjacent_damaged_chunks_are_one_gap(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    first, second, _ = records_of(data, Opcode.CHUNK)
    for offset, size in (first, second):
        data = changed(data, offset + 9 + size - 20)
    found, error = read(data)
    assert [_is_hole(item) for item in found] == [True, False, False]
    assert found[1:] == whole[4:]
    assert "and at 1 more place" in str(error)


def test_a_gap_is_among_the_evidence_and_not_among_the_transactions(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    offset, size = records_of(data, Opcode.CHUNK)[1]
    data = changed(data, offset + 9 + size - 20)
    evidence, _ = given_by(LogReader(io.BytesIO(data), "x.mcap").evidence())
    assert [_is_hole(item) for item in evidence] == [False, True, False]
    transactions, error = given_by(LogReader(io.BytesIO(data), "x.mcap").transactions())
    assert len(transactions) == 2
    assert isinstance(error, DamageError)


def test_a_damaged_profile_is_left_out_and_costs_nothing_else(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    ((offset, size),) = records_of(data, Opcode.ATTACHMENT)
    for at in range(offset + 9, offset + 9 + size):
        log = LogReader(io.BytesIO(changed(data, at)), "x.mcap")
        assert log.profiles == {}
        found, error = given_by(log.items())
        assert found == whole
        assert isinstance(error, DamageError)
        assert str(error).startswith(f"x.mcap: damaged at byte {offset}: ")
        assert f"; {9 + size} bytes of the log are left out, all else was read; " in str(error)


def test_damage_between_the_records_of_items_costs_none(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    offset, size = records_of(data, Opcode.MESSAGE_INDEX)[0]
    found, error = read(changed(data, offset + 9 + size - 1))
    assert found == whole
    assert isinstance(error, DamageError)
    assert "the CRC of the data section does not match" in str(error)


def test_a_damaged_and_truncated_log_reports_both(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    first, _, third = records_of(data, Opcode.CHUNK)
    data = changed(data, first[0] + 9 + first[1] - 20)[: third[0] + 20]
    found, error = read(data)
    assert [_is_hole(item) for item in found] == [True, False, False]
    assert isinstance(error, CutError)
    assert f"; before that, damaged at byte {first[0]}: a chunk" in str(error)


@pytest.mark.parametrize("at", [*range(9), *range(9 + 36, 9 + 44)])
def test_a_chunk_with_a_damaged_opcode_or_length_is_read_all_the_same(
    tmp_path: Path, at: int
) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    for offset, _ in records_of(data, Opcode.CHUNK):
        for bit in range(8):
            changed_bit = bytes([data[offset + at] ^ 1 << bit])
            found, error = read(data[: offset + at] + changed_bit + data[offset + at + 1 :])
            assert found == whole
            where = f"x.mcap: damaged at byte {offset}: the head of a record"
            assert str(error) == f"{where}; mbtool recover makes a whole log of it"


def test_a_log_with_a_zeroed_sector_goes_on_at_the_next_chunk(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    _, (second, size), (third, _) = records_of(data, Opcode.CHUNK)
    begin = second + size - 100
    found, error = read(data[:begin] + bytes(third - begin) + data[third:])
    assert [_is_hole(item) for item in found] == [False, False, True, False, False]
    assert [item for item in found if not _is_hole(item)] == whole[:2] + whole[4:]
    assert f"{third - second} bytes of the log are left out" in str(error)


def test_a_log_without_its_data_end_is_read_up_to_the_footer(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    summary_at = int.from_bytes(data[-FOOTER_SIZE + 9 : -FOOTER_SIZE + 17], "little")
    found, error = read(data[: summary_at - DATA_END_SIZE] + bytes(13) + data[summary_at:])
    assert [item for item in found if not _is_hole(item)] == whole
    assert isinstance(error, DamageError)


def test_damage_in_the_summary_is_told_and_costs_nothing(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    summary_at = int.from_bytes(data[-FOOTER_SIZE + 9 : -FOOTER_SIZE + 17], "little")
    for at in range(summary_at, len(data), 7):
        found, error = read(changed(data, at))
        assert found == whole
        assert isinstance(error, DamageError)
    assert "the summary, which repeats what is in the log; all else was read" in str(
        read(changed(data, summary_at + 30))[1]
    )


def test_a_second_log_in_the_same_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    write_log(path, [chunk(1)])
    whole = path.read_bytes()
    for behind, is_told in ((whole, True), (bytes(100), False)):
        path.write_bytes(whole + behind)
        with LogReader.open(path) as log:
            items = log.items()
            assert next(items) == chunk(1)
            if is_told:
                told = f"byte {len(whole)}: another log begins here"
                with pytest.raises(DamageError, match=told):
                    next(items)
            else:
                assert list(items) == []


def test_a_header_with_a_changed_name_is_known_by_its_library(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    found, error = read(data.replace(b"\6\0\0\0mbtool", b"\6\0\0\0mbtonl", 1))
    assert found == whole
    assert "the CRC of the data section does not match" in str(error)


def test_text_that_is_not_utf8_in_a_chunk_without_a_crc_costs_one_message(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream, enable_crcs=False, compression=CompressionType.NONE)
    writer.start(profile="mbtool")
    schema = writer.register_schema("mbtool.Chunk", "jsonschema", b"{}")
    channel = writer.register_channel("/rs485/chunks", "json", schema)
    for number in range(3):
        message = b'{"ts_ns":%d,"link":"rs485","data":"AQ=="}' % (number + 1)
        writer.add_message(channel, number + 1, message, number + 1)
    writer.finish()  # type: ignore[no-untyped-call]
    data = stream.getvalue()
    second = data.index(b'"rs485"', data.index(b'"ts_ns":2'))
    found, error = read(data[:second] + b'"rs\xff85"' + data[second + 7 :])
    assert [item.ts_ns for item in found if isinstance(item, Chunk)] == [1, 3]
    assert [_is_hole(item) for item in found] == [False, True, False]
    assert "no mbtool.Chunk" in str(error)


@pytest.mark.parametrize(
    "message",
    [
        b'{"ts_ns":1,"link":"a","data":""},{"ts_ns":1,"link":"a","data":""}',
        b'{"ts_ns":1,"link":"a","data":"","x":' + b"[" * 100_000,
        b'{"ts_ns":' + b"9" * 10_000 + b',"link":"a","data":""}',
    ],
    ids=["two values", "deep", "long number"],
)
def test_a_message_of_another_form_is_damage_and_not_an_exception(message: bytes) -> None:
    found, error = read(stock_log([message]))
    assert found == []
    assert "no mbtool.Chunk" in str(error)


def test_a_chunk_of_many_messages_is_given_in_parts_and_in_order() -> None:
    count = 2 * BATCH + 5
    messages = [b'{"ts_ns":%d,"link":"a","data":""}' % number for number in range(1, count + 1)]
    data = stock_log(messages, chunk_size=1 << 24)
    assert len(records_of(data, Opcode.CHUNK)) == 1
    found, error = read(data)
    assert error is None
    assert [item.ts_ns for item in found if isinstance(item, Chunk)] == list(range(1, count + 1))


def test_transactions_are_given_in_lists_without_the_gaps_between(tmp_path: Path) -> None:
    data = some_chunks(tmp_path / "x.mcap").read_bytes()
    whole, _ = read(data)
    offset, size = records_of(data, Opcode.CHUNK)[1]
    log = LogReader(io.BytesIO(changed(data, offset + 9 + size - 20)), "x.mcap")
    batches, error = given_by(log.transaction_batches())
    assert batches == [[whole[1]], [whole[5]]]
    assert isinstance(error, DamageError)


def test_following_goes_on_behind_damage(tmp_path: Path) -> None:
    path = some_chunks(tmp_path / "x.mcap")
    data = path.read_bytes()
    offset, size = records_of(data, Opcode.CHUNK)[1]
    path.write_bytes(changed(data, offset + 9 + size - 20))
    found, error = given_by(follow(path, lambda: False))
    assert isinstance(error, DamageError)
    assert [_is_hole(item) for item in found] == [False, False, True, False, False]


@settings(max_examples=300)
@given(st.data())
def test_no_bytes_raise_anything_else(data: st.DataObject) -> None:
    good = bytearray(small_log())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(8, len(good) - 1))
        good[at : at + data.draw(st.integers(0, 9))] = data.draw(st.binary(max_size=9))
    read(bytes(good))


def test_an_mcap_file_of_another_profile_is_told() -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2", library="rosbag2")
    writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(InputError, match=r"^x\.mcap: an MCAP file of profile 'ros2', not a log"):
        LogReader(io.BytesIO(stream.getvalue()), "x.mcap")


def test_a_log_of_a_later_format_is_told(tmp_path: Path) -> None:
    LogWriter(tmp_path / "x.mcap", capture={"log_format": "3"}).close()
    with pytest.raises(InputError, match="log format 3, from another version of mbtool"):
        LogReader.open(tmp_path / "x.mcap")


def test_a_log_that_the_stock_writer_made_is_read() -> None:
    stream = io.BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start(profile="mbtool")
    schema = writer.register_schema("mbtool.Chunk", "jsonschema", b"{}")
    channel = writer.register_channel("/rs485/chunks", "json", schema)
    message = b'{"ts_ns":1,"link":"rs485","data":"AQ==","from_the_future":[1]}'
    writer.add_message(channel, 1, message, 1)
    other = writer.register_channel("/other", "json", 0)
    writer.add_message(other, 1, b"not ours", 1)
    writer.finish()  # type: ignore[no-untyped-call]
    found, error = read(stream.getvalue())
    assert error is None
    assert [item.data for item in found if hasattr(item, "data")] == [b"\x01"]


def stock_log(messages: list[bytes], chunk_size: int = 1024) -> bytes:
    """A log of chunks that the stock writer made."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=chunk_size)
    writer.start(profile="mbtool")
    schema = writer.register_schema("mbtool.Chunk", "jsonschema", b"{}")
    channel = writer.register_channel("/a/chunks", "json", schema)
    for message in messages:
        writer.add_message(channel, 1, message, 1)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


@pytest.mark.parametrize(
    "message", [b"", b"{}", b'{"ts_ns":null,"link":"a","data":""}', b'{"ts_ns":1', b"\xff"]
)
def test_an_invalid_message_is_damage(message: bytes) -> None:
    found, error = read(stock_log([message]))
    assert found == []
    assert "no mbtool.Chunk" in str(error)


def test_a_message_without_a_channel_is_damage() -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="mbtool")
    writer.add_message(5, 1, b"{}", 1)
    writer.finish()  # type: ignore[no-untyped-call]
    assert "a message of an unknown channel (5)" in str(read(stream.getvalue())[1])


@pytest.mark.parametrize("name", ["absent.mcap", "a\0b"])
def test_a_log_that_cannot_be_opened_is_told(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        LogReader.open(tmp_path / name)


def test_a_folder_is_no_log(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Is a directory"):
        list(read_log(tmp_path))


def test_following_gives_each_item_once_as_it_reaches_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer = LogWriter(path, capture={})
    writer.tick(0)
    steps = iter(range(20))
    written: list[LogItem] = []
    found: list[LogItem] = []

    def wait() -> bool:
        assert found == written  # All that is on the disk was given before waiting.
        step = next(steps)
        if step == 12:
            writer.close()
        elif step % 4:
            written.extend([chunk(step), transaction(step)])
            writer.write(written[-2])
            writer.write(written[-1])
            writer.tick((step + 1) * 10**9)
        else:
            writer.add_link(f"link{step}", {})
            writer.tick((step + 1) * 10**9)
        return True

    for item in follow(path, wait):
        found.append(item)
    assert found == written
    assert len(found) == 2 * 9
    assert next(steps) == 13  # The closed log ended it.


class GrowingFile:
    """A log that grows between two reads, as the reader and the recorder are two processes."""

    def __init__(self, path: Path, grow: Callable[[], None], reads: int) -> None:
        """Call `grow` before one read, which is `reads` reads behind each seek."""
        self._file = path.open("rb", buffering=0)
        self._grow = grow
        self._behind_a_seek = reads
        self._left = -1

    def read(self, size: int, /) -> bytes:
        if self._left == 0:
            self._grow()
        self._left -= 1
        return self._file.read(size)

    def seek(self, offset: int, /) -> int:
        self._left = self._behind_a_seek
        return self._file.seek(offset)

    def close(self) -> None:
        self._file.close()


@pytest.mark.parametrize("reads", range(4))
def test_a_log_that_grows_while_its_end_is_read_is_followed_on(tmp_path: Path, reads: int) -> None:
    path = tmp_path / "x.mcap"
    writer = LogWriter(path, capture={})
    writer.tick(0)
    written: list[LogItem] = [chunk(step) for step in range(3)]
    rest, ticks = iter(written), count(10**18, 10**9)

    def grow() -> None:
        if (item := next(rest, None)) is None:
            writer.close()
        else:
            writer.write(item)
            writer.tick(next(ticks))

    waits = iter(range(100))
    file = GrowingFile(path, grow, reads)
    with closing(file), closing(writer):
        log = LogReader(file, "x.mcap", wait=lambda: next(waits, None) is not None)
        assert [*log.items()] == written
        assert log.closed


def test_following_ends_when_wait_returns_false(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "x.mcap", capture={})
    writer.write(chunk())
    writer.tick(10**18)
    assert list(follow(tmp_path / "x.mcap", lambda: False)) == [chunk()]
    writer.close()
    assert list(follow(tmp_path / "x.mcap", lambda: False)) == [chunk()]


def test_following_waits_for_a_log_that_is_not_begun(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.touch()
    waits = count(1)

    def wait() -> bool:
        if next(waits) == 2:
            path.write_bytes(small_log())
        return True

    assert list(follow(path, wait)) == list(LogReader(io.BytesIO(small_log()), "x.mcap").items())
    assert next(waits) == 3


@cache
def small_log() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return some_chunks(Path(folder) / "x.mcap").read_bytes()


def some_chunks(path: Path) -> Path:
    with LogWriter(path, capture={}) as writer:
        writer.add_profile("pump", b"{}")
        for number in range(3):
            writer.write(chunk(number))
            writer.write(transaction(number))
            writer.tick((number + 1) * 10**9)
    return path


def _evidence(some: list[LogItem], link: str) -> list[LogItem]:
    return [one for one in some if isinstance(one, Chunk | Packet) and one.link == link]


def _without_evidence(some: list[LogItem]) -> list[LogItem]:
    return [one for one in some if not isinstance(one, Chunk | Packet)]


def _is_hole(item: LogItem) -> bool:
    return isinstance(item, WireEvent) and item.kind is EventKind.GAP and not item.link


def _known_ns(item: LogItem) -> int | None:
    return item.response_ns if isinstance(item, NamedTransaction) else item.ts_ns


def read(data: bytes) -> tuple[list[LogItem], InputError | None]:
    try:
        log = LogReader(io.BytesIO(data), "x.mcap")
    except InputError as early:
        return [], early
    found, error = given_by(log.items())
    assert error is None or str(error).startswith("x.mcap: ")
    assert "\n" not in str(error)
    return found, error


def given_by(items: Iterator[T]) -> tuple[list[T], InputError | None]:
    """What is given, and the error that it ends with."""
    found: list[T] = []
    try:
        for item in items:
            found.append(item)
    except InputError as error:
        return found, error
    return found, None


@pytest.mark.parametrize(
    ("fields", "first"),
    [
        ({"unit": -5}, "unit -5, Expected `int` >= 0"),
        ({"latency_ns": -1}, "latency_ns -1, Expected `int` >= 0"),
        ({"response_values": [1, 70000]}, "response_values, Expected `int` <= 65535"),
        ({"request_ns": 2**63}, "request_ns 9223372036854775808, Expected `int` <= "),
    ],
)
def test_an_impossible_number_costs_its_message_and_is_counted(
    tmp_path: Path, fields: dict[str, object], first: str
) -> None:
    wrong = transaction(1, **fields)
    path = write_log(tmp_path / "x.mcap", [transaction(0), wrong, wrong, transaction(2)])
    *items, event = read_log(path)
    assert items == [transaction(0), transaction(2)]
    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.UNREADABLE
    assert event.message.startswith("2 messages of the log left out, ")
    assert first in event.message


PACKET = Packet(ts_ns=START_NS, link="eth0", data=b"\0", link_type=1, original_length=1)


@pytest.mark.parametrize(
    ("field", "number"), [("link_type", -1), ("link_type", 70_000), ("original_length", 1 << 40)]
)
def test_a_packet_with_an_impossible_number_is_left_out(
    tmp_path: Path, field: str, number: int
) -> None:
    path = tmp_path / "x.mcap"
    with LogWriter(path, capture={}) as log:
        log.write(PACKET)
        message = {"ts_ns": START_NS, "link": "eth0", "data": "AA==", "link_type": 1, field: number}
        topic = next(iter(log._topics.values()))
        log._container.add_message(topic, START_NS, START_NS, msgspec.json.encode(message))
    *items, event = read_log(path)
    assert items == [PACKET]
    assert isinstance(event, WireEvent)
    assert f"{field} {number}" in event.message


def test_an_impossible_number_in_a_message_that_nests_too_deep_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with LogWriter(path, capture={}) as log:
        log.write(transaction(0))
        data = b'{"request_ns": -1, "x": ' + b"[" * 100_000
        log._container.add_message(next(iter(log._topics.values())), START_NS, START_NS, data)
    *items, event = read_log(path)
    assert items == [transaction(0)]
    assert isinstance(event, WireEvent)


def test_metadata_and_profiles_are_kept_up_to_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "MAX_KEPT", 10_000)
    path = tmp_path / "x.mcap"
    with LogWriter(path, capture={}) as log:
        for number in range(100):
            log.add_profile(f"pump{number}", bytes(1_000))
        log.write(chunk(0))
    with LogReader.open(path) as log:
        items = log.items()
        assert next(items) == chunk(0)
        assert len(log.profiles) < 10
        with pytest.raises(DamageError, match="more than 10000 bytes of metadata and profiles"):
            list(items)
