"""What a relay records, handed over a little later."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, Quiet
from mbtool.sources.inbox import ITEM_COST, MAX_HELD, Inbox, Outbox
from tests.sources.live_helpers import PATIENCE_S, drain

if TYPE_CHECKING:
    from mbtool.sources.inbox import Item


def chunk(data: bytes) -> Chunk:
    return Chunk(ts_ns=1, link="a", data=data)


def test_what_is_put_comes_later_together_and_in_order() -> None:
    inbox = Inbox()
    items: list[Item] = [chunk(b"1"), Quiet(2, "a"), chunk(b"3")]

    async def put() -> None:
        outbox = Outbox(inbox, asyncio.get_running_loop())
        for item in items:
            outbox.put(item)
        assert inbox.held == 0
        async with asyncio.timeout(PATIENCE_S):
            while not inbox.held:
                await asyncio.sleep(0)
        assert outbox.held == 0
        outbox.put(items[0])  # And so does what comes after.
        async with asyncio.timeout(PATIENCE_S):
            while outbox.held:
                await asyncio.sleep(0)

    asyncio.run(put())
    assert drain(inbox) == [*items, items[0]]


def test_what_is_held_is_there_when_the_loop_ends() -> None:
    inbox = Inbox()

    async def put() -> None:
        outbox = Outbox(inbox, asyncio.get_running_loop())
        outbox.put(chunk(b"1"))
        outbox.flush()
        outbox.flush()

    asyncio.run(put())
    assert drain(inbox) == [chunk(b"1")]


@pytest.mark.parametrize("size", [0, 100, 2**18])
def test_what_is_held_is_bounded(size: int) -> None:
    async def put() -> None:
        outbox = Outbox(Inbox(2**30), asyncio.get_running_loop())
        for _ in range(3 * MAX_HELD // (ITEM_COST + size)):
            outbox.put(chunk(bytes(size)))
            assert outbox.held < MAX_HELD

    asyncio.run(put())
