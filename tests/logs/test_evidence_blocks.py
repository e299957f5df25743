"""Reads of a serial line that are joined into one message."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Chunk, Connection, Direction, Endpoint, EventKind, Stamp, WireEvent
from mbtool.logs import LogItem, LogReader, LogWriter, read_log
from mbtool.logs.evidence_blocks import MAX_READS, descriptor, is_joinable, pack_reads, unpack_reads
from tests.logs.samples import START_NS, chunk, reads, stock_messages, transaction

CAPTURES = Path(__file__).parents[2] / "captures"
PAGE = Path(__file__).parents[2] / "docs" / "log-format.md"
US = 1_000


def read(at_us: float, data: bytes, direction: Direction = Direction.UNKNOWN) -> Chunk:
    return Chunk(ts_ns=START_NS + int(at_us * US), link="rs485", data=data, direction=direction)


def test_the_layout_is_as_documented() -> None:
    message = pack_reads([read(0, b"\x01\x03"), read(570, b"\x00"), read(1150, b"\x00")])
    assert message == bytes.fromhex(
        "09 00002a36fe9c9717"  # fixed64: 1,700,000,000,000,000,000 ns
        "12 05 7273343835"  # link: rs485
        "1a 04 01030000"  # data
        "20 904e"  # unit: 10,000 ns
        "2a 03 00 39 3a"  # waits: 0, 57, 58
        "32 03 02 01 01"  # sizes
    )
    shown = re.search(r"^(09 .*(?:\n[0-9a-f]{2} .*)*)", PAGE.read_text(), re.MULTILINE)
    assert shown is not None
    in_the_page = [line.strip().partition("  ")[0] for line in shown[1].splitlines()]
    assert bytes.fromhex("".join(in_the_page)) == message


def test_reads_of_one_byte_have_no_sizes_and_a_line_with_two_taps_has_directions() -> None:
    one = pack_reads([read(0, b"\x01"), read(10, b"\x02")])
    assert one.endswith(bytes.fromhex("2a 02 00 01"))
    two = pack_reads([read(0, b"\x01", Direction.REQUEST), read(10, b"\x02", Direction.RESPONSE)])
    assert two.endswith(bytes.fromhex("2a 02 00 01 3a 02 01 02"))


@pytest.mark.parametrize(("step_ns", "unit"), [(10_000, "904e"), (300, "64"), (1, "01")])
def test_the_unit_of_time_is_the_coarsest_that_changes_no_time(step_ns: int, unit: str) -> None:
    some = [Chunk(ts_ns=7 + number * step_ns, link="a", data=b"x") for number in range(3)]
    assert bytes.fromhex("20" + unit + "2a") in pack_reads(some)
    assert unpack_reads(pack_reads(some)) == some


@given(st.lists(reads, min_size=1, max_size=8))
def test_joined_reads_are_separated_again(some: list[Chunk]) -> None:
    alike = [one for one in some if is_joinable(one) and one.link == some[0].link]
    if alike:
        assert unpack_reads(pack_reads(alike)) == alike


_messages = reads.filter(is_joinable).map(lambda one: pack_reads([one, one]))


@given(st.binary(max_size=60) | _messages, st.integers(0, 60), st.integers(0, 255))
def test_no_bytes_raise_anything_but_a_value_error(data: bytes, at: int, byte: int) -> None:
    try:
        found = unpack_reads(data[:at] + bytes([byte]) + data[at + 1 :])
    except ValueError:
        return
    assert found


def test_only_reads_of_a_serial_port_are_joined() -> None:
    connection = Connection(Endpoint("10.0.0.1", 1), Endpoint("10.0.0.2", 502))
    assert is_joinable(chunk())
    for other in (
        Chunk(ts_ns=1, link="a", data=b"", connection=connection),
        Chunk(ts_ns=1, link="a", data=b"", stamp=Stamp.AT_ONCE),
        Chunk(ts_ns=1, link="a", data=b"", stamp=Stamp.UNKNOWN),
        Chunk(ts_ns=-1, link="a", data=b""),
        Chunk(ts_ns=1 << 62, link="a", data=b""),
    ):
        assert not is_joinable(other)


@pytest.mark.parametrize("waits", [MAX_READS + 1, 10 * MAX_READS + 1])
@pytest.mark.parametrize("wait", ["01", "8101"])
def test_too_many_reads_in_a_message_are_refused(waits: int, wait: str) -> None:
    packed = bytes.fromhex(wait) * waits
    size = len(packed)
    length = bytes([size & 127 | 128, size >> 7 & 127 | 128, size >> 14])
    message = bytes.fromhex("09 0000000000000000 12 00 1a 00 20 01 2a") + length + packed
    with pytest.raises(ValueError, match="reads"):
        unpack_reads(message)


def test_reads_of_several_lines_come_in_the_order_of_their_times(tmp_path: Path) -> None:
    links = ["a", "b", "a", "a", "b"]
    some = [
        Chunk(ts_ns=number, link=link, data=bytes([number])) for number, link in enumerate(links)
    ]
    segment = Chunk(ts_ns=2, link="10.0.0.9", data=b"s", stamp=Stamp.AT_ONCE)
    written: list[LogItem] = [*some[:3], segment, transaction(), *some[3:]]
    with LogWriter(tmp_path / "x.mcap", capture={}) as log:
        for one in written:
            log.write(one)
    found = list(read_log(tmp_path / "x.mcap"))
    assert found == [*some[:3], segment, *some[3:], transaction()]


def test_a_gap_stands_between_the_reads_that_it_parts(tmp_path: Path) -> None:
    gap = WireEvent(ts_ns=START_NS, link="rs485", kind=EventKind.GAP, message="unplugged")
    written: list[LogItem] = [chunk(0), transaction(0), gap, chunk(1), transaction(1)]
    with LogWriter(tmp_path / "x.mcap", capture={}) as log:
        for item in written:
            log.write(item)
    assert list(read_log(tmp_path / "x.mcap")) == written


def test_many_reads_are_several_messages(tmp_path: Path) -> None:
    some = [chunk(number, b"x") for number in range(MAX_READS + 1)]
    with LogWriter(tmp_path / "x.mcap", capture={}) as log:
        for one in some:
            log.write(one)
    assert len(stock_messages(tmp_path / "x.mcap")) == 2
    assert list(read_log(tmp_path / "x.mcap")) == some


def test_the_end_of_a_log_is_the_time_of_its_last_read(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "x.mcap", capture={}) as log:
        for number in range(3):
            log.write(chunk(number))
    with LogReader.open(tmp_path / "x.mcap") as log_reader:
        assert len(list(log_reader.items())) == 3
        assert log_reader.end_ns == chunk(2).ts_ns


def test_the_descriptor_names_every_field() -> None:
    names = "mbtool Evidence ts_ns link data unit_ns waits sizes directions UNKNOWN REQUEST"
    for name in f"{names} RESPONSE proto3".split():
        assert name.encode() in descriptor()


@pytest.mark.parametrize("path", sorted(CAPTURES.glob("*.mcap")), ids=lambda path: path.name)
def test_logs_of_both_formats_are_read(path: Path) -> None:
    log = LogReader(io.BytesIO(path.read_bytes()), path.name)
    assert log.capture["log_format"] == ("2" if log.is_evidence_only else "1")
    assert list(log.items())
