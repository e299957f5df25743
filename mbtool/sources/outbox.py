"""Delays the chunks and events of a relay by a few ms, so that decoding a request does not delay
the response.
"""

# Without a delay, the consumer would decode a request and write the log just when the response
# comes; as both run in one interpreter, the relay would have to wait. So the outbox collects items
# and passes them to the inbox together, HOLD_S after the first of them. By then a quick response
# has been relayed.
#
# Memory: the items of HOLD_S seconds, at most MAX_HELD bytes and one item more. All calls come from
# one event loop.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Chunk
from mbtool.sources.inbox import ITEM_COST

if TYPE_CHECKING:
    import asyncio

    from mbtool.sources.inbox import Item, Sink

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
