"""The inbox: order, bounds, and what it says about what it lost."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest

from mbtool.core import Chunk, Connection, Direction, Endpoint, EventKind, Packet, Quiet, WireEvent
from mbtool.packets import CloseReason, StreamClosed, StreamGap, StreamOpened
from mbtool.sources.inbox import ITEM_COST, Ended, Inbox, Item
from tests.sources.live_helpers import PATIENCE_S, drain

CONNECTION = Connection(Endpoint("10.0.0.1", 40000), Endpoint("10.0.0.9", 502), 1)


def chunk(ts_ns: int, size: int = 100, link: str = "rs485") -> Chunk:
    return Chunk(ts_ns=ts_ns, link=link, data=bytes(size))


def stream_chunk(ts_ns: int, direction: Direction, size: int = 100) -> Chunk:
    return Chunk(
        ts_ns=ts_ns,
        link=CONNECTION.link,
        data=bytes(size),
        direction=direction,
        connection=CONNECTION,
    )


def test_gives_items_in_the_order_they_were_put() -> None:
    inbox = Inbox()
    items: list[Item] = [chunk(1), Quiet(2, "rs485"), chunk(3), Ended("rs485")]
    for item in items:
        inbox.put(item)
    assert drain(inbox) == items


def test_gives_nothing_when_nothing_comes_in_time() -> None:
    assert Inbox().get(0.001) is None


def test_wakes_a_consumer_that_waits() -> None:
    inbox = Inbox()
    thread = threading.Thread(target=inbox.put, args=(chunk(1),))
    thread.start()
    assert inbox.get(PATIENCE_S) == chunk(1)
    thread.join()


def test_a_source_goes_first_while_it_takes_what_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbtool.sources.inbox.STANDSTILL_S", PATIENCE_S)
    inbox, taken = Inbox(), threading.Event()

    def consume() -> None:
        assert inbox.get() == chunk(0)
        taken.set()

    with inbox.fetching_first(), inbox.fetching_first():
        inbox.put(chunk(0))
        consumer = threading.Thread(target=consume)
        consumer.start()
        assert not taken.wait(0.01)
    assert taken.wait(PATIENCE_S)
    consumer.join()


def test_a_consumer_that_has_much_to_do_waits_for_no_source(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    inbox = Inbox(limit=2 * (ITEM_COST + 100))
    with inbox.fetching_first():
        for ts_ns in range(2):
            inbox.put(chunk(ts_ns))
        monkeypatch.setattr(inbox._calm, "wait", lambda _: pytest.fail("it stood still"))
        assert inbox.get(0) == chunk(0)


def test_a_source_that_goes_first_for_ever_starves_no_consumer() -> None:
    inbox = Inbox()
    with inbox.fetching_first():
        inbox.put(chunk(0))
        assert inbox.get(0) == chunk(0)


def test_a_silence_replaces_the_silence_before_it() -> None:
    inbox = Inbox()
    for item in (Quiet(1, "a"), Quiet(2, "a"), Quiet(3, "b"), Quiet(4, "a")):
        inbox.put(item)
    assert drain(inbox) == [Quiet(2, "a"), Quiet(3, "b"), Quiet(4, "a")]


def test_what_is_held_is_bounded() -> None:
    inbox = Inbox(limit=10_000)
    for ts_ns in range(1000):
        inbox.put(chunk(ts_ns))
        inbox.put(Quiet(ts_ns, "rs485"))
        inbox.put(StreamOpened(ts_ns, CONNECTION, joined=False))
        inbox.put(StreamClosed(ts_ns, CONNECTION, CloseReason.RESET))
    assert inbox.held <= 20_000


def test_says_in_place_how_much_was_lost() -> None:
    inbox = Inbox(limit=4 * (ITEM_COST + 100))
    for ts_ns in range(10):
        inbox.put(chunk(ts_ns))
    # Four fit and six are lost; the consumer takes two, then there is room again.
    assert [inbox.get(0), inbox.get(0)] == [chunk(0), chunk(1)]
    inbox.put(chunk(10))
    after = drain(inbox)
    assert after[:2] == [chunk(2), chunk(3)]
    assert isinstance(after[2], WireEvent)
    assert (after[2].kind, after[2].link, after[2].missing) == (EventKind.DISCARDED, "rs485", 600)
    assert after[2].ts_ns == 9
    assert after[3:] == [chunk(10)]


def test_loses_in_one_piece_until_half_is_taken() -> None:
    inbox = Inbox(limit=4 * (ITEM_COST + 100))
    for ts_ns in range(5):
        inbox.put(chunk(ts_ns))
    assert inbox.get(0) == chunk(0)
    inbox.put(chunk(5))  # There is room for one, and still it is lost.
    losses = [item for item in drain(inbox) if isinstance(item, WireEvent)]
    assert [loss.missing for loss in losses] == [200]


def test_each_link_is_told_its_own_loss() -> None:
    inbox = Inbox(limit=ITEM_COST + 100)
    inbox.put(chunk(0))
    inbox.put(chunk(1, 7, "a"))
    inbox.put(Packet(ts_ns=2, link="eth0", link_type=1, data=bytes(9), original_length=9))
    losses = [item for item in drain(inbox) if isinstance(item, WireEvent)]
    assert [(loss.link, loss.missing, loss.packets) for loss in losses] == [
        ("a", 7, 0),
        ("eth0", 9, 1),
    ]


def test_a_loss_that_is_told_while_it_is_full_stays_told() -> None:
    inbox = Inbox(limit=ITEM_COST + 100)
    inbox.put(chunk(0))
    for number in (1, 2):
        inbox.put(Packet(ts_ns=number, link="eth0", link_type=1, data=bytes(9), original_length=9))
        inbox.put(
            WireEvent(ts_ns=number, link="eth0", kind=EventKind.DISCARDED, message="", packets=30)
        )
    (loss,) = [item for item in drain(inbox) if isinstance(item, WireEvent)]
    assert (loss.missing, loss.packets) == (18, 62)
    assert loss.message == (
        "decoding fell behind: 2 pieces with 18 bytes were not recorded; "
        "the kernel dropped 60 packets"
    )


def test_each_direction_of_a_connection_gets_a_gap() -> None:
    inbox = Inbox(limit=ITEM_COST + 100)
    inbox.put(chunk(0))
    inbox.put(stream_chunk(1, Direction.REQUEST, 12))
    inbox.put(stream_chunk(2, Direction.RESPONSE, 30))
    inbox.put(stream_chunk(3, Direction.REQUEST, 12))
    gaps = [item for item in drain(inbox) if isinstance(item, StreamGap)]
    assert gaps == [
        StreamGap(3, CONNECTION, Direction.REQUEST, 24),
        StreamGap(3, CONNECTION, Direction.RESPONSE, 30),
    ]


def test_what_a_connection_lost_is_told_before_its_end_and_not_kept() -> None:
    inbox = Inbox(limit=4 * ITEM_COST)
    inbox.put(chunk(0, 3 * ITEM_COST))
    inbox.put(stream_chunk(1, Direction.RESPONSE, 30))
    inbox.put(stream_chunk(2, Direction.REQUEST, 12))
    closed = StreamClosed(3, CONNECTION, CloseReason.RESET)
    inbox.put(closed)
    after = drain(inbox)[1:]
    assert after[:3] == [
        StreamGap(2, CONNECTION, Direction.REQUEST, 12),
        StreamGap(2, CONNECTION, Direction.RESPONSE, 30),
        closed,
    ]
    assert [type(item) for item in after[3:]] == [WireEvent]


def test_connections_without_end_are_not_kept_while_nobody_takes() -> None:
    inbox = Inbox(limit=10_000)
    for number in range(1000):
        connection = replace(CONNECTION, number=number)
        inbox.put(StreamOpened(number, connection, joined=False))
        inbox.put(replace(stream_chunk(number, Direction.REQUEST), connection=connection))
        inbox.put(StreamClosed(number, connection, CloseReason.RESET))
    assert inbox.held <= 20_000 + 2 * ITEM_COST
    assert not any(loss.streams for loss in inbox._losses.values())


def test_the_ends_of_connections_and_sources_get_through_when_full() -> None:
    inbox = Inbox(limit=ITEM_COST + 100)
    closed = StreamClosed(2, CONNECTION, CloseReason.FINISHED)
    for item in (chunk(0), chunk(1), closed, Ended("rs485")):
        inbox.put(item)
    kinds = [type(item) for item in drain(inbox)]
    assert kinds == [Chunk, StreamClosed, WireEvent, Ended]
