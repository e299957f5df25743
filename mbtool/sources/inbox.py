"""The queue from the live sources to the consumer of chunks and packets, and the outbox of a relay,
which delays what goes into it.
"""

# The consumer is the recorder (workflows/shared/recorder.py), which passes the items on to the
# decoder through a second Inbox; without a log the consumer is the decoder itself.
#
# Any number of sources, each in a thread of its own, put items (chunks, packets, events) into one
# Inbox, and one consumer takes them out. The items of one source come out in the order in which the
# source put them.
#
# Limit: the items in the inbox may have 64 MiB by default; each counts as its bytes plus ITEM_COST.
# A source never waits for the consumer, as a serial port and a relay must go on however slow the
# decoder is. So a full inbox discards new items until the consumer has taken out half of the limit:
# few large gaps are easier to read than many small ones. In place of the lost items come a
# DISCARDED event for each link, which says how much was lost, and a StreamGap for each direction of
# a connection that lost bytes; it keeps the decoder from joining the bytes before and after the
# gap. If such a connection ends while the inbox is full, its StreamGaps are put before its
# StreamClosed, so that gaps are remembered only for open connections.
#
# Sources and consumer share one interpreter. A busy consumer would slow down a capture: each system
# call of the capture releases the interpreter's lock and gets it back only milliseconds later. So a
# source fetches from the kernel inside the context `first`. Meanwhile the consumer waits, for at
# most STANDSTILL_S at a time, but not if the inbox is more than half full. The consumer of a second
# Inbox, made with `behind`, waits for the same sources.
#
# StreamOpened and StreamClosed, with the gaps before it, are accepted up to twice the limit, so
# that the consumer knows which connections are open; Ended is always accepted. A Quiet item says
# that all bytes up to its time were delivered. A new one replaces a Quiet of the same link that is
# last in the queue; one that does not fit is dropped and not counted as lost.

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from threading import Condition, Event
from typing import TYPE_CHECKING, Protocol

from mbtool.core import Chunk, Connection, Direction, EventKind, LinkError, Packet, Quiet, WireEvent
from mbtool.packets import StreamClosed, StreamEvent, StreamGap, StreamItem, StreamOpened

if TYPE_CHECKING:
    import asyncio

# The outbox delays the chunks and events of a relay by a few ms, so that decoding a request does
# not delay the response. Without a delay, the consumer would decode a request and write the log
# just when the response comes; as both run in one interpreter, the relay would have to wait. So the
# outbox collects items and passes them to the inbox together, HOLD_S after the first of them. By
# then a quick response has been relayed.
#
# Memory: the items of HOLD_S seconds, at most MAX_HELD bytes and one item more. All calls come from
# one event loop.

HOLD_S = 0.005
MAX_HELD = 2**20


