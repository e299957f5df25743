"""Tests that press keys of the full screen, and the list of the keys that it binds."""

# A key is named with the place that it goes to: the table ("WatchApp"), the line in which one types
# ("PromptLine"), or a window ("SortChoice", "ColumnChoice"). A test says which it presses; it fails
# if it pressed others, or if the effect of one was there before. What is bound, the program says.

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.app import App
from textual.binding import Binding
from textual.widgets import OptionList

from mbtool.cli.watching.app import ColumnChoice, HelpWindow, SortChoice, WatchApp
from mbtool.cli.watching.prompt import PromptLine
from tests.cli.watching.screens import run

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

    from tests.cli.watching.screens import Screen

    Key = tuple[str, str]

DECLARED: set[Key] = set()
"""The keys that the tests say they press."""


class KeyLog:
    """Presses keys, sees their effects, and notes both."""

    def __init__(self) -> None:
        self.pressed: set[Key] = set()

    async def press(self, seen: Screen, key: str, effect: Callable[[], bool]) -> None:
        """Press a key whose effect is not there yet, and wait for it."""
        place = _place(seen.app)
        assert not effect(), f"{place}: {key} would change nothing"
        await seen.press(key)
        await seen.until(effect)
        self.pressed.add((place, key))


def presses(
    **keys: str,
) -> Callable[[Callable[[KeyLog], Awaitable[None]]], Callable[[], None]]:
    """Make a test of a function that presses just these keys; each place names its keys."""
    declared = {(place, key) for place, names in keys.items() for key in names.split()}
    DECLARED.update(declared)

    def decorate(press: Callable[[KeyLog], Awaitable[None]]) -> Callable[[], None]:
        def test() -> None:
            log = KeyLog()
            run(lambda: press(log))
            assert log.pressed == declared

        return test

    return decorate


def bound_keys() -> Iterator[Key]:
    """Each key that the full screen or one of its windows binds.

    Of textual's own, those that choose in a list, enter a text, and leave; not those that edit.
    """
    own = (WatchApp, PromptLine, ColumnChoice, SortChoice, HelpWindow)
    bound = [(one.__name__, binding) for one in own for binding in one.BINDINGS]
    bound += [("WatchApp", binding) for binding in App.BINDINGS]
    windows = (ColumnChoice, SortChoice)
    bound += [(one.__name__, binding) for one in windows for binding in OptionList.BINDINGS]
    for place, binding in bound:
        assert isinstance(binding, Binding)
        for key in binding.key.split(","):
            yield place, key
    yield "PromptLine", "enter"
    yield "WatchApp", App.COMMAND_PALETTE_BINDING


def _place(app: WatchApp) -> str:
    if len(app.screen_stack) > 1:
        return type(app.screen).__name__
    return "PromptLine" if app.prompt.has_focus else "WatchApp"
