"""Serial ports that go away and come back, as unplugged adapters do."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, EventKind, LinkError, SerialFormat, SerialLink, WireEvent
from mbtool.sources import returning
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.live import live_source
from mbtool.sources.virtual_line import VirtualLine
from tests.sources.live_helpers import drain, take_bytes, take_until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.sources.inbox import Item

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)
FAST = SerialFormat(115200, 8, "N", 1)


@pytest.fixture(autouse=True)
def _short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("FIRST_LOOK_S", "ABSENT_LOOK_S", "LAST_LOOK_S"):
        monkeypatch.setattr(returning, name, 0.01)


@contextmanager
def line(folder: Path, *listening: str) -> Iterator[int]:
    """A line whose listening ends have these names; yields the end that speaks."""
    names = [str(folder / name) for name in (*listening, "master")]
    with VirtualLine(ends=len(names), format=FAST, link_names=names) as made:
        descriptor = os.open(made.ports[-1], os.O_RDWR | os.O_NOCTTY)
        try:
            yield descriptor
        finally:
            os.close(descriptor)


def is_gap(item: Item) -> bool:
    return isinstance(item, WireEvent) and item.kind is EventKind.GAP


def gap_in(items: list[Item]) -> str:
    event = items[-1]
    assert isinstance(event, WireEvent)
    return event.message


def test_a_port_that_comes_back_is_heard_again_three_times(tmp_path: Path) -> None:
    link = SerialLink(str(tmp_path / "tap"), FAST)
    inbox = Inbox()
    with ExitStack() as stack:
        plugged = stack.enter_context(ExitStack())
        speaker = plugged.enter_context(line(tmp_path, "tap"))
        stack.enter_context(live_source(link, inbox, returns=True))
        for number in range(3):
            os.write(speaker, bytes([number]))
            assert take_bytes(inbox, 1)[0].data == bytes([number])
            plugged.close()
            assert gap_in(take_until(inbox, is_gap)) == (
                f"serial port {link.port}: lost; is it still plugged in? "
                "It is opened again when it is back"
            )
            speaker = plugged.enter_context(line(tmp_path, "tap"))
            assert gap_in(take_until(inbox, is_gap)).startswith(f"{link}: is back after ")
    *rest, last = drain(inbox)
    assert last == Ended("tap")
    assert not any(isinstance(item, Ended) for item in rest)


def test_a_line_with_two_taps_comes_back_when_both_ports_are_there(tmp_path: Path) -> None:
    link = SerialLink(str(tmp_path / "masters"), FAST, slave_port=str(tmp_path / "slaves"))
    inbox = Inbox()
    with ExitStack() as stack:
        plugged = stack.enter_context(ExitStack())
        plugged.enter_context(line(tmp_path, "masters", "slaves"))
        stack.enter_context(live_source(link, inbox, returns=True))
        plugged.close()
        take_until(inbox, is_gap)
        speaker = plugged.enter_context(line(tmp_path, "masters", "slaves"))
        take_until(inbox, is_gap)
        os.write(speaker, b"\x55")
        assert {chunk.data for chunk in take_bytes(inbox, 2)} == {b"\x55"}


def test_a_port_that_stays_away_holds_up_no_end(tmp_path: Path) -> None:
    link = SerialLink(str(tmp_path / "tap"), FAST)
    inbox = Inbox()
    with ExitStack() as stack:
        with line(tmp_path, "tap"):
            source = stack.enter_context(live_source(link, inbox, returns=True))
        take_until(inbox, is_gap)
        source.close()
    assert drain(inbox) == [Ended("tap")]


def test_a_port_that_is_not_there_at_the_start_is_an_error(tmp_path: Path) -> None:
    link = SerialLink(str(tmp_path / "absent"), FAST)
    with (
        pytest.raises(LinkError, match="is not there"),
        live_source(link, Inbox(), returns=True),
    ):
        pass


def test_a_port_that_does_not_open_at_once_when_it_is_back_is_tried_again(tmp_path: Path) -> None:
    link = SerialLink(str(tmp_path / "tap"), FAST)
    inbox = Inbox()
    with ExitStack() as stack:
        plugged = stack.enter_context(ExitStack())
        plugged.enter_context(line(tmp_path, "tap"))
        source = stack.enter_context(live_source(link, inbox, returns=True))
        assert isinstance(source, returning.ReturningSource)
        first = source.current
        plugged.close()
        take_until(inbox, is_gap)
        (tmp_path / "tap").write_text("no serial port")
        while source.current is first or source.current._thread is None:
            take_nothing(inbox)
        (tmp_path / "tap").unlink()
        speaker = plugged.enter_context(line(tmp_path, "tap"))
        take_until(inbox, is_gap)
        os.write(speaker, b"\x07")
        assert [chunk.data for chunk in take_bytes(inbox, 1)] == [b"\x07"]


def take_nothing(inbox: Inbox) -> None:
    assert not isinstance(inbox.get(0.01), Chunk | Ended)
