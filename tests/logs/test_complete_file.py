from __future__ import annotations

import errno
import io
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader
from mcap.records import Header, Metadata

from mbtool.core import OutputError
from mbtool.logs.complete_file import SECTOR, CompleteFile
from mbtool.logs.container import Container
from mbtool.logs.layout import MAGIC, TAIL_SIZE, pack_records
from mbtool.logs.schemas import TopicSchema

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

HEAD = MAGIC + pack_records(Header(profile="mbtool", library="test"))
SCHEMA = TopicSchema("s", "jsonschema", "json", b'{"type": "object", "properties": {}}')


class Disk(io.BytesIO):
    """A file in memory that remembers each state a reader or a crash could have found it in."""

    def __init__(self, room: int | None = None) -> None:
        super().__init__()
        self.states: list[bytes] = []
        self.room = room

    def write(self, data: ReadableBuffer, /) -> int:
        piece = bytes(data)
        at = self.tell()
        if self.room is not None and at + len(piece) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        before = self.getvalue()
        # A write inside one sector is done or not; a longer one may stop anywhere.
        if at // SECTOR != (at + len(piece) - 1) // SECTOR:
            for cut in range(1, len(piece)):
                self.states.append(before[:at] + piece[:cut] + before[at + cut :])
        written = super().write(piece)
        self.states.append(self.getvalue())
        return written

    def fileno(self) -> int:
        raise AssertionError("no test of the layout syncs")


def test_every_state_in_which_a_kill_leaves_the_file_opens_in_the_stock_reader() -> None:
    disk = Disk()
    container = Container(CompleteFile(disk, "x.mcap", HEAD))
    topic = container.add_topic("/t", SCHEMA)
    written: list[int] = []
    seen = [0]
    for number in range(6):
        container.add_metadata("m", {"number": str(number)})
        for size in (0, 1, 700)[: number % 3 + 1]:
            filler = bytes((7 * size + 3 * at * at) % 251 for at in range(size))
            container.add_message(topic, number, number, filler)
            written.append(number)
        disk.states.clear()
        container.flush(sync=False)
        counts = [count_messages(state) for state in disk.states]
        # Either all of the flush is there or none, and what is there stays.
        assert set(counts) == {seen[-1], len(written)}
        assert counts == sorted(counts)
        seen.append(len(written))


def test_every_state_while_the_summary_is_written_opens_in_the_stock_reader(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(CompleteFile, "_sync", lambda _self: None)
    for filler in range(0, SECTOR, 23):  # The footer comes to stand all over a sector.
        disk = Disk()
        container = Container(CompleteFile(disk, "x.mcap", HEAD))
        container.add_metadata("m", {"filler": "x" * filler})
        topic = container.add_topic("/t", SCHEMA)
        container.add_message(topic, 1, 1, b"{}")
        container.flush(sync=False)
        disk.states.clear()
        container.finish()
        for state in disk.states[:: 1 if filler == 0 else 17] + disk.states[-1:]:
            assert count_messages(state) == 1
        summary = make_reader(io.BytesIO(disk.getvalue())).get_summary()
        assert summary is not None
        assert len(summary.metadata_indexes) == 1


def test_no_tail_crosses_a_sector() -> None:
    for filler in range(0, SECTOR, 7):
        disk = Disk()
        file = CompleteFile(disk, "x.mcap", HEAD)
        for record in (Metadata("m", {}), Metadata("m", {"k": "x" * filler}), Metadata("n", {})):
            file.append(pack_records(record), sync=False)
            assert file.size == len(disk.getvalue()), filler
            assert file.position % SECTOR + TAIL_SIZE <= SECTOR, filler


def test_a_full_disk_leaves_what_was_written_before() -> None:
    full = Disk()
    fill(Container(CompleteFile(full, "x.mcap", HEAD)), 3)
    needed = len(full.getvalue())
    for room in range(200, needed, 5):
        disk = Disk(room)
        container = Container(CompleteFile(disk, "x.mcap", HEAD))
        with pytest.raises(OutputError, match=r"x\.mcap: .*No space left"):
            fill(container, 3)
        before = count_messages(disk.getvalue())
        with pytest.raises(OutputError, match=r"x\.mcap: .*No space left"):
            fill(container, 1)
        assert count_messages(disk.getvalue()) == before


def test_after_an_error_a_log_stays_as_it_is_and_repeats_the_error() -> None:
    disk = Disk()
    container = Container(CompleteFile(disk, "x.mcap", HEAD))
    disk.room = len(disk.getvalue())
    with pytest.raises(OutputError) as first:
        fill(container, 1)
    disk.room = None
    before = disk.getvalue()
    with pytest.raises(OutputError) as later:
        fill(container, 1)
    assert later.value is first.value
    with pytest.raises(OutputError) as last:
        container.finish()
    assert last.value is first.value
    assert disk.getvalue() == before


def fill(container: Container, flushes: int) -> None:
    topic = container.add_topic("/t", SCHEMA)
    for number in range(flushes):
        container.add_message(topic, number, number, bytes(range(200)))
        container.flush(sync=False)


def count_messages(data: bytes) -> int:
    return sum(1 for _ in make_reader(io.BytesIO(data), validate_crcs=True).iter_messages())
