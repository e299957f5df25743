"""The full screen of `mbtool watch`: its keys, and the actions behind them."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, ClassVar

from rich.console import Group
from rich.table import Table
from rich.text import Text
from textual.app import ComposeResult, SystemCommand
from textual.binding import Binding
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen, Screen
from textual.widgets import OptionList, Static
from textual.widgets.option_list import Option

from mbtool.cli import exit_codes
from mbtool.cli.watching.drawn_app import DrawnApp
from mbtool.cli.watching.prompt import (
    Asking,
    PromptLine,
    find_row,
    hex_bytes,
    read_filter,
    why_wrong,
)
from mbtool.cli.watching.watch_views import VIEWS
from mbtool.core import MbtoolError, UsageError
from mbtool.views.watch_columns import WatchColumn, left_out
from mbtool.workflows.watch import FileFeed

# Small windows in which the user chooses columns, or the column to sort by.

AS_IT_COMES = ""
"""The result of SortChoice for no sorting: rows stay in the order in which they come."""
_CSS = """
%s { align: center middle; }
%s > Vertical { width: 56; height: auto; max-height: 90%%; border: solid $accent; padding: 0 1; }
%s OptionList { height: auto; max-height: 16; border: none; padding: 0; }
"""


class ColumnChoice(ModalScreen[list[str] | None]):
    """A window whose result is the names of the columns that the user wants.

    An empty list stands for the usual columns, and None for no change.
    """

    CSS = _CSS % (("ColumnChoice",) * 3)
    BINDINGS = [  # noqa: RUF012 - textual reads the list from the class
        Binding("escape", "dismiss(None)", "Leave"),
        Binding("enter", "take", "Take", priority=True),
        Binding("space", "turn", "On or off", priority=True),
        Binding("u", "usual", "The usual columns"),
    ]

    def __init__(
        self,
        columns: Sequence[WatchColumn],
        wanted: Collection[str],
        left_out: Mapping[str, str] | None = None,
    ) -> None:
        """`wanted` are the names of columns that are on; `left_out` says by name why some of them
        are not seen all the same.
        """
        super().__init__()
        self._columns, self._wanted = columns, set(wanted)
        self._before, self._left_out = frozenset(wanted), left_out or {}

    def compose(self) -> ComposeResult:
        with Vertical():
            yield Static("space turns one on or off, enter takes, u: the usual", markup=False)
            yield OptionList(*(Option(self._line(one), one.name) for one in self._columns))

    def _line(self, column: WatchColumn) -> Text:
        # The sign shows the state without colour, too.
        line = Text(f"{'[x]' if column.name in self._wanted else '[ ]'} {column.name}")
        why = self._left_out.get(column.name) if column.name in self._before else None
        return line if why is None else line.append(f"  {why}", "dim")

    def action_turn(self) -> None:
        options = self.query_one(OptionList)
        at = options.highlighted
        if at is not None:
            self._wanted ^= {self._columns[at].name}
            options.replace_option_prompt_at_index(at, self._line(self._columns[at]))

    def action_take(self) -> None:
        names = [one.name for one in self._columns if one.name in self._wanted]
        self.dismiss(None if self._wanted == self._before else names)

    def action_usual(self) -> None:
        self.dismiss([])


class SortChoice(ModalScreen[str | None]):
    """A window whose result is the name of the column to sort by; AS_IT_COMES for no sorting."""

    CSS = _CSS % (("SortChoice",) * 3)
    BINDINGS = [Binding("escape", "dismiss(None)", "Leave")]  # noqa: RUF012 - see above

    def __init__(self, columns: Sequence[WatchColumn], sorted_by: str | None) -> None:
        super().__init__()
        self._columns, self._sorted_by = columns, sorted_by

    def compose(self) -> ComposeResult:
        with Vertical():
            yield Static("sort by; the same again turns the order", markup=False)
            options = [Option("as it comes", "-")]
            options += [Option(one.name, one.name) for one in self._columns]
            yield OptionList(*options)

    def on_mount(self) -> None:
        choice = self.query_one(OptionList)
        names = [AS_IT_COMES, *(one.name for one in self._columns)]
        # The settings may name a column that this version does not have.
        choice.highlighted = names.index(self._sorted_by) if self._sorted_by in names else 0

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        name = event.option.id
        self.dismiss(AS_IT_COMES if name in (None, "-") else name)


# A window that lists the keys of `mbtool watch`, and explains its signs.

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


# Handles what the user types into the prompt: a filter, a text to find, a file to save to.

_TYPING_S = 0.15
"""A filter is applied when the user has typed nothing for this long, in s."""


class PromptedApp(DrawnApp):
    """The full screen with a prompt line, in which the user types."""

    @property
    def prompt(self) -> PromptLine:
        return self.screen_stack[0].query_one(PromptLine)

    def action_ask_filter(self) -> None:
        self._before_typing = self.where
        hint = 'a filter, as of --where: unit == 5 and outcome != "ok"; up: earlier ones'
        self.prompt.ask(Asking.FILTER, self.where, self.settings.filters, hint)

    def action_toggle_filter(self) -> None:
        if not self.where:
            self.tell("there is no filter; / makes one")
            return
        self.filter_is_on = not self.filter_is_on
        self._redraw_after_filter()

    def _redraw_after_filter(self) -> None:
        """Draw the screen after the filter has changed.

        A frozen screen is frozen again at this moment, since its rows passed the old filter.
        """
        if self.frozen is not None:
            self.frozen = None
            self.action_freeze()
        self.draw()

    def on_input_changed(self, event: PromptLine.Changed) -> None:
        if self.prompt.asking is Asking.FILTER and self.prompt.has_class("asking"):
            self._typed_at += 1
            self.set_timer(_TYPING_S, self._typed(self._typed_at, event.value))

    def _typed(self, number: int, text: str) -> Callable[[], None]:
        """Return a function that applies the typed text, unless the user typed more since.

        `number` counts the changes of the text; a newer change has a greater number.
        """

        def apply() -> None:
            if number == self._typed_at:
                self.apply_filter(text)

        return apply

    def apply_filter(self, text: str) -> bool:
        """Set the filter to the expression `text` and return True; an empty text removes it.

        If the expression is wrong, keep the old filter, show the place of the error, and return
        False.
        """
        try:
            wanted = read_filter(text)
        except UsageError as error:
            at, reason = why_wrong(text, error)
            self.tell(f"{' ' * min(at, max(self.size.width - 20, 0))}^ {reason}", "red")
            return False
        self.tell("")
        if text.strip() != self.where or (wanted is None) != (self.feed.watched.filtered is None):
            self.feed.set_filter(wanted)
            self.where = text.strip()
        self.filter_is_on = wanted is not None
        self._redraw_after_filter()
        return True

    def on_input_submitted(self) -> None:
        prompt, text = self.prompt, self.prompt.value
        match prompt.asking:
            case Asking.FILTER:
                self._typed_at += 1
                if not self.apply_filter(text):
                    return
                if self.where:
                    self.settings.note_filter(self.where)
                    self._remember()
            case Asking.FIND:
                self._found = text.strip()
                self.action_find_next(1)
            case Asking.SAVE if text.strip():
                self._save(text.strip())
                return  # The line stays until the file is saved, so that its name can be mended.
        self._leave_prompt()

    def on_prompt_line_left(self) -> None:
        if self.prompt.asking is Asking.FILTER:
            self._typed_at += 1
            self.apply_filter(self._before_typing)
        elif self._saving is None:
            self.tell("")
        self._leave_prompt()

    def _leave_prompt(self) -> None:
        self.prompt.close()
        self.table.focus()

    def action_ask_find(self) -> None:
        hint = "a text, or bytes in hexadecimal: 01 03 00"
        self.prompt.ask(Asking.FIND, self._found, (), hint)

    def action_find_next(self, step: int) -> None:
        if not self._found:
            return
        table = self.table
        at = find_row(table.rows, self.view.columns, self._found, table.cursor, step)
        if at is None:
            self.tell(self._not_found())
        else:
            place = f"row {at + 1:,} of {len(table.rows):,} {self.view.row_noun}"
            self.tell(f"{self._found}: {place}; n next, N back")
            table.go_to(at)

    def _not_found(self) -> str:
        """Return the text for the user that nothing was found, and where it may still be."""
        searched = "as text or bytes" if hex_bytes(self._found) else "as text"
        if not self.view.can_follow or not self._notes:
            return f"not found {searched}: {self._found}"
        text = f"not found {searched} among the {self._notes[0]}: {self._found}"
        if self.feed.keeps_all:
            return f"{text}; / filters all"
        return text if self.feed.is_live else f"{text}; --where filters all"

    def action_ask_save(self) -> None:
        if self._saver is None:
            self.tell("there is nothing to save from")
            return
        if self._saving is not None:
            self.tell(self._saving)
            return
        what = self._saver.what(self.feed.watched, is_filtered=self.filter_is_on)
        self.prompt.ask(Asking.SAVE, "", (), f"save {what} as FILE.mcap, .pcapng or .pcap")

    def _save(self, name: str) -> None:
        if self._saver is None or self._saving is not None:
            return
        out = os.path.expanduser(name)
        with self.feed.lock:
            job = self._saver.job(self.feed.watched, is_filtered=self.filter_is_on, out=out)
        self._saving = f"saving {name} ..."
        self.tell(self._saving)
        self.run_worker(lambda: self._run_job(job), thread=True)

    def _run_job(self, job: Callable[[], str]) -> None:
        """Save in a thread of its own, and tell how it went."""
        is_done = True
        try:
            self.unsaid = job()
        except (MbtoolError, OSError) as error:
            self.unsaid, is_done = str(error), False
        with suppress(RuntimeError):  # The screen is closed, and textual does not run any more.
            self.call_from_thread(self._note_saved, is_done=is_done)

    def _note_saved(self, *, is_done: bool) -> None:
        self._saving = None
        if self.return_value is not None or self.unsaid is None or not self.is_up:
            return
        self.tell(self.unsaid, "green" if is_done else "bold red")
        self.unsaid = None
        if is_done and self.prompt.asking is Asking.SAVE:
            self._leave_prompt()


_SEEK_NS = 10_000_000_000
_TRANSACTIONS = 2


class WatchApp(PromptedApp):
    """The full screen that the command runs."""

    BINDINGS: ClassVar[list[Binding]] = [  # type: ignore[assignment]
        *(
            Binding(str(key), f"view({key - 1})", f"View {view.name}")
            for key, view in enumerate(VIEWS, 1)
        ),
        Binding("slash", "ask_filter", "Filter", key_display="/"),
        Binding("backslash", "toggle_filter", "Filter off and on", key_display="\\"),
        Binding("space", "freeze", "Freeze the view, or go on"),
        Binding("f", "ask_find", "Find text or hex"),
        Binding("n", "find_next(1)", "Find the next"),
        Binding("N", "find_next(-1)", "Find the one before"),
        Binding("m", "mark", "Mark a transaction and go on to the next"),
        Binding("s", "ask_save", "Save what is marked, else what is filtered"),
        Binding("o", "sort", "Sort by a column"),
        Binding("c", "columns", "Choose columns"),
        Binding("x", "format(1)", "Next format of the row: hex, signed, float32"),
        Binding("enter,d", "detail", "Detail"),
        Binding("p", "play", "Play or pause a file"),
        Binding("full_stop", "step", "One transaction more", key_display="."),
        Binding("plus,equals_sign", "speed(1)", "Play faster", key_display="+"),
        Binding("minus", "speed(-1)", "Play slower", key_display="-"),
        Binding("left", "seek(-1)", "Jump back 10 s"),
        Binding("right", "seek(1)", "Jump on 10 s"),
        Binding("less_than_sign", "seek_to(0)", "To the beginning of the file", key_display="<"),
        Binding("greater_than_sign", "seek_to(1)", "To the end of the file", key_display=">"),
        Binding("up,k", "move(-1)", "Up", show=False),
        Binding("down,j", "move(1)", "Down", show=False),
        Binding("pageup", "page(-1)", "Page up", show=False),
        Binding("pagedown", "page(1)", "Page down", show=False),
        Binding("home,g", "go_to(0)", "First row", show=False),
        Binding("end,G", "go_to(-1)", "Last row", show=False),
        Binding("left_square_bracket", "scroll_detail(-3)", "Detail up", key_display="["),
        Binding("right_square_bracket", "scroll_detail(3)", "Detail down", key_display="]"),
        Binding("escape", "close", "Close what is open", show=False),
        Binding("question_mark", "help", "Keys and signs", key_display="?"),
        Binding("q", "leave", "Quit"),
        Binding("ctrl+c", "interrupt", "Quit, as when interrupted", show=False, priority=True),
    ]

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        for binding in self.BINDINGS:
            if binding.show:
                key = key_name(binding)
                yield SystemCommand(binding.description, f"key {key}", self._runner(binding.action))
        for command in super().get_system_commands(screen):
            if command.title in ("Theme", "Screenshot"):  # textual's others do nothing useful here.
                yield command

    def _runner(self, action: str) -> Callable[[], Any]:
        return lambda: self.run_action(action)

    def action_view(self, at: int) -> None:
        row = self.table.row
        self._cursor_keys[self.view_at] = None if row is None else row.key
        follows = self.table.follows
        if self.view.can_follow:
            self._follows = follows
        self.view_at = at
        if not self._note_stays and self._saving is None:
            self.tell("")
        starts_following = self.view.can_follow and self._follows
        self.table.begin_view(follows=starts_following, key=self._cursor_keys[at])
        self.draw()

    def action_move(self, by: int) -> None:
        self.table.move(by)

    def action_page(self, by: int) -> None:
        self.table.move(by * self.table.page)

    def action_go_to(self, index: int) -> None:
        self.table.go_to(index if index >= 0 else len(self.table.rows) - 1)

    def on_live_table_moved(self) -> None:
        self._draw_detail()

    def action_detail(self) -> None:
        self.screen_stack[0].query_one("#detail").toggle_class("open")
        self.call_after_refresh(self.draw)

    def action_scroll_detail(self, by: int) -> None:
        self.screen_stack[0].query_one("#detail").scroll_relative(y=by, animate=False)

    def action_close(self) -> None:
        self.tell("")
        self.screen_stack[0].query_one("#detail").remove_class("open")
        self.call_after_refresh(self.draw)

    def action_help(self) -> None:
        self.push_screen(HelpWindow(self.BINDINGS))

    def action_mark(self) -> None:
        row = self.table.row
        if self.view_at != _TRANSACTIONS or row is None:
            is_here = self.view_at == _TRANSACTIONS
            self.tell("nothing to mark" if is_here else "marks are for transactions: key 3")
            return
        if not self.feed.watched.toggle_mark(row.kept):
            self.tell("no more can be marked; save these first")
        self.table.move(1)
        self.draw()

    def action_format(self, _: int) -> None:
        row = self.table.row
        if row is None or self.view_at > _TRANSACTIONS:
            return
        form = self.context.format_of(row.key).next
        self.context.formats[row.key] = form
        self.tell(f"shown {form.value}")
        self.draw()

    def action_sort(self) -> None:
        self.push_screen(SortChoice(self.view.columns, self._sorting[0]), self._sort)

    def _sort(self, name: str | None) -> None:
        if name is None:
            return
        before, descending = self._sorting
        if name == AS_IT_COMES:
            self.settings.sorted_by.pop(self.view.name, None)
        else:
            self.settings.sorted_by[self.view.name] = name, name == before and not descending
        self._remember()

    def action_columns(self) -> None:
        chosen = self.settings.columns.get(self.view.name)
        columns = self.view.columns
        names = [one.name for one in columns if one.is_usual]
        unseen = left_out(columns, self.table.columns, self.size.width, self._widest[self.view_at])
        self.push_screen(ColumnChoice(columns, chosen or names, unseen), self._choose)

    def _choose(self, names: list[str] | None) -> None:
        if names is None:
            return
        if names:
            self.settings.columns[self.view.name] = names
        else:
            self.settings.columns.pop(self.view.name, None)
        self._remember()

    # The actions below play a file; they do nothing while links are watched.

    @property
    def file_feed(self) -> FileFeed | None:
        """The feed (source of records) if it reads files and has read them to the end; else None.

        If it is None, the screen tells the user why.
        """
        feed = self.feed
        if not isinstance(feed, FileFeed):
            self.tell("only files can be played; space freezes the view")
            return None
        if not feed.is_read:
            self.tell("the file is still being read")
            return None
        return feed

    def action_play(self) -> None:
        if feed := self.file_feed:
            feed.play()
            self.draw()

    def action_step(self) -> None:
        if feed := self.file_feed:
            feed.step()

    def action_speed(self, sign: int) -> None:
        if feed := self.file_feed:
            feed.faster() if sign > 0 else feed.slower()
            self.draw()

    def action_seek(self, sign: int) -> None:
        if feed := self.file_feed:
            feed.seek(sign * _SEEK_NS)

    def action_seek_to(self, share: float) -> None:
        if feed := self.file_feed:
            feed.seek_to(share)

    def action_leave(self) -> None:
        self.exit(exit_codes.DONE, message=self._saving)

    def action_interrupt(self) -> None:
        self.exit(exit_codes.INTERRUPTED, message=self._saving)
