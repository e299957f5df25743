"""Finding numbers in recordings and on links."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, cast

import pytest

from mbtool.core import UsageError
from mbtool.ports.clock import now_ns
from mbtool.values.sightings import parse_seen, wanted_of
from mbtool.workflows.find import Finder, FindRun, LiveFinder
from mbtool.workflows.shared.reading import ReadingOptions
from tests.ledger.requests import request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.devices import NamedTransaction
    from mbtool.workflows.sniff import Sniffer

SECOND_NS = 1_000_000_000
START_NS = 1_790_000_000 * SECOND_NS


def read_of(at_ns: int, *values: int) -> NamedTransaction:
    return request(
        0,
        10,
        request_ns=at_ns - 1_000_000,
        response_ns=at_ns,
        quantity=len(values),
        response_values=list(values),
    )


def test_the_rows_around_a_time_are_kept_however_long_the_recording_is() -> None:
    finder = Finder()
    at_ns = START_NS + 5_002 * SECOND_NS + SECOND_NS // 2
    finder.expect(at_ns)
    # A value that jumps at each poll: a sample of the recording would not have the one that counts.
    finder.add(
        read_of(START_NS + at * SECOND_NS, at // 2 * 7919 % 10_000, 5) for at in range(10_000)
    )
    wanted = wanted_of([parse_seen("541.9@5002.5s")], finder.first_ns)
    ((best, *_),) = finder.places(wanted)
    assert (best.address, best.power) == (10, -1)
    assert best.likelihood > 0.5


class FakeSniffer:
    """Gives a record for each permission, until it is stopped."""

    def __init__(self) -> None:
        self.permits = threading.Semaphore(0)
        self.values = iter(range(2000, 4000, 10))

    def records(self, stop: Callable[[int], bool]) -> Iterator[NamedTransaction]:
        while not stop(now_ns()):
            if self.permits.acquire(timeout=0.01):
                yield read_of(now_ns(), 2345, next(self.values))


def test_a_number_that_is_typed_while_a_link_is_heard_is_found() -> None:
    sniffer = FakeSniffer()
    live = LiveFinder(cast("Sniffer", sniffer), ExitStack(), None)
    live.start()
    try:
        shown = []
        for _ in range(3):
            before = live.finder.last_ns
            sniffer.permits.release()
            while live.finder.last_ns == before:
                pass
            with live.lock:
                (slave,) = live.finder.slaves.slaves
                (samples,) = slave.samples.values()
                shown.append(samples.rows[-1][1] / 10)
            live.see(parse_seen(f"Level={shown[-1]}bar"))
        ((best, *_),) = live.places()
        assert (best.address, best.power, live.wanted[0].unit) == (11, -1, "bar")
    finally:
        live.stop()
    assert live.error is None


def test_an_error_of_the_link_is_kept_for_the_main_thread() -> None:
    class Lost:
        def records(self, _: Any) -> Iterator[NamedTransaction]:
            raise UsageError("the link is lost")

    live = LiveFinder(cast("Sniffer", Lost()), ExitStack(), None)
    live.start()
    live.stop()
    assert isinstance(live.error, UsageError)


def test_a_time_outside_the_recording_is_refused() -> None:
    run = FindRun(["captures/ft1a-touch-line.mcap"], ReadingOptions(), None)
    run.read([])
    with pytest.raises(UsageError, match="is not in the recording"):
        run.demand_inside(START_NS * 2, "--changed-between x:")
    for text in ("5@500000s", "5@1999-01-01"):
        with pytest.raises(UsageError, match=r"^5 was seen at .*, which is not in the recording, "):
            run.wanted([parse_seen("6"), parse_seen(text)])
    assert len(run.wanted([parse_seen("6"), parse_seen("5@0s")])) == 2
