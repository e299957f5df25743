"""Two serial ports as one live source, on pseudo-terminals."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, Direction, LinkError, Quiet, SerialFormat, SerialLink
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.live import live_source
from mbtool.sources.two_taps import TwoTapsSource
from tests.sources.live_helpers import drain, take_until

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


class Wire:
    """One side of a line: where it is written and the port that hears it."""

    def __init__(self) -> None:
        self.near, self.far = os.openpty()
        self.port = os.ttyname(self.far)

    def write(self, data: bytes) -> None:
        os.write(self.near, data)

    def close(self) -> None:
        for descriptor in (self.near, self.far):
            os.close(descriptor)
        self.near = self.far = -1


@pytest.fixture
def wires() -> Iterator[tuple[Wire, Wire]]:
    master, slave = Wire(), Wire()
    yield master, slave
    for wire in (master, slave):
        if wire.near >= 0:
            wire.close()


def link_of(master: Wire, slave: Wire) -> SerialLink:
    return SerialLink(master.port, SerialFormat(115200), slave_port=slave.port)


def test_each_chunk_says_who_speaks(wires: tuple[Wire, Wire]) -> None:
    master, slave = wires
    inbox = Inbox()
    with TwoTapsSource(link_of(*wires), inbox) as source:
        heard: dict[Direction, bytes] = {REQUEST: b"", RESPONSE: b""}

        def take(item: object) -> bool:
            if isinstance(item, Chunk):
                assert item.link == source.link
                heard[item.direction] += item.data
            return heard == {REQUEST: b"\x01\x02", RESPONSE: b"\x03\xff"}

        master.write(b"\x01\x02")
        slave.write(b"\x03\xff")
        take_until(inbox, take)


def test_quiet_is_what_both_ports_are(wires: tuple[Wire, Wire]) -> None:
    inbox = Inbox()
    link = link_of(*wires)
    source = TwoTapsSource(link, inbox)
    source.put(Quiet(100, link.name), REQUEST)
    assert drain(inbox) == []
    source.put(Quiet(80, link.name), RESPONSE)
    assert drain(inbox) == [Quiet(80, link.name)]
    heard = Chunk(ts_ns=120, link=link.name, data=b"\x01", direction=RESPONSE)
    source.put(heard, RESPONSE)
    assert drain(inbox) == [heard, Quiet(100, link.name)]
    source.put(Quiet(110, link.name), RESPONSE)  # It knows nothing new of the other port.
    assert drain(inbox) == []


def test_quiet_follows_a_clock_that_is_set_back(wires: tuple[Wire, Wire]) -> None:
    inbox = Inbox()
    link = link_of(*wires)
    source = TwoTapsSource(link, inbox)
    hour_ns = 3_600_000_000_000
    for speaker in (REQUEST, RESPONSE):
        source.put(Quiet(hour_ns + 100, link.name), speaker)
    assert drain(inbox) == [Quiet(hour_ns + 100, link.name)]
    source.put(Quiet(200, link.name), RESPONSE)
    source.put(Quiet(190, link.name), RESPONSE)  # A step of that size is none.
    assert drain(inbox) == [Quiet(200, link.name)]
    source.put(Quiet(210, link.name), REQUEST)
    source.put(Quiet(230, link.name), RESPONSE)
    assert drain(inbox) == [Quiet(210, link.name)]


def test_leaving_ends_both_ports_with_one_last_word(wires: tuple[Wire, Wire]) -> None:
    inbox = Inbox()
    with TwoTapsSource(link_of(*wires), inbox) as source:
        pass
    ended = [item for item in drain(inbox) if isinstance(item, Ended)]
    assert ended == [Ended(source.link)]
    assert all(tap._child is not None and tap._child.poll() is not None for tap in source.taps)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_port_that_goes_away_ends_both_with_what_came(
    wires: tuple[Wire, Wire], lost: int
) -> None:
    inbox = Inbox()
    port = wires[lost].port
    with TwoTapsSource(link_of(*wires), inbox) as source:
        wires[1 - lost].write(b"\x0a\x0b")
        take_until(inbox, lambda item: isinstance(item, Chunk))
        wires[lost].close()
        last = take_until(inbox, lambda item: isinstance(item, Ended))[-1]
        assert isinstance(last, Ended)
        assert last.link == source.link
        assert str(last.error).startswith(f"link {source.place} needs both its ports: ")
        assert f"serial port {port}: lost; is it still plugged in" in str(last.error)
    assert not any(isinstance(item, Ended) for item in drain(inbox))


@pytest.mark.parametrize("absent", [0, 1])
def test_a_port_that_cannot_be_opened_is_an_error_and_leaves_none_open(
    wires: tuple[Wire, Wire], absent: int
) -> None:
    ports = [wire.port for wire in wires]
    ports[absent] = "/dev/tty-no"
    source = TwoTapsSource(SerialLink(ports[0], SerialFormat(), slave_port=ports[1]), Inbox())
    with pytest.raises(LinkError, match=r"^serial port /dev/tty-no: is not there"):
        source.__enter__()
    for tap in source.taps:
        assert tap._child is None or tap._child.poll() is not None


def test_a_link_with_two_ports_has_this_source(wires: tuple[Wire, Wire]) -> None:
    link = link_of(*wires)
    source = live_source(link, Inbox())
    assert isinstance(source, TwoTapsSource)
    assert (source.link, source.place) == (link.name, str(link))
