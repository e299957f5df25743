"""A serial port as a live source, on a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core import (
    Chunk,
    EventKind,
    LinkError,
    Quiet,
    SerialFormat,
    SerialLink,
    Stamp,
    WireEvent,
)
from mbtool.ports.clock import now_ns
from mbtool.ports.serial_records import RecordKind, SerialRecord
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.serial_capture import STEP_NS, SerialSource
from tests.sources.live_helpers import (
    drain,
    start_program,
    stop_marking,
    take_bytes,
    take_until,
    wait_for_end,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)
needs_pidfd = pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="pidfd needs Linux")

A_PARENT = """
import sys
from mbtool.core import SerialFormat, SerialLink
from mbtool.sources.inbox import Inbox
from mbtool.sources.serial_capture import STEP_NS, SerialSource
with SerialSource(SerialLink(sys.argv[1], SerialFormat()), Inbox()) as source:
    print(source._child.pid, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    near, far = os.openpty()
    yield near, os.ttyname(far)
    os.close(near)
    os.close(far)


def source_on(port: str, inbox: Inbox) -> SerialSource:
    return SerialSource(SerialLink(port, SerialFormat()), inbox)


def child_pid(source: SerialSource) -> int:
    assert source._child is not None
    return source._child.pid


def test_every_byte_arrives_in_order_with_the_time_of_its_read(pty: tuple[int, str]) -> None:
    near, port = pty
    inbox = Inbox()
    chunks = []
    with source_on(port, inbox):
        for number in range(100):
            before_ns = now_ns() - STEP_NS  # Times are rounded down.
            os.write(near, bytes([number, 0xFF, 0x11]))
            heard = take_bytes(inbox, 3)
            after_ns = now_ns()
            assert all(before_ns <= chunk.ts_ns <= after_ns for chunk in heard)
            chunks += heard
    expected = b"".join(bytes([number, 0xFF, 0x11]) for number in range(100))
    assert b"".join(chunk.data for chunk in chunks) == expected
    times = [chunk.ts_ns for chunk in chunks]
    assert times == sorted(times)
    assert not any(time % STEP_NS for time in times)
    assert {chunk.stamp for chunk in chunks} == {Stamp.LAST_BYTE}


def test_a_damaged_byte_is_an_event_beside_its_chunk(pty: tuple[int, str]) -> None:
    near, port = pty
    inbox = Inbox()
    with source_on(port, inbox):
        take_until(inbox, lambda item: isinstance(item, Quiet))
        stop_marking(port)
        os.write(near, b"\x01\xff\x00\xf8")
        items = take_until(inbox, lambda item: isinstance(item, WireEvent))
    assert [item.data for item in items if isinstance(item, Chunk)] == [b"\x01\xf8"]
    event = items[-1]
    assert isinstance(event, WireEvent)
    assert (event.kind, event.message) == (
        EventKind.LINE_ERROR,
        "parity or framing error at byte F8H",
    )


def test_bytes_that_the_driver_lost_are_told() -> None:
    inbox = Inbox()
    source = source_on("/dev/absent", inbox)
    source._take(SerialRecord(RecordKind.OVERRUN, 5, (3).to_bytes(8, "little")))
    event = inbox.get(0)
    assert isinstance(event, WireEvent)
    assert (event.kind, event.missing, event.ts_ns) == (EventKind.LINE_ERROR, 3, 5)
    assert event.message == "overrun: the port's driver lost at least 3 bytes"


def test_a_silent_line_tells_that_time_passes(pty: tuple[int, str]) -> None:
    inbox = Inbox()
    opened_ns = now_ns()
    with source_on(pty[1], inbox):
        items = [inbox.get(10) for _ in range(4)]
    quiet = [item for item in items if isinstance(item, Quiet)]
    assert len(quiet) == 4
    assert opened_ns <= quiet[0].ts_ns < quiet[1].ts_ns < quiet[2].ts_ns < quiet[3].ts_ns


def test_the_end_comes_after_all_that_was_heard(pty: tuple[int, str]) -> None:
    near, port = pty
    inbox = Inbox()
    with source_on(port, inbox) as source:
        os.write(near, b"\x01\x02\x03")
        link = source.link
    items = drain(inbox)
    assert b"".join(item.data for item in items if isinstance(item, Chunk)) == b"\x01\x02\x03"
    assert items[-1] == Ended(link)


def test_a_port_that_cannot_be_opened_is_an_error_at_once() -> None:
    inbox = Inbox()
    with (
        pytest.raises(LinkError, match=r"^serial port /dev/tty-no: is not there"),
        source_on("/dev/tty-no", inbox),
    ):
        pass
    assert drain(inbox) == []


def test_a_port_that_goes_away_ends_the_source_after_what_came() -> None:
    near, far = os.openpty()
    inbox = Inbox()
    with source_on(os.ttyname(far), inbox):
        os.write(near, b"\x0a\x0b")
        assert b"".join(chunk.data for chunk in take_bytes(inbox, 2)) == b"\x0a\x0b"
        os.close(far)
        os.close(near)
        last = take_until(inbox, lambda item: isinstance(item, Ended))[-1]
    assert isinstance(last, Ended)
    assert "lost; is it still plugged in" in str(last.error)


def test_a_reading_process_that_is_killed_is_an_error(pty: tuple[int, str]) -> None:
    inbox = Inbox()
    with source_on(pty[1], inbox) as source:
        os.kill(child_pid(source), signal.SIGKILL)
        last = take_until(inbox, lambda item: isinstance(item, Ended))[-1]
    assert isinstance(last, Ended)
    assert "ended by itself with status -9" in str(last.error)


def test_an_interrupt_does_not_reach_the_reading_process(pty: tuple[int, str]) -> None:
    near, port = pty
    inbox = Inbox()
    with source_on(port, inbox) as source:
        pid = child_pid(source)
        assert os.getpgid(pid) == pid != os.getpgid(0)
        os.kill(pid, signal.SIGINT)
        os.write(near, b"\x07")
        assert take_bytes(inbox, 1)[0].data == b"\x07"


@needs_pidfd
def test_the_reading_process_ends_with_the_context(pty: tuple[int, str]) -> None:
    with source_on(pty[1], Inbox()) as source:
        descriptor = os.pidfd_open(child_pid(source))
    wait_for_end(descriptor)


@needs_pidfd
def test_the_reading_process_ends_on_a_silent_line_when_its_parent_is_killed(
    pty: tuple[int, str],
) -> None:
    with start_program(A_PARENT, pty[1]) as parent:
        assert parent.stdout is not None
        descriptor = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
        wait_for_end(descriptor)


def test_a_stopped_reading_process_is_a_gap_of_its_line(pty: tuple[int, str]) -> None:
    _, port = pty
    inbox = Inbox()
    with source_on(port, inbox) as source:
        source._take(SerialRecord(RecordKind.STOPPED, 5, b"nothing was read for 3.0 s"))
        items = take_until(inbox, lambda item: isinstance(item, WireEvent))
    event = items[-1]
    assert isinstance(event, WireEvent)
    assert (event.kind, event.message) == (
        EventKind.GAP, f"{source.link}: nothing was read for 3.0 s"
    )  # fmt: skip
