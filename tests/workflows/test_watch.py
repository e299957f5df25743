"""The feeds of the live views."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, cast

import pytest

from mbtool.core import EventKind, InputError, LinkError, WireEvent
from mbtool.modbus import Transport
from mbtool.watching.watched import Watched
from mbtool.workflows import watch as feeds
from mbtool.workflows.watch import FileFeed, LinkFeed
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.watching.watched_rows import Record
    from mbtool.workflows.sniff import Sniffer

PATIENCE_S = 30
SECOND = 1000 * MS


def recorded() -> list[Record]:
    """Eleven transactions in ten seconds, and an event."""
    records: list[Record] = [request(1000 * at, address=at) for at in range(11)]
    event = WireEvent(ts_ns=START_NS + 500 * MS, link="line", kind=EventKind.GAP, message="gap")
    records.insert(1, event)
    return records


class FileOfRecords:
    """Gives records, and counts how often they are read."""

    def __init__(self, records: list[Record], error: InputError | None = None) -> None:
        self.records, self.error = records, error
        self.opened = 0

    def __call__(self) -> Iterator[Record]:
        self.opened += 1
        yield from self.records
        if self.error is not None:
            raise self.error


def until(condition: Callable[[], bool]) -> None:
    pause = threading.Event()
    for _ in range(PATIENCE_S * 100):
        if condition():
            return
        pause.wait(0.01)
    raise AssertionError("it does not come")


@pytest.fixture
def feed() -> Iterator[FileFeed]:
    one = FileFeed(FileOfRecords(recorded()), Watched())
    one.start()
    until(lambda: one.is_read)
    yield one
    one.stop()


def shown(feed: FileFeed) -> int:
    return feed.watched.whole.account.transactions


def test_a_file_is_shown_to_its_end_at_first(feed: FileFeed) -> None:
    assert shown(feed) == 11
    assert feed.now_ns() == START_NS + 10 * SECOND
    assert feed.position_ns == 10 * SECOND
    assert not feed.is_playing


def test_a_jump_back_shows_what_was_up_to_there(feed: FileFeed) -> None:
    feed.seek_to(0.5)
    until(lambda: shown(feed) == 6)
    feed.seek(-2 * SECOND)
    until(lambda: shown(feed) == 4)
    assert feed.now_ns() == START_NS + 3 * SECOND
    feed.seek(4 * SECOND)
    until(lambda: shown(feed) == 8)
    feed.seek_to(1)
    until(lambda: shown(feed) == 11)


def test_a_jump_is_behind_until_all_records_up_to_there_are_shown() -> None:
    file = FileOfRecords(recorded())
    feed = FileFeed(file, Watched())
    feed.start()
    until(lambda: feed.is_read and not feed.is_behind)
    feed.seek_to(0)
    until(lambda: not feed.is_behind)
    assert shown(feed) == 1
    with feed.lock:  # The thread adds nothing.
        feed.seek_to(1)
        assert feed.is_behind
    until(lambda: not feed.is_behind)
    assert shown(feed) == 11
    feed.stop()


def test_steps_show_one_transaction_each(feed: FileFeed) -> None:
    feed.seek_to(0)
    until(lambda: shown(feed) == 1)
    feed.step()
    until(lambda: shown(feed) == 2)
    assert feed.watched.whole.account.events.total() == 1
    assert feed.position_ns == SECOND
    feed.step()
    until(lambda: shown(feed) == 3)


def test_a_step_at_the_end_begins_anew(feed: FileFeed) -> None:
    feed.step()
    until(lambda: shown(feed) == 2)


def test_playing_goes_to_the_end_and_stops(feed: FileFeed) -> None:
    for _ in range(6):
        feed.faster()
    assert feed.speed == 64
    feed.slower()
    feed.faster()
    feed.play()
    until(lambda: shown(feed) < 11)
    until(lambda: shown(feed) == 11 and not feed.is_playing)
    feed.play()
    until(lambda: shown(feed) < 11)
    feed.play()
    assert not feed.is_playing


def test_a_file_can_be_played_at_once() -> None:
    feed = FileFeed(FileOfRecords(recorded()), Watched(), plays=True)
    feed.start()
    until(lambda: feed.is_playing and shown(feed) == 1)
    feed.stop()


def test_a_long_file_is_read_again_for_a_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feeds, "MAX_CACHED", 3)
    file = FileOfRecords(recorded())
    feed = FileFeed(file, Watched())
    feed.start()
    until(lambda: feed.is_read)
    feed.seek_to(0)
    until(lambda: shown(feed) == 1)
    feed.stop()
    assert file.opened == 2


@pytest.mark.parametrize(("most", "passing"), [(12, 11), (11, 4)])
def test_a_filter_is_applied_to_the_whole_file_unless_it_is_long(
    most: int, passing: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "MAX_REFILTERED", most)
    feed = FileFeed(FileOfRecords(recorded()), Watched(kept=4))
    feed.start()
    until(lambda: feed.is_read)
    feed.set_filter(lambda _: True)
    assert feed.watched.filtered is not None
    assert feed.watched.filtered.account.transactions == passing
    feed.seek_to(0.5)
    until(lambda: shown(feed) == 6)
    assert feed.watched.filtered.account.transactions == 6
    feed.stop()


def test_a_file_that_ends_early_is_told_and_shown_as_far_as_it_goes() -> None:
    feed = FileFeed(FileOfRecords(recorded(), InputError("a.pcap: cut")), Watched())
    feed.start()
    until(lambda: feed.is_read)
    assert shown(feed) == 11
    assert str(feed.error) == "a.pcap: cut"
    feed.stop()


def test_a_file_without_records_can_be_played() -> None:
    feed = FileFeed(FileOfRecords([]), Watched())
    feed.start()
    until(lambda: feed.is_read)
    feed.play()
    feed.step()
    feed.seek(SECOND)
    feed.stop()
    assert feed.error is None


def test_an_unexpected_error_ends_the_thread_and_is_kept() -> None:
    def records() -> Iterator[Record]:
        raise RuntimeError("a fault")

    feed = FileFeed(records, Watched())
    feed.start()
    until(lambda: feed.is_over)
    feed.stop()
    assert isinstance(feed.error, RuntimeError)


class GivenSniffer:
    """Gives records, asks after each whether to stop, and notes when its context is left."""

    def __init__(self, records: list[Record], error: LinkError | None = None) -> None:
        self._records, self._error = records, error
        self.closed_by: str | None = None

    def records(
        self, stop: Callable[[int], bool], is_hurried: Callable[[], bool]
    ) -> Iterator[Record]:
        yield from self._records
        if self._error is not None:
            raise self._error
        at_ns = START_NS + 60 * SECOND
        while not stop(at_ns):
            threading.Event().wait(0.001)
            at_ns += 100 * MS
        assert is_hurried()

    def close(self) -> None:
        self.closed_by = threading.current_thread().name


def live(sniffer: GivenSniffer, **options: Any) -> LinkFeed:
    opened = ExitStack()
    opened.callback(sniffer.close)
    return LinkFeed(cast("Sniffer", sniffer), opened, Watched(), **options)


def test_a_live_feed_takes_records_and_completes_the_log_in_its_thread() -> None:
    sniffer = GivenSniffer(recorded())
    feed = live(sniffer, notes=[lambda record: record.link if record.link == "x" else None])
    feed.start()
    until(lambda: feed.watched.whole.account.transactions == 11)
    assert not feed.is_over
    feed.stop()
    assert sniffer.closed_by == "watch feed"
    assert feed.error is None


def test_periods_are_known_while_it_goes_on() -> None:
    sniffer = GivenSniffer([request(at * 100, transport=Transport.TCP) for at in range(10)])
    feed = live(sniffer)
    feed.start()
    until(lambda: any(one.period.count for one in feed.watched.whole.account.polls.values()))
    feed.stop()


def test_a_recording_ends_by_itself_when_asked_however_long_a_view_draws() -> None:
    sniffer = GivenSniffer(recorded())
    feed = live(sniffer, ends=lambda: True)
    feed.start()
    until(lambda: feed.is_over)
    assert sniffer.closed_by == "watch feed"


def test_a_lost_link_is_kept_and_remarks_come_from_notes() -> None:
    feed = live(GivenSniffer(recorded(), LinkError("line: gone")), notes=[lambda _: "a remark"])
    feed.start()
    until(lambda: feed.is_over)
    feed.stop()
    assert isinstance(feed.error, LinkError)
    assert feed.remarks[-1] == "a remark"


def test_a_feed_that_never_started_closes_its_links() -> None:
    sniffer = GivenSniffer([])
    live(sniffer).stop()
    assert sniffer.closed_by is not None
