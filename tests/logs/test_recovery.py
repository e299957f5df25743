"""A damaged log and the whole log that is made of it."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import pytest
from mcap.writer import Writer

from mbtool.core import EventKind, InputError, WireEvent
from mbtool.logs import LogReader, LogWriter, read_log
from mbtool.logs.layout import DATA_END_SIZE, FOOTER_SIZE, MAGIC, Opcode, empty_record
from mbtool.logs.recovery import LogLoss, Recovered, Recovery
from tests.logs.samples import (
    NAMED,
    START_NS,
    changed,
    chunk,
    records_of,
    stock_messages,
    transaction,
    write_log,
)

if TYPE_CHECKING:
    from pathlib import Path

MS = 1_000_000


@pytest.fixture
def log(tmp_path: Path) -> bytes:
    """A log of four chunks, each with two reads; settings, a profile, points and a finding."""
    path = tmp_path / "x.mcap"
    with LogWriter(path, capture={"host": "bench"}) as writer:
        writer.add_link("rs485", {"spec": "rtu:/dev/ttyUSB0@19200-8E1"})
        writer.add_profile("pump", b'{"name": "pump"}')
        writer.write(NAMED)
        for number in range(10, 18):
            writer.write(chunk(number))
            writer.write(transaction(number))
            if number % 2:
                writer.tick((number + 1) * 10**9)
    return path.read_bytes()


def test_a_whole_log_is_copied_with_all_that_is_in_it(tmp_path: Path, log: bytes) -> None:
    result, losses = recover(log, tmp_path)
    assert (result.losses, result.lost_messages, result.remark, losses) == (0, 0, "", [])
    assert stock_messages(tmp_path / "good.mcap") == stock_messages(tmp_path / "x.mcap")
    assert result.messages == len(stock_messages(tmp_path / "x.mcap"))
    with LogReader.open(tmp_path / "good.mcap") as good:
        assert good.links == {"rs485": {"spec": "rtu:/dev/ttyUSB0@19200-8E1"}}
        assert good.profiles == {"pump": b'{"name": "pump"}'}
        assert good.capture["host"] == "bench"
        list(good.items())
        assert good.closed


def test_a_lost_chunk_is_told_with_its_place_and_the_times_of_the_summary(
    tmp_path: Path, log: bytes
) -> None:
    offset, size = records_of(log, Opcode.CHUNK)[1]
    result, (loss,) = recover(changed(log, offset + 9 + size - 20), tmp_path)
    assert (loss.offset, loss.end) == (offset, offset + 9 + size)
    assert (loss.begin_ns, loss.end_ns) == (START_NS + 12 * MS, START_NS + 13 * MS + 500_000)
    assert (result.losses, result.lost_bytes, result.lost_messages) == (1, 9 + size, 3)


def test_without_a_summary_a_loss_has_the_times_of_the_messages_around_it(
    tmp_path: Path, log: bytes
) -> None:
    offset, size = records_of(log, Opcode.CHUNK)[1]
    broken = changed(changed(log, offset + 9 + size - 20), len(log) - FOOTER_SIZE - 5)
    result, (loss,) = recover(broken, tmp_path)
    assert (loss.begin_ns, loss.end_ns) == (START_NS + 11 * MS + 500_000, START_NS + 14 * MS)
    assert result.lost_messages is None


def test_a_gap_stands_where_something_was_lost(tmp_path: Path, log: bytes) -> None:
    offset, size = records_of(log, Opcode.CHUNK)[1]
    recover(changed(log, offset + 9 + size - 20), tmp_path)
    items = list(read_log(tmp_path / "good.mcap"))
    (gap,) = [item for item in items if isinstance(item, WireEvent)]
    assert gap.kind is EventKind.GAP
    assert gap.message == (
        f"{9 + size} bytes of the log, from byte {offset} on, were damaged and are lost"
    )
    assert items[items.index(gap) + 1] == chunk(14)


@pytest.mark.parametrize("has_summary", [True, False])
def test_the_topics_of_a_lost_first_chunk_are_found(
    tmp_path: Path, log: bytes, has_summary: bool
) -> None:
    whole = stock_messages(tmp_path / "x.mcap")
    offset, size = records_of(log, Opcode.CHUNK)[0]
    broken = changed(log, offset + 9 + size - 20)
    if not has_summary:
        broken = changed(broken, len(log) - FOOTER_SIZE - 5)
    recover(broken, tmp_path)
    found = stock_messages(tmp_path / "good.mcap")
    assert [(topic, data) for topic, _, data in found] == [
        (topic, data) for topic, _, data in whole[-len(found) :]
    ]
    assert len(found) == 3 * 3


def test_the_topics_of_points_and_findings_are_found_by_their_fields(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "x.mcap", capture={}) as writer:
        writer.write(chunk(1))
        writer.write(transaction(1, link="a/b"))
        writer.write(NAMED)
        writer.tick(10**9)
        writer.tick(2 * 10**9)
        writer.write(transaction(2, link="a/b"))
        writer.write(transaction(3, points=NAMED.points[:1], findings=["FT1A-Q3"], device="z"))
        writer.tick(3 * 10**9)
    data = (tmp_path / "x.mcap").read_bytes()
    (offset, size), *_ = records_of(data, Opcode.CHUNK)
    broken = changed(changed(data, offset + 9 + size - 20), len(data) - FOOTER_SIZE - 5)
    recover(broken, tmp_path)
    assert {topic for topic, _, _ in stock_messages(tmp_path / "good.mcap")} == {
        "/a_b/transactions",
        "/rs485/transactions",
        "/points",
        "/findings",
    }


def test_a_cut_is_a_loss_and_a_cut_in_the_summary_is_none(tmp_path: Path, log: bytes) -> None:
    offset, _ = records_of(log, Opcode.CHUNK)[2]
    result, (loss,) = recover(log[: offset + 50], tmp_path)
    assert (loss.offset, loss.end, loss.end_ns) == (offset, offset + 50, None)
    assert loss.what.startswith(f"cut off at byte {offset + 50}")
    assert result.lost_messages is None
    summary_at = int.from_bytes(log[-FOOTER_SIZE + 9 : -FOOTER_SIZE + 17], "little")
    for size in (summary_at - DATA_END_SIZE + 3, summary_at, summary_at + 50, len(log) - 1):
        result, losses = recover(log[:size], tmp_path)
        assert losses == []
        assert "cut off at byte" in result.remark
        assert result.messages == len(stock_messages(tmp_path / "x.mcap"))


def test_an_index_whose_opcode_became_that_of_a_message_is_none(tmp_path: Path, log: bytes) -> None:
    for offset, _ in records_of(log, Opcode.MESSAGE_INDEX):
        broken = log[:offset] + bytes([Opcode.MESSAGE]) + log[offset + 1 :]
        result, losses = recover(broken, tmp_path)
        assert losses == []
        assert "the head of a record; nothing is lost there" in result.remark
        assert stock_messages(tmp_path / "good.mcap") == stock_messages(tmp_path / "x.mcap")


def test_damage_that_costs_nothing_is_a_remark(tmp_path: Path, log: bytes) -> None:
    offset, size = records_of(log, Opcode.MESSAGE_INDEX)[0]
    chunk_at, _ = records_of(log, Opcode.CHUNK)[1]
    for at in (2, offset, offset + 3, offset + 9 + size - 1, chunk_at, chunk_at + 2):
        result, losses = recover(changed(log, at), tmp_path)
        assert losses == []
        assert result.lost_messages == 0
        assert "damaged at byte" in result.remark
        assert result.messages == len(stock_messages(tmp_path / "x.mcap"))


def test_logs_behind_each_other_in_one_file_become_one(tmp_path: Path, log: bytes) -> None:
    with LogWriter(tmp_path / "y.mcap", capture={}) as writer:
        writer.write(chunk(30))
    other = (tmp_path / "y.mcap").read_bytes()
    result, losses = recover(log + other + log, tmp_path)
    assert losses == []
    assert result.remark == ""
    whole = stock_messages(tmp_path / "x.mcap")
    found = stock_messages(tmp_path / "good.mcap")
    assert sorted(found) == sorted([*whole, *stock_messages(tmp_path / "y.mcap"), *whole])


def test_a_damaged_filler_record_costs_nothing_by_the_summary(tmp_path: Path, log: bytes) -> None:
    offset, _ = records_of(log, Opcode.CHUNK)[1]
    filler = bytearray(empty_record(300))
    filler[4] = 0xFF
    result, losses = recover(log[:offset] + bytes(filler) + log[offset:], tmp_path)
    assert result.messages == len(stock_messages(tmp_path / "x.mcap"))
    # Its summary names other offsets, as the log became longer, so a loss may be told.
    assert len(losses) <= 1


def test_lost_settings_are_a_loss_without_messages(tmp_path: Path, log: bytes) -> None:
    offset, size = records_of(log, Opcode.METADATA)[1]
    broken = log[: offset + 9] + b"\xff" * size + log[offset + 9 + size :]
    result, (loss,) = recover(broken, tmp_path)
    assert loss.offset == offset
    assert result.lost_messages == 0


@pytest.mark.parametrize("data", [b"", b"\x00" * 500, MAGIC, MAGIC * 100])
def test_a_file_that_holds_nothing_of_a_log_is_told_and_nothing_is_made(
    tmp_path: Path, data: bytes
) -> None:
    with pytest.raises(InputError, match="nothing of a log of mbtool is in it"):
        recover(data, tmp_path)
    assert not (tmp_path / "good.mcap").exists()


def test_a_log_of_another_program_is_told(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2", library="rosbag2")
    writer.add_message(writer.register_channel("/a", "json", 0), 1, b"{}", 1)
    writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(InputError, match="nothing of a log of mbtool is in it"):
        recover(stream.getvalue(), tmp_path)


def test_a_recovered_log_recovers_to_the_same_messages(tmp_path: Path) -> None:
    data = write_log(tmp_path / "x.mcap", [chunk(number) for number in range(5)]).read_bytes()
    recover(data, tmp_path)
    first = (tmp_path / "good.mcap").read_bytes()
    recover(first, tmp_path)
    assert stock_messages(tmp_path / "good.mcap") == stock_messages(tmp_path / "x.mcap")


def recover(data: bytes, folder: Path) -> tuple[Recovered, list[LogLoss]]:
    losses: list[LogLoss] = []
    recovery = Recovery(io.BytesIO(data), "x.mcap", losses.append)
    good = folder / "good.mcap"
    good.unlink(missing_ok=True)
    return recovery.run(good), losses