class Outbox:
    """A sink that hands its items to the sink `inbox` a few milliseconds later (HOLD_S)."""

    def __init__(self, inbox: Sink, loop: asyncio.AbstractEventLoop) -> None:
        self._inbox = inbox
        self._loop = loop
        self._items: list[Item] = []
        self._held = 0
        self._timer: asyncio.TimerHandle | None = None

    @property
    def held(self) -> int:
        """The size of the items not yet handed on: their bytes plus ITEM_COST for each."""
        return self._held

    def put(self, item: Item) -> None:
        self._items.append(item)
        self._held += ITEM_COST + (len(item.data) if isinstance(item, Chunk) else 0)
        if self._held >= MAX_HELD:
            self.flush()
        elif self._timer is None:
            self._timer = self._loop.call_later(HOLD_S, self.flush)

    def flush(self) -> None:
        """Hand all collected items to the inbox now, without waiting for the delay to pass."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        items, self._items, self._held = self._items, [], 0
        for item in items:
            self._inbox.put(item)


DEFAULT_LIMIT = 64 * 2**20
STANDSTILL_S = 0.05
ITEM_COST = 256
"""Each item counts this many bytes more than its data, against the limit of the inbox: about the
memory of its Python objects."""


@dataclass(frozen=True, slots=True)
class Ended:
    """The last item of a source: no item of this source comes after it."""

    link: str
    error: LinkError | None = None
    """The error that ended the source; None if the program closed the source."""


Item = StreamItem | Packet | Quiet | Ended


class Sink(Protocol):
    """Anything that takes the items of a source, such as an Inbox."""

    def put(self, item: Item) -> object: ...


class PatientSink(Sink, Protocol):
    """A sink whose consumer waits while a source is inside the context of `fetching_first`.

    So the source gets the interpreter while it fetches data from the kernel.
    """

    def fetching_first(self) -> AbstractContextManager[None]: ...


class Inbox:
    """A bounded queue from many sources to one consumer. Any thread may use it."""

    def __init__(self, limit: int = DEFAULT_LIMIT, *, behind: Inbox | None = None) -> None:
        """`limit` is the size in bytes up to which the inbox takes items (see `held`).

        `behind` is another inbox, whose items are put into this one once they are in the log.
        Items that this inbox discards are then in the log nevertheless; its DISCARDED events say
        so and count no lost bytes. None means that sources fill this inbox.
        """
        self._limit = limit
        self._filled_by_sources = self if behind is None else behind
        self._is_recorded = behind is not None
        self._items: deque[tuple[Item, int]] = deque()
        """The items, each with its number of bytes."""
        self._held = 0
        self._losses: dict[str, _Loss] = {}
        self._changed = Condition()
        self._first = 0
        """The number of sources that have entered the context manager `first` and not yet left it.
        While it is not 0, the consumer waits."""
        self._calm = Event()
        self._calm.set()

    @property
    def held(self) -> int:
        """The size of the items in the inbox: their bytes plus ITEM_COST for each."""
        return self._held

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item) -> bool:
        """Put an item, without waiting; return False if it was discarded.

        A full inbox discards all new items except Ended and the beginnings and ends of connections,
        until the consumer has emptied it to half of the limit.
        """
        size = len(item.data) if isinstance(item, Chunk | Packet) else 0
        with self._changed:
            if isinstance(item, Ended):
                self._append_losses()
            elif not self._has_room(item, size):
                self._note_loss(item, size)
                return False
            elif isinstance(item, StreamClosed):
                self._append_gaps(item.connection)
            self._append(item, size)
            self._changed.notify()
            return True

    @contextmanager
    def fetching_first(self) -> Iterator[None]:
        """A context in which a source fetches and puts items while the consumer waits.

        The consumer waits for at most STANDSTILL_S at a time, and not if the inbox is more than
        half full.
        """
        with self._changed:
            self._first += 1
            self._calm.clear()
        try:
            yield
        finally:
            with self._changed:
                self._first -= 1
                if not self._first:
                    self._calm.set()

    def get(self, timeout: float | None = None) -> Item | None:
        """Take out and return the next item; None if none comes in `timeout` seconds.

        Without a timeout this waits until an item comes.
        """
        items = self.take(timeout, 1)
        return items[0] if items else None

    def take(self, timeout: float | None, most: int) -> list[Item]:
        """Take out and return up to `most` items; wait for the first one if there is none.

        Returns an empty list if no item comes in `timeout` seconds.
        """
        calm = self._filled_by_sources._calm
        if not calm.is_set() and self._held <= self._limit // 2:
            calm.wait(STANDSTILL_S)  # Sources go first.
        with self._changed:
            if not self._items:
                self._changed.wait_for(lambda: bool(self._items), timeout)
            items: list[Item] = []
            while self._items and len(items) < most:
                item, size = self._items.popleft()
                self._held -= ITEM_COST + size
                items.append(item)
            if self._losses and self._held <= self._limit // 2:
                self._append_losses()
            return items

    def _has_room(self, item: Item, size: int) -> bool:
        if isinstance(item, StreamOpened | StreamClosed):
            return self._held + ITEM_COST <= 2 * self._limit
        return not self._losses and self._held + ITEM_COST + size <= self._limit

    def _append(self, item: Item, size: int = 0) -> None:
        if isinstance(item, Quiet) and self._items:
            last, _ = self._items[-1]
            if isinstance(last, Quiet) and last.link == item.link:
                self._items[-1] = item, size
                return
        self._items.append((item, size))
        self._held += ITEM_COST + size

    def _note_loss(self, item: Item, size: int) -> None:
        if isinstance(item, Quiet | Ended):
            return
        loss = self._losses.setdefault(_link(item), _Loss())
        loss.ts_ns = item.ts_ns
        if isinstance(item, WireEvent) and item.kind is EventKind.DISCARDED:
            loss.size += item.missing  # This lost event itself reports a loss: add its numbers.
            loss.dropped += item.packets
            return
        loss.items += 1
        loss.size += size
        loss.packets += isinstance(item, Packet)
        if isinstance(item, Chunk) and item.connection is not None:
            stream = (item.connection, item.direction)
            loss.streams[stream] = loss.streams.get(stream, 0) + len(item.data)
        elif isinstance(item, StreamClosed):
            loss.take_gaps(item.connection)

    def _append_gaps(self, connection: Connection) -> None:
        loss = self._losses.get(connection.link)
        for gap in () if loss is None else loss.take_gaps(connection):
            self._append(gap)

    def _append_losses(self) -> None:
        where = "are in the log, but not shown" if self._is_recorded else "were not recorded"
        for link, loss in self._losses.items():
            self._append(
                WireEvent(
                    ts_ns=loss.ts_ns,
                    link=link,
                    kind=EventKind.DISCARDED,
                    message=f"decoding fell behind: {loss.items} pieces with {loss.size} bytes "
                    f"{where}{loss.dropped_text}",
                    missing=0 if self._is_recorded else loss.size,
                    packets=0 if self._is_recorded else loss.packets + loss.dropped,
                )
            )
            for connection in [connection for connection, _ in loss.streams]:
                for gap in loss.take_gaps(connection):
                    self._append(gap)
        self._losses.clear()


@dataclass(slots=True)
class _Loss:
    """Counts what one link has lost since the inbox became full."""

    ts_ns: int = 0
    items: int = 0
    size: int = 0
    packets: int = 0
    """The number of lost items that were packets of a network interface."""
    dropped: int = 0
    """The number of packets that the kernel dropped. DISCARDED events reported them, but these
    events were lost, too."""
    streams: dict[tuple[Connection, Direction], int] = field(default_factory=dict)

    @property
    def dropped_text(self) -> str:
        return f"; the kernel dropped {self.dropped} packets" if self.dropped else ""

    def take_gaps(self, connection: Connection) -> list[StreamGap]:
        """Return a StreamGap for each direction of a connection that lost bytes.

        The counts of these bytes are then removed.
        """
        lost = [
            (direction, self.streams.pop((connection, direction), 0))
            for direction in (Direction.REQUEST, Direction.RESPONSE)
        ]
        return [StreamGap(self.ts_ns, connection, way, size) for way, size in lost if size]


def _link(item: StreamItem | Packet) -> str:
    if isinstance(item, StreamOpened | StreamClosed | StreamGap | StreamEvent):
        return item.connection.link
    return item.link
