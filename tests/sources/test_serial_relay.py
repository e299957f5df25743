"""The tap in a serial line, on pseudo-terminals."""

from __future__ import annotations

import os
import random
import socket
import sys
from threading import Event
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, Direction, EventKind, LinkError, SerialFormat, SerialLink, WireEvent
from mbtool.ports.serial_port import lost
from mbtool.ports.serial_records import RecordKind, RecordReader, RecordWriter, SerialRecord
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.live import live_source
from mbtool.sources.serial_capture import SerialSource
from mbtool.sources.serial_relay import SerialRelay
from tests.sources.live_helpers import drain, read_exactly, stop_marking, take_until

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.ports.line_errors import ErrorCounts

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
FORMAT = SerialFormat(115200, 8, "N", 1)


class Wire:
    """One half of the cut line: where a station speaks, and the tap's port."""

    def __init__(self) -> None:
        self.station, self._far = os.openpty()
        self.port = os.ttyname(self._far)
        self._is_open = True

    def say(self, data: bytes) -> None:
        os.write(self.station, data)

    def hear(self, count: int) -> bytes:
        return read_exactly(self.station, count)

    def close(self) -> None:
        """The station, and with it the port, goes away."""
        if self._is_open:
            self._is_open = False
            os.close(self.station)
            os.close(self._far)


@pytest.fixture
def halves() -> Iterator[tuple[Wire, Wire]]:
    master, slaves = Wire(), Wire()
    yield master, slaves
    master.close()
    slaves.close()


def link_of(halves: tuple[Wire, Wire]) -> SerialLink:
    master, slaves = halves
    return SerialLink(master.port, FORMAT, slave_port=slaves.port, is_relay=True)


def heard(items: Sequence[object], speaker: Direction) -> bytes:
    chunks = (item for item in items if isinstance(item, Chunk))
    return b"".join(chunk.data for chunk in chunks if chunk.direction is speaker)


def test_each_side_hears_the_other_and_the_record_says_who_spoke(
    halves: tuple[Wire, Wire],
) -> None:
    master, slaves = halves
    every_byte = bytes(range(256))
    inbox = Inbox()
    with live_source(link_of(halves), inbox) as tap:
        master.say(every_byte)
        assert slaves.hear(256) == every_byte
        slaves.say(every_byte[::-1])
        assert master.hear(256) == every_byte[::-1]
    items = drain(inbox)
    assert heard(items, REQUEST) == every_byte
    assert heard(items, RESPONSE) == every_byte[::-1]
    chunks = [item for item in items if isinstance(item, Chunk)]
    assert [one.ts_ns for one in chunks] == sorted(one.ts_ns for one in chunks)
    assert {one.link for one in chunks} == {tap.link}
    assert items[-1] == Ended(tap.link)


def test_a_long_talk_passes_unchanged_both_ways_at_once(halves: tuple[Wire, Wire]) -> None:
    choose = random.Random(4)
    inbox = Inbox()
    said = {REQUEST: b"", RESPONSE: b""}
    with SerialSource(link_of(halves), inbox):
        for _ in range(200):
            pieces = [choose.randbytes(choose.randint(1, 300)) for _ in halves]
            for half, piece in zip(halves, pieces, strict=True):
                half.say(piece)
            for half, piece in zip(reversed(halves), pieces, strict=True):
                assert half.hear(len(piece)) == piece
            said[REQUEST] += pieces[0]
            said[RESPONSE] += pieces[1]
    items = drain(inbox)
    assert {speaker: heard(items, speaker) for speaker in said} == said


@pytest.mark.parametrize("lost_side", [0, 1])
def test_a_side_that_is_killed_ends_the_tap_and_all_that_was_recorded_has_passed(
    halves: tuple[Wire, Wire], lost_side: int
) -> None:
    inbox = Inbox()
    killed, other = halves[lost_side], halves[1 - lost_side]
    with SerialSource(link_of(halves), inbox) as tap:
        killed.say(b"last words")
        items = take_until(inbox, lambda item: isinstance(item, Chunk))
        killed.close()
        items += take_until(inbox, lambda item: isinstance(item, Ended))
        recorded = heard(items, (REQUEST, RESPONSE)[lost_side])
        assert b"last words".startswith(recorded)
        assert recorded
        assert other.hear(len(recorded)) == recorded
        (last,) = items[-1:]
        assert isinstance(last, Ended)
        assert str(last.error).startswith(f"serial port {killed.port}: lost")
        assert last.link == tap.link


