"""A virtual line, end to end on its pseudo-terminals."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError, SerialFormat, UsageError
from mbtool.sources.virtual_line import VirtualLine
from tests.sources.live_helpers import read_exactly, start_program, wait_for_end

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="a virtual line needs Linux or macOS"
)

FAST = SerialFormat(115200, 8, "N", 1)

A_PARENT = """
import sys
from mbtool.sources.virtual_line import VirtualLine
with VirtualLine(link_names=[sys.argv[1]]) as line:
    print(line._child.pid, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def ends() -> Iterator[list[int]]:
    """Three open ends of a fast line."""
    with VirtualLine(ends=3, format=FAST) as line:
        descriptors = [os.open(port, os.O_RDWR | os.O_NOCTTY) for port in line.ports]
        yield descriptors
        for descriptor in descriptors:
            os.close(descriptor)


def test_every_other_end_hears_what_one_writes(ends: list[int]) -> None:
    data = bytes(range(256))
    os.write(ends[0], data)
    assert read_exactly(ends[1], 256) == data
    assert read_exactly(ends[2], 256) == data
    os.set_blocking(ends[0], False)
    with pytest.raises(BlockingIOError):
        os.read(ends[0], 1)


def test_answers_come_back_in_order(ends: list[int]) -> None:
    for number in range(20):
        os.write(ends[0], bytes([number, 0x03]))
        assert read_exactly(ends[1], 2) == bytes([number, 0x03])
        os.write(ends[1], bytes([number, 0x83]))
        assert read_exactly(ends[0], 2) == bytes([number, 0x83])
    expected = b"".join(bytes([number, 0x03, number, 0x83]) for number in range(20))
    assert read_exactly(ends[2], 80) == expected


def test_characters_are_never_faster_than_the_line() -> None:
    format_ = SerialFormat(19200, 8, "E", 1)
    with VirtualLine(format=format_) as line:
        writing, reading = (os.open(port, os.O_RDWR | os.O_NOCTTY) for port in line.ports)
        before_ns = time.monotonic_ns()
        os.write(writing, bytes(100))
        for count in range(1, 101):
            read_exactly(reading, 1)
            assert time.monotonic_ns() - before_ns >= count * format_.character_ns
        os.close(writing)
        os.close(reading)


def test_a_writer_feels_the_pace_and_loses_nothing(ends: list[int]) -> None:
    data = bytes(number * 7 % 251 for number in range(10_000))
    ears = [bytearray(), bytearray()]
    threads = [
        threading.Thread(target=lambda ear=ear, end=end: ear.extend(read_exactly(end, len(data))))
        for ear, end in zip(ears, ends[1:], strict=True)
    ]
    for thread in threads:
        thread.start()
    written = 0
    while written < len(data):
        written += os.write(ends[0], data[written:])
    for thread in threads:
        thread.join()
    assert [bytes(ear) for ear in ears] == [data, data]


def test_an_end_can_be_closed_and_opened_again() -> None:
    with VirtualLine(format=FAST) as line:
        for _ in range(3):
            here, there = (os.open(port, os.O_RDWR | os.O_NOCTTY) for port in line.ports)
            os.write(here, b"\n\x03\x04\r")  # What a terminal that is not raw would change.
            assert read_exactly(there, 4) == b"\n\x03\x04\r"
            os.close(here)
            os.close(there)


def test_links_lead_to_the_first_ends_and_go_with_the_line(tmp_path: Path) -> None:
    names = [str(tmp_path / "master"), str(tmp_path / "slave")]
    os.symlink("/nowhere", names[1])  # An old link is replaced.
    with VirtualLine(ends=3, link_names=names) as line:
        assert line.ports[:2] == names
        assert all(os.path.realpath(port).startswith("/dev/") for port in line.ports)
        assert len({os.path.realpath(port) for port in line.ports}) == 3
    assert list(tmp_path.iterdir()) == []


def test_two_ends_cannot_share_a_name(tmp_path: Path) -> None:
    (tmp_path / "there").symlink_to(tmp_path)
    for other in ("q1", "./q1", "there/q1"):
        names = [str(tmp_path / "q1"), f"{tmp_path}/{other}"]
        with pytest.raises(UsageError, match="q1: named twice"):
            VirtualLine(link_names=names)


def test_a_file_in_the_place_of_a_link_is_an_error_and_stays(tmp_path: Path) -> None:
    taken = tmp_path / "slave"
    taken.write_text("mine")
    names = [str(tmp_path / "master"), str(taken)]
    with (
        pytest.raises(LinkError, match=r"cannot make the link .*slave: File exists"),
        VirtualLine(link_names=names),
    ):
        pass
    assert taken.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [taken]


def test_the_name_of_a_line_that_runs_is_not_taken_over(tmp_path: Path) -> None:
    name = str(tmp_path / "plc")
    with VirtualLine(link_names=[name]) as line:
        port = os.readlink(name)
        with (
            pytest.raises(LinkError, match=f"plc: it leads to {port}; end that line"),
            VirtualLine(link_names=[name]),
        ):
            pass
        assert os.readlink(name) == port
        assert line.ports[0] == name


def test_a_link_that_someone_else_has_changed_stays(tmp_path: Path) -> None:
    name = tmp_path / "master"
    with VirtualLine(link_names=[str(name)]):
        name.unlink()
        name.symlink_to("/elsewhere")
    assert os.readlink(name) == "/elsewhere"


@pytest.mark.parametrize("ends", [1, 17])
def test_a_line_has_at_least_two_and_not_too_many_ends(ends: int) -> None:
    with pytest.raises(UsageError, match="2 to 16 ends"):
        VirtualLine(ends=ends)


def test_there_are_not_more_links_than_ends() -> None:
    with pytest.raises(UsageError, match="cannot have 3 links"):
        VirtualLine(link_names=["a", "b", "c"])


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="pidfd needs Linux")
def test_the_line_ends_and_removes_its_links_when_its_parent_is_killed(tmp_path: Path) -> None:
    name = tmp_path / "master"
    with start_program(A_PARENT, str(name)) as parent:
        assert parent.stdout is not None
        descriptor = os.pidfd_open(int(parent.stdout.readline()))
        assert name.is_symlink()
        parent.kill()
        wait_for_end(descriptor)
    assert not name.is_symlink()
