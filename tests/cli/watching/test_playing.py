"""The keys that play a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.watching.watched import Watched
from mbtool.workflows.watch import FileFeed
from tests.cli.watching.screens import run, screen
from tests.overview.requests import request

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.watching.watched_rows import Record


def half_a_minute() -> Iterator[Record]:
    for at in range(31):
        yield request(1000 * at)


def test_a_file_is_played_stepped_and_searched_with_keys() -> None:
    async def test() -> None:
        feed = FileFeed(half_a_minute, Watched())

        def shown() -> int:
            return feed.watched.whole.transactions

        async with screen(feed, (120, 24)) as seen:
            await seen.until(lambda: feed.is_read)
            await seen.redraw()
            assert "0:30.0 of 0:30.0" in seen.lines[1]
            assert "play" in seen.lines[-1]
            await seen.press("less_than_sign")
            await seen.until(lambda: shown() == 1)
            await seen.press("full_stop")
            await seen.until(lambda: shown() == 2)
            await seen.press("right")
            await seen.until(lambda: shown() == 12)
            await seen.redraw()
            assert "paused 0:11.0 of 0:30.0 x1" in seen.lines[1]
            await seen.press("left")
            await seen.until(lambda: shown() == 2)
            await seen.press("plus", "plus", "minus", "p")
            await seen.until(lambda: shown() > 2)
            await seen.redraw()
            assert "playing" in seen.lines[1]
            assert "x2" in seen.lines[1]
            await seen.press("p", "greater_than_sign")
            await seen.until(lambda: shown() == 31)

    run(test)