def test_a_tap_that_is_killed_says_so_after_all_that_it_recorded(
    halves: tuple[Wire, Wire],
) -> None:
    master, slaves = halves
    inbox = Inbox()
    with SerialSource(link_of(halves), inbox) as tap:
        master.say(b"\x01\x02\x03")
        assert slaves.hear(3) == b"\x01\x02\x03"
        items = take_until(inbox, lambda item: isinstance(item, Chunk))
        assert tap._child is not None
        tap._child.kill()
        items += take_until(inbox, lambda item: isinstance(item, Ended))
    assert heard(items, REQUEST) == b"\x01\x02\x03"
    assert "ended by itself" in str(items[-1])


@pytest.mark.parametrize("absent", [0, 1])
def test_a_port_that_is_not_there_is_an_error(halves: tuple[Wire, Wire], absent: int) -> None:
    ports = [half.port for half in halves]
    ports[absent] = "/dev/tty-no"
    link = SerialLink(ports[0], FORMAT, slave_port=ports[1], is_relay=True)
    with pytest.raises(LinkError, match=r"^serial port /dev/tty-no: is not there"):
        SerialSource(link, Inbox()).__enter__()


def test_one_port_under_two_names_is_in_use(halves: tuple[Wire, Wire]) -> None:
    port = halves[0].port
    other_name = port.replace("/dev/", "/dev/../dev/")
    link = SerialLink(port, FORMAT, slave_port=other_name, is_relay=True)
    with pytest.raises(LinkError, match="is in use by another program"):
        SerialSource(link, Inbox()).__enter__()


def test_a_damaged_byte_goes_on_as_it_was_heard_and_is_told(halves: tuple[Wire, Wire]) -> None:
    master, slaves = halves
    inbox = Inbox()
    with SerialSource(link_of(halves), inbox):
        stop_marking(master.port)
        master.say(b"\x01\xff\x00\x41\x02")  # As the driver marks a byte 41 with wrong parity.
        assert slaves.hear(3) == b"\x01\x41\x02"
        event = take_until(inbox, lambda item: isinstance(item, WireEvent))[-1]
    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.LINE_ERROR
    assert event.message == "on the master's side: parity or framing error at byte 41H"


class Half:
    """A port of a script: gives its reads, then is lost; takes some bytes at a time."""

    damaged: Sequence[int] = ()

    def __init__(self, reads: list[bytes], room: list[int]) -> None:
        self.reads = reads
        self.room = room
        self.sent = b""
        self._ready, self._other = socket.socketpair()  # One that can be read and written.
        self._other.send(b"!")

    def fileno(self) -> int:
        return self._ready.fileno()

    def read(self, wait_s: float) -> bytes:
        if not self.reads:
            raise lost("A")
        return self.reads.pop(0)

    def write(self, data: bytes) -> int:
        size = min(len(data), self.room.pop(0) if self.room else len(data))
        self.sent += data[:size]
        return size

    def counts(self) -> ErrorCounts | None:
        return None

    def close(self) -> None:
        self._ready.close()
        self._other.close()


def test_what_finds_no_room_waits_and_nothing_more_is_read() -> None:
    stuck = Half([b""] * 50, [2, 0, 1])
    talking = Half([b"abcdef", b"gh"], [])
    pipe_out, pipe_in = os.pipe()
    writer = RecordWriter(pipe_in)
    relay = SerialRelay(talking, stuck, writer, FORMAT)
    try:
        with pytest.raises(LinkError, match="lost"):
            relay.run_until(Event())
        records = RecordReader().feed(os.read(pipe_out, 2**16))
    finally:
        os.close(pipe_out)
        os.close(pipe_in)
        talking.close()
        stuck.close()
    assert stuck.sent == b"abcdefgh"
    assert _data(records) == b"abcdefgh"


def _data(records: list[SerialRecord]) -> bytes:
    return b"".join(one.data for one in records if one.kind is RecordKind.DATA)
