"""Every key of the full screen does what it is for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.widgets import OptionList

from mbtool.cli import exit_codes
from mbtool.watching.watched import Watched
from mbtool.workflows.watch import FileFeed
from tests.cli.watching.key_log import DECLARED, KeyLog, bound_keys, presses
from tests.cli.watching.screens import GivenFeed, NotingSaver, Screen, screen
from tests.ledger.requests import request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.watching.watched_rows import Record

UNITS = 40
HEADINGS = {
    "2": "reference", "3": "request -> response", "4": "meaning, or last event", "5": "state",
    "6": "bus load, links", "1": "last values",
}  # fmt: skip
"""The keys of the views in the order in which they are pressed, with what stands in each."""
FILE_KEYS = (
    "p", "full_stop", "plus", "equals_sign", "minus", "left", "right", "less_than_sign",
    "greater_than_sign",
)  # fmt: skip


def many() -> GivenFeed:
    """More rows in each view than fit a screen."""
    return GivenFeed(
        request(
            10 * unit, unit=unit, reference="holding 0..1", quantity=2,
            response_values=[unit, 2 * unit], findings=["MB-404"],
        )
        for unit in range(1, UNITS + 1)
    )  # fmt: skip


def at(seen: Screen, index: int) -> Callable[[], bool]:
    return lambda: seen.app.table.cursor == index


def has(seen: Screen, text: str) -> Callable[[], bool]:
    """A condition: the text stands on the screen."""
    return lambda: text in seen.text


def lacks(seen: Screen, text: str) -> Callable[[], bool]:
    return lambda: text not in seen.text


def typed(seen: Screen, text: str) -> Callable[[], bool]:
    return lambda: seen.app.prompt.value == text


def test_each_key_that_is_bound_is_pressed_by_a_test() -> None:
    assert set(bound_keys()) == DECLARED


@presses(
    WatchApp="1 2 3 4 5 6 up down k j pageup pagedown home end g G enter d escape x "
    "left_square_bracket right_square_bracket space"
)
async def test_in_each_view_the_cursor_moves_and_rows_have_a_detail(keys: KeyLog) -> None:
    async with screen(many()) as seen:
        for view, heading in HEADINGS.items():
            await keys.press(seen, view, has(seen, heading))
            await _move(keys, seen)
            if view in "1235":
                await _look_into_a_row(keys, seen, "asked 1," if view == "5" else "request  01 03")
            if view in "123":
                await keys.press(seen, "x", lambda: "shown decimal" in seen.note)
                await keys.press(seen, "escape", lambda: not seen.note)
            await keys.press(seen, "space", has(seen, "FROZEN"))
            await keys.press(seen, "space", lacks(seen, "FROZEN"))


async def _move(keys: KeyLog, seen: Screen) -> None:
    page, last = seen.app.table.page, len(seen.rows) - 1
    assert last > 2
    if seen.app.table.cursor == 0:
        await keys.press(seen, "end", at(seen, last))
    await keys.press(seen, "home", at(seen, 0))
    await keys.press(seen, "down", at(seen, 1))
    await keys.press(seen, "j", at(seen, 2))
    await keys.press(seen, "up", at(seen, 1))
    await keys.press(seen, "k", at(seen, 0))
    await keys.press(seen, "pagedown", at(seen, min(page, last)))
    await keys.press(seen, "pageup", at(seen, 0))
    await keys.press(seen, "G", at(seen, last))
    await keys.press(seen, "g", at(seen, 0))


async def _look_into_a_row(keys: KeyLog, seen: Screen, text: str) -> None:
    await keys.press(seen, "d", has(seen, text))
    await keys.press(seen, "d", lacks(seen, text))
    await keys.press(seen, "enter", has(seen, text))
    if text.startswith("request"):
        pane = seen.app.screen.query_one("#detail")
        pane.styles.height = 4
        await seen.pilot.pause()
        await keys.press(seen, "right_square_bracket", lambda: pane.scroll_offset.y > 0)
        await keys.press(seen, "left_square_bracket", lambda: pane.scroll_offset.y == 0)
        pane.styles.height = 10
        await seen.pilot.pause()
    await keys.press(seen, "escape", lacks(seen, text))


@presses(WatchApp="slash backslash f n N", PromptLine="enter escape up down")
async def test_what_is_typed_filters_and_finds(keys: KeyLog) -> None:
    async with screen(many()) as seen:
        for unit in (7, 8):
            await keys.press(seen, "slash", has(seen, "a filter, as of --where"))
            await seen.type(f"unit == {unit}")
            await keys.press(seen, "enter", has(seen, f"1 passes: unit == {unit}"))
            await keys.press(seen, "backslash", has(seen, f"filter off: unit == {unit}"))
            assert len(seen.rows) == UNITS
            seen.app.where = ""
        await seen.press("slash")
        for key, text in (("up", "unit == 8"), ("up", "unit == 7"), ("down", "unit == 8")):
            await keys.press(seen, key, typed(seen, text))
        await keys.press(seen, "escape", lambda: not seen.app.prompt.has_focus)
        assert len(seen.rows) == UNITS
        await keys.press(seen, "f", has(seen, "a text, or bytes in hexadecimal"))
        await seen.type("holding")
        await keys.press(seen, "enter", lambda: "row 2 of 40 requests; n next, N back" in seen.note)
        await keys.press(seen, "n", at(seen, 2))
        await keys.press(seen, "N", at(seen, 1))


@presses(WatchApp="m s", PromptLine="enter")
async def test_a_mark_is_set_and_taken_away_and_what_is_marked_is_saved(keys: KeyLog) -> None:
    saver = NotingSaver()
    async with screen(many(), saver=saver) as seen:
        await seen.press("3", "home")
        await keys.press(seen, "m", lambda: seen.lines[3].startswith("*"))
        await seen.press("up")
        await keys.press(seen, "m", lacks(seen, "1 marked"))
        await seen.press("m")
        await keys.press(seen, "s", has(seen, "save 1 marked as FILE.mcap"))
        await seen.type("part.mcap")
        await keys.press(seen, "enter", lambda: seen.note == "saved it")
        assert saver.asked == [("part.mcap", False)]


@presses(
    WatchApp="o c",
    SortChoice="down up end home pagedown pageup enter escape",
    ColumnChoice="down up end home pagedown pageup space enter escape u",
)
async def test_windows_choose_the_order_and_the_columns(keys: KeyLog) -> None:
    async with screen(many()) as seen:

        def marked(index: int) -> Callable[[], bool]:
            return lambda: seen.app.screen.query_one(OptionList).highlighted == index

        async def walk(last: int) -> None:
            for key, index in (
                ("end", last), ("home", 0), ("pagedown", last), ("pageup", 0), ("down", 1),
                ("up", 0), ("down", 1),
            ):  # fmt: skip
                await keys.press(seen, key, marked(index))

        await keys.press(seen, "o", has(seen, "sort by; the same again"))
        await keys.press(seen, "escape", lacks(seen, "sort by"))
        await seen.press("o", "home")
        await walk(13)
        await seen.press("down", "down")
        await keys.press(seen, "enter", has(seen, "un^"))
        await keys.press(seen, "c", has(seen, "space turns one on or off"))
        await keys.press(seen, "escape", lacks(seen, "space turns"))
        await seen.press("c", "home")
        await walk(12)
        await keys.press(seen, "space", has(seen, "[x] master"))
        await keys.press(seen, "enter", lambda: seen.lines[2].startswith("master"))
        await seen.press("c")
        await keys.press(seen, "u", lambda: seen.lines[2].split()[0] == "un^")


@presses(WatchApp="question_mark ctrl+p", HelpWindow="question_mark escape q j k")
async def test_the_keys_and_the_palette_are_shown_and_left(keys: KeyLog) -> None:
    async with screen(many()) as seen:
        for leave in ("question_mark", "escape", "q"):
            await keys.press(seen, "question_mark", lambda: len(seen.app.screen_stack) > 1)
            if leave == "q":
                await keys.press(seen, "j", lambda: "Views" not in seen.text)
                await keys.press(seen, "k", has(seen, "Views"))
            await keys.press(seen, leave, lambda: len(seen.app.screen_stack) == 1)
        assert seen.app.is_running
        await keys.press(seen, "ctrl+p", lambda: len(seen.app.screen_stack) > 1)
        await seen.press(*"detail")
        await seen.until(has(seen, "key ["))


@presses(WatchApp="q ctrl+q ctrl+c")
async def test_keys_that_end_the_screen_give_its_exit_code(keys: KeyLog) -> None:
    for key, code in (("q", exit_codes.DONE), ("ctrl+c", exit_codes.INTERRUPTED), ("ctrl+q", None)):
        async with screen(many()) as seen:
            await keys.press(seen, key, lambda: not seen.app.is_running)
            assert seen.app.return_value == code


@presses(WatchApp=" ".join(FILE_KEYS))
async def test_keys_of_files_say_that_a_link_cannot_be_played(keys: KeyLog) -> None:
    async with screen(many()) as seen:
        for key in FILE_KEYS:
            seen.app.tell("")
            await keys.press(seen, key, lambda: "only files can be played" in seen.note)


def half_a_minute() -> Iterator[Record]:
    for second in range(31):
        yield request(1000 * second)


@presses(WatchApp=" ".join(FILE_KEYS))
async def test_a_file_is_played_stepped_and_searched(keys: KeyLog) -> None:
    feed = FileFeed(half_a_minute, Watched())

    def shows(number: int) -> Callable[[], bool]:
        return lambda: feed.watched.whole.account.transactions == number

    async with screen(feed, (120, 24)) as seen:
        await seen.until(lambda: feed.is_read)
        await seen.redraw()
        assert "0:30.0 of 0:30.0" in seen.lines[1]
        assert "play" in seen.lines[-1]
        await keys.press(seen, "less_than_sign", shows(1))
        await keys.press(seen, "full_stop", shows(2))
        await keys.press(seen, "right", shows(12))
        await seen.until(has(seen, "paused 0:11.0 of 0:30.0 x1"))
        await keys.press(seen, "left", shows(2))
        await keys.press(seen, "plus", has(seen, "x2"))
        await keys.press(seen, "equals_sign", has(seen, "x4"))
        await keys.press(seen, "minus", has(seen, "x2"))
        await keys.press(seen, "p", has(seen, "playing"))
        await seen.until(lambda: feed.watched.whole.account.transactions > 2)
        await keys.press(seen, "p", has(seen, "paused"))
        await keys.press(seen, "greater_than_sign", shows(31))
