"""Runs the full screen without a terminal, on records that a test gives."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from threading import Event
from typing import TYPE_CHECKING, Any

from mbtool.cli.watching.app import WatchApp
from mbtool.watching.board import MAX_KEPT
from mbtool.watching.watched import Watched
from mbtool.workflows.watch import WatchFeed
from tests.ledger.masters import MS, START_NS

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Iterable

    from textual.pilot import Pilot

    from mbtool.core import OutputError, SerialFormat
    from mbtool.watching.watched_rows import Record

SIZE = (80, 24)
PATIENCE = 500
"""The number of times that a condition is looked at before a test gives up."""


class GivenFeed(WatchFeed):
    """Has no thread: a test gives the records, and the time."""

    def __init__(
        self,
        records: Iterable[Record] = (),
        *,
        kept: int = MAX_KEPT,
        format_: SerialFormat | None = None,
    ) -> None:
        super().__init__(Watched(lambda _: format_, kept=kept))
        self.at_ns = START_NS + 1000 * MS
        self._add(records)

    def start(self) -> None:
        pass

    def give(self, *records: Record) -> None:
        self._add(records)

    def now_ns(self) -> int:
        return self.at_ns

    def _run(self) -> None:
        pass


class Screen:
    """What a test sees of a running screen, and the keys that it presses."""

    def __init__(self, app: WatchApp, pilot: Pilot[int]) -> None:
        self.app = app
        self.pilot = pilot

    async def press(self, *keys: str) -> None:
        await self.pilot.press(*keys)

    async def type(self, text: str) -> None:
        self.app.prompt.value = text
        await self.pilot.pause()

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition holds."""
        for _ in range(PATIENCE):
            if condition():
                return
            await self.pilot.pause(0.02)
        raise AssertionError(self.text)

    async def redraw(self) -> None:
        self.app.draw()
        await self.pilot.pause()

    @property
    def lines(self) -> list[str]:
        """The screen, or the window on it, as it is drawn, line by line."""
        width, height = self.app.size
        strips = self.app.screen._compositor.render_strips()
        return [strip.text[:width].rstrip() for strip in strips][:height]

    @property
    def text(self) -> str:
        return "\n".join(self.lines)

    @property
    def note(self) -> str:
        """The line to the user."""
        return str(self.app.screen_stack[0].query_one("#note").render())

    def number(self) -> int | None:
        """The number of the transaction under the cursor."""
        row: Any = self.app.table.row
        number: int | None = row.kept.number
        return number

    @property
    def rows(self) -> list[Any]:
        return list(self.app.table.rows)


@asynccontextmanager
async def screen(
    feed: WatchFeed, size: tuple[int, int] = SIZE, **options: Any
) -> AsyncIterator[Screen]:
    app = WatchApp(feed, "line", **options)
    async with app.run_test(size=size) as pilot:
        await pilot.pause()
        yield Screen(app, pilot)
    feed.stop()


def run(test: Callable[[], Awaitable[None]]) -> None:
    """Run a test that waits."""

    async def waited() -> None:
        await test()

    asyncio.run(waited())


class NotingSaver:
    """Notes what it is asked to save."""

    def __init__(self, error: OutputError | None = None) -> None:
        self.asked: list[tuple[str, bool]] = []
        self.error = error
        self.goes_on = Event()
        """A save waits for it; set at first."""
        self.goes_on.set()

    def what(self, watched: Watched, *, is_filtered: bool) -> str:
        return f"{len(watched.marked)} marked"

    def job(self, watched: Watched, *, is_filtered: bool, out: str) -> Callable[[], str]:
        def save() -> str:
            assert self.goes_on.wait(30)
            if self.error is not None:
                raise self.error
            self.asked.append((out, is_filtered))
            return "saved it"

        return save
