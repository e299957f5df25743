"""Saving from the full screen: the line for the name, and what is told."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import OutputError
from tests.cli.watching.screens import GivenFeed, NotingSaver, run, screen
from tests.ledger.requests import request

if TYPE_CHECKING:
    import pytest

    from tests.cli.watching.screens import Screen


def line() -> GivenFeed:
    return GivenFeed([request(0)])


def is_typed_into(seen: Screen) -> bool:
    return seen.app.prompt.has_focus


def test_a_save_that_fails_is_told_and_the_name_can_be_typed_again() -> None:
    async def test() -> None:
        saver = NotingSaver(OutputError("disk full"))
        async with screen(line(), saver=saver) as seen:
            await seen.press("s")
            assert "as FILE.mcap, .pcapng or .pcap" in seen.text
            await seen.type("part.mcap")
            await seen.press("enter")
            await seen.until(lambda: seen.note == "disk full")
            assert is_typed_into(seen)
            await seen.press("q")
            assert seen.app.prompt.value == "part.mcapq"
            saver.error = None
            await seen.press("enter")
            await seen.until(lambda: seen.note == "saved it")
            assert not is_typed_into(seen)
            await seen.press("s", "enter")
            assert not is_typed_into(seen)
            assert saver.asked == [("part.mcapq", False)]

    run(test)


def test_while_a_save_runs_one_can_go_on_but_not_save_again() -> None:
    async def test() -> None:
        saver = NotingSaver()
        saver.goes_on.clear()
        async with screen(line(), saver=saver) as seen:
            await seen.press("s")
            await seen.type("part.mcap")
            await seen.press("enter", "enter")
            told = [seen.note]
            await seen.press("escape")
            await seen.until(lambda: not is_typed_into(seen))
            await seen.press("s")
            told.append(seen.note)
            await seen.press("slash")
            await seen.until(lambda: is_typed_into(seen))
            saver.goes_on.set()
            assert told == ["saving part.mcap ..."] * 2
            await seen.until(lambda: seen.note == "saved it")
            assert seen.app.prompt.has_focus
            assert saver.asked == [("part.mcap", False)]

    run(test)


def test_what_a_save_says_after_the_screen_was_left_is_kept_for_the_terminal() -> None:
    async def test() -> None:
        saver = NotingSaver(OutputError("disk full"))
        saver.goes_on.clear()
        async with screen(line(), saver=saver) as seen:
            await seen.press("s")
            await seen.type("part.mcap")
            await seen.press("enter", "ctrl+c")
            unsaid = seen.app.unsaid
            saver.goes_on.set()
            await seen.until(lambda: seen.app.unsaid == "disk full")
            assert unsaid is None

    run(test)


def test_escape_takes_the_error_of_a_save_away() -> None:
    async def test() -> None:
        async with screen(line(), saver=NotingSaver(OutputError("disk full"))) as seen:
            await seen.press("s")
            await seen.type("part.mcap")
            await seen.press("enter")
            await seen.until(lambda: seen.note == "disk full")
            await seen.press("escape")
            assert not seen.note
            assert not seen.app.prompt.has_focus

    run(test)


def test_a_tilde_in_the_name_to_save_is_the_home_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/the-home")

    async def test() -> None:
        saver = NotingSaver()
        async with screen(line(), saver=saver) as seen:
            await seen.press("s")
            await seen.type("~/part.mcap")
            await seen.press("enter")
            await seen.until(lambda: seen.note == "saved it")
            assert saver.asked == [("/the-home/part.mcap", False)]

    run(test)


def test_without_a_saver_s_says_so() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("s")
            assert "nothing to save" in seen.note

    run(test)
