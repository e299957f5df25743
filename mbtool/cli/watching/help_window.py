"""A window that lists the keys of `mbtool watch`, and explains its signs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group
from rich.table import Table
from rich.text import Text
from textual.binding import Binding
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual.app import ComposeResult

_GROUPS = (
    ("Views", ("view",)),
    ("Rows", (
        "move", "page", "go_to", "detail", "scroll_detail", "sort", "columns", "format",
    )),
    ("Filter, find, save", (
        "ask_filter", "toggle_filter", "freeze", "ask_find", "find_next", "mark", "ask_save",
    )),
    ("Files", ("play", "step", "speed", "seek", "seek_to")),
    ("Screen", ("close", "help", "leave", "interrupt")),
)  # fmt: skip
"""The headings of the window, each with the actions whose keys stand below it."""
_SIGNS = (
    ("reversed", "changed less than a second ago; then bold for four more"),
    ("w", "before a value: a master wrote it; behind a request: it writes"),
    ("x", "in bars: a request without an answer"),
    ("!", "before a code: a broken rule; key 4 says what it means"),
    ("(retry)", "repeats an unanswered request at once, not at its usual period"),
    ("*", "marked"),
    ("?", "as unit: bytes of some unit that cannot be told"),
)
_NAMES = {
    "escape": "Esc", "pageup": "PgUp", "pagedown": "PgDn", "home": "Home", "end": "End",
    "up": "Up", "down": "Down", "left": "Left", "right": "Right", "enter": "Enter",
    "space": "Space", "ctrl+c": "Ctrl-C",
}  # fmt: skip
_KEY_WIDTH = 9


def key_name(binding: Binding) -> str:
    """Return the keys of a binding as a person calls them: `Enter d`."""
    if binding.key_display:
        return binding.key_display
    return " ".join(_NAMES.get(key, key) for key in binding.key.split(","))


def help_text(bindings: Sequence[Binding]) -> Group:
    """Return the lines of the window: all bindings by heading, then the signs."""
    parts: list[Text | Table] = []
    for title, actions in _GROUPS:
        rows = [
            (key_name(binding), binding.description)
            for action in actions
            for binding in bindings
            if binding.action.partition("(")[0] == action
        ]
        parts += [Text(title, "bold"), _table(rows)]
    commands = [("Ctrl-P", "All commands, by name")]
    return Group(*parts, _table(commands), Text("Signs", "bold"), _table(_SIGNS))


def _table(rows: Sequence[tuple[str, str]]) -> Table:
    """Return keys or signs with their meanings; a long meaning goes on below its beginning."""
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(justify="right", width=_KEY_WIDTH, style="bold")
    table.add_column()
    for key, meaning in rows:
        table.add_row(Text(key), Text(meaning))
    return table


class HelpWindow(ModalScreen[None]):
    """The keys, in a window that scrolls."""

    CSS = """
    HelpWindow { align: center middle; }
    HelpWindow > Vertical { width: 76; max-width: 100%; height: auto; max-height: 100%;
        border: solid $accent; padding: 0 1; }
    HelpWindow VerticalScroll { height: auto; max-height: 100%; }
    HelpWindow #help-text { height: auto; }
    HelpWindow #help-title { dock: top; }
    """
    BINDINGS = [  # noqa: RUF012 - textual reads the list from the class
        Binding("escape,question_mark,q", "dismiss(None)", "Leave"),
        Binding("j", "scroll_keys(1)", "Down"),
        Binding("k", "scroll_keys(-1)", "Up"),
    ]

    def __init__(self, bindings: Sequence[Binding]) -> None:
        super().__init__()
        self._text = help_text(bindings)

    def compose(self) -> ComposeResult:
        with Vertical():
            title = "Keys and signs    Up, Down, PgDn: more    Esc: back"
            yield Static(Text(title, "reverse"), id="help-title")
            with VerticalScroll():
                yield Static(self._text, id="help-text")

    def on_mount(self) -> None:
        self.query_one(VerticalScroll).focus()

    def action_scroll_keys(self, by: int) -> None:
        self.query_one(VerticalScroll).scroll_relative(y=by, animate=False)
