"""The recorder: evidence is in the log whatever the decoder does, and the log says how far that is.

Nothing here sleeps: a log that tells each call, and a clock that the test moves.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, EventKind, OutputError, Quiet, WireEvent
from mbtool.logs.messages import DecodingMark
from mbtool.sources.inbox import ITEM_COST, Inbox
from mbtool.workflows.shared.recorder import BEHIND_NS, Recorder
from tests.logs.samples import transaction
from tests.sources.live_helpers import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mbtool.logs.messages import LogItem


def chunk(number: int, size: int = 8) -> Chunk:
    return Chunk(ts_ns=number, link="rs485", data=bytes(size))


class NotedLog:
    """A log in memory, whose items a test can wait for."""

    def __init__(self, room: float = float("inf")) -> None:
        self.items: list[LogItem | DecodingMark] = []
        self.ticks = 0
        self.final: Mapping[str, str] | None = None
        self._room = room
        self._changed = threading.Condition()

    def write(self, item: LogItem | DecodingMark) -> None:
        if len(self.items) >= self._room:
            raise OutputError("a.mcap: the disk is full")
        with self._changed:
            self.items.append(item)
            self._changed.notify_all()

    def tick(self, now_ns: int) -> None:
        with self._changed:
            self.ticks += 1
            self._changed.notify_all()

    def close(self, final: Mapping[str, str]) -> None:
        self.final = final

    @property
    def marks(self) -> list[DecodingMark]:
        return [item for item in self.items if isinstance(item, DecodingMark)]

    def wait_for(self, is_so: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(is_so, PATIENCE_S), self.items

    def wait_for_ticks(self, count: int = 2) -> None:
        """Wait until the recorder has looked at the clock again."""
        enough = self.ticks + count
        self.wait_for(lambda: self.ticks >= enough)


class Bench:
    """A recorder between an inbox and a log, with a clock that stands."""

    def __init__(self, room: float = float("inf")) -> None:
        self.now_ns = 0
        self.heard = Inbox()
        self.log = NotedLog(room)
        self.recorder = Recorder(self.heard, self.log, lambda: self.now_ns)

    def hear(self, *items: Chunk | WireEvent | Quiet) -> None:
        for item in items:
            self.heard.put(item)

    def decode(self) -> Chunk:
        """Decode the next chunk, into a transaction."""
        item = self.recorder.undecoded.get(PATIENCE_S)
        assert isinstance(item, Chunk)
        self.recorder.write(transaction(request_ns=item.ts_ns))
        self.recorder.note_decoded(item)
        return item


def test_evidence_is_in_the_log_though_nobody_decodes() -> None:
    bench = Bench()
    bench.recorder.start()
    bench.hear(*map(chunk, range(1000)))
    bench.log.wait_for(lambda: len(bench.log.items) >= 1000)
    bench.recorder.stop()
    assert bench.log.items == [*map(chunk, range(1000))]


def test_evidence_stands_before_what_is_decoded_from_it() -> None:
    bench = Bench()
    bench.recorder.start()
    for number in range(3):
        bench.hear(chunk(number))
        assert bench.decode() == chunk(number)
    bench.recorder.stop()
    bench.recorder.close()
    assert [item.ts_ns for item in bench.log.items if isinstance(item, Chunk)] == [0, 1, 2]
    kinds = [isinstance(item, Chunk) for item in bench.log.items]
    assert len(kinds) == 6
    assert all(sum(kinds[:at]) * 2 >= at for at in range(7))
    assert bench.log.final == {"discarded_packets": "0", "discarded_bytes": "0"}


def test_what_is_heard_before_the_end_is_recorded_and_can_be_decoded_after_it() -> None:
    bench = Bench()
    bench.recorder.start()
    bench.hear(chunk(1), chunk(2))
    bench.recorder.stop()
    assert bench.log.items == [chunk(1), chunk(2)]
    bench.decode()
    bench.decode()
    bench.recorder.close()
    assert len(bench.log.items) == 4
    assert not bench.log.marks


def test_a_decoder_that_is_late_is_marked_until_it_has_caught_up() -> None:
    bench = Bench()
    bench.hear(*map(chunk, range(5)))
    bench.recorder.start()
    bench.log.wait_for_ticks()
    assert not bench.log.marks
    bench.now_ns += BEHIND_NS + 1
    bench.log.wait_for(lambda: bool(bench.log.marks))
    assert bench.log.marks[-1].waiting == 5
    for _ in range(5):
        bench.decode()
    bench.log.wait_for(lambda: bench.log.marks[-1].waiting == 0)
    bench.recorder.stop()
    bench.recorder.close()
    at = bench.log.items.index(bench.log.marks[-1])
    decoded = [item for item in bench.log.items[:at] if not isinstance(item, Chunk | DecodingMark)]
    assert len(decoded) == 5, "the records stand before the mark that says they do"
    assert "undecoded_pieces" not in (bench.log.final or {})


def test_a_decoder_that_is_in_step_is_not_marked_while_there_is_always_something_to_do() -> None:
    bench = Bench()
    bench.recorder.start()
    bench.hear(chunk(0))
    for number in range(1, 5):
        bench.hear(chunk(number))
        bench.decode()
        bench.now_ns += BEHIND_NS // 3
        bench.log.wait_for_ticks()
    bench.recorder.stop()
    assert not bench.log.marks


def test_what_is_left_undecoded_is_marked_and_counted_at_the_end() -> None:
    bench = Bench()
    bench.recorder.start()
    bench.hear(*map(chunk, range(4)))
    bench.decode()
    bench.recorder.stop()
    bench.recorder.close()
    assert [mark.waiting for mark in bench.log.marks] == [3]
    assert bench.log.final is not None
    assert bench.log.final["undecoded_pieces"] == "3"


def test_a_decoder_that_is_far_behind_gets_no_more_but_the_log_does() -> None:
    bench = Bench()
    bench.recorder.undecoded._limit = 10 * (ITEM_COST + 8)
    told = WireEvent(ts_ns=1, link="rs485", kind=EventKind.LINE_ERROR, message="a parity error")
    bench.hear(*map(chunk, range(100)), told)
    bench.recorder.start()
    bench.log.wait_for(lambda: told in bench.log.items)
    bench.log.wait_for(lambda: bool(bench.log.marks))
    bench.recorder.stop()
    assert sum(isinstance(item, Chunk) for item in bench.log.items) == 100
    assert bench.recorder.dropped == 90
    assert bench.log.marks[0].dropped == 90
    for number in range(10):
        assert bench.decode() == chunk(number)
    event = bench.recorder.undecoded.get(0)
    assert isinstance(event, WireEvent)
    assert event.message.startswith("decoding fell behind: 91 pieces with 720 bytes are in the log")
    assert (event.missing, event.packets) == (0, 0)
    bench.recorder.close()
    assert bench.log.final is not None
    assert bench.log.final["undecoded_pieces"] == "90"


def test_losses_of_the_sources_are_counted_though_nobody_decodes() -> None:
    bench = Bench()
    lost = WireEvent(
        ts_ns=1, link="x", kind=EventKind.DISCARDED, message="lost", missing=5, packets=2
    )
    bench.hear(lost, lost)
    bench.recorder.start()
    bench.recorder.stop()
    bench.recorder.close()
    assert bench.log.final == {"discarded_packets": "4", "discarded_bytes": "10"}


def test_a_full_disk_is_raised_where_the_decoder_is() -> None:
    bench = Bench(room=2)
    bench.recorder.start()
    bench.hear(*map(chunk, range(5)))
    thread = bench.recorder._thread
    assert thread is not None
    thread.join(PATIENCE_S)
    with pytest.raises(OutputError, match="disk is full"):
        bench.recorder.check()
    with pytest.raises(OutputError, match="disk is full"):
        bench.recorder.write(transaction())


def test_a_decoder_that_waits_for_the_log_learns_that_the_disk_is_full(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mbtool.workflows.shared.recorder.MAX_RECORDS", 0)
    bench = Bench(room=0)
    raised: list[OutputError] = []

    def decode() -> None:
        try:
            bench.recorder.write(transaction())
        except OutputError as error:
            raised.append(error)

    bench.recorder._thread = threading.Thread()
    decoder = threading.Thread(target=decode)
    decoder.start()
    bench.recorder.start()
    bench.hear(chunk(1))
    decoder.join(PATIENCE_S)
    assert len(raised) == 1
