"""Draws the full screen of `mbtool watch`; the keys are in app.py."""

# The app only draws: a timer takes a snapshot of the view's rows under the feed's lock and draws
# it, at most DRAWS_PER_S times a second, and less often where drawing takes long (_SHARE). While
# the user freezes the view, the rows of all views stay as they were at that moment.

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from rich.text import Text
from textual.app import App, ComposeResult
from textual.containers import VerticalScroll
from textual.widgets import Static

from mbtool.cli import exit_codes
from mbtool.cli.watching.live_table import LiveTable
from mbtool.cli.watching.prompt import PromptLine
from mbtool.cli.watching.spans import OneLine, is_plain, style_of, text_of
from mbtool.cli.watching.status_line import ScreenState, keys_line, status_text, tabs_text
from mbtool.cli.watching.watch_views import VIEWS, WatchView
from mbtool.core import InputError, MbtoolError
from mbtool.core.errors import reason_of
from mbtool.core.replacing import make_folder, replace_content
from mbtool.views.trouble_lines import watch_text
from mbtool.views.watch_columns import DrawContext, Spans, fitted, widest_cells
from mbtool.views.watch_detail import record_detail, slave_detail, trouble_detail
from mbtool.views.watch_places import PlaceColumn, place_columns
from mbtool.watching.board import Board, WatchedSlaveRow
from mbtool.watching.watched_rows import TroubleRow
from mbtool.workflows.watch import FileFeed, WatchFeed

if TYPE_CHECKING:
    from mbtool.workflows.watch_saving import Saver

# The settings that `watch` remembers from run to run: columns, sorting, filters.
#
# The settings are one JSON file in the user's config folder. If the file cannot be used, the user
# is told, and the file is kept under another name when the next change writes a new one.

MAX_FILTERS = 20
_DAMAGED = ".damaged"
_WHAT = "columns, sorting and filters"


class WatchSettings(msgspec.Struct, omit_defaults=True):
    """The user's choices for the views of `mbtool watch`: columns, sorting, filters."""

    columns: dict[str, list[str]] = {}
    """The names of the columns of a view, by the view's name; a view that is absent has its usual
    columns."""
    sorted_by: dict[str, tuple[str, bool]] = {}
    """For a view: the column that its rows are sorted by, and True if the greatest value comes
    first."""
    filters: list[str] = []
    """The texts of the last filters, the newest first."""

    def note_filter(self, text: str) -> None:
        """Remember a filter as the newest one."""
        self.filters = [text, *(one for one in self.filters if one != text)][:MAX_FILTERS]


def settings_path() -> Path:
    """Return the path of the settings file (XDG Base Directory Specification)."""
    folder = os.environ.get("XDG_CONFIG_HOME") or ""
    if not os.path.isabs(folder):  # The specification says to ignore a relative path.
        local = os.environ.get("APPDATA") if sys.platform == "win32" else None
        folder = local or str(Path.home() / ".config")
    return Path(folder) / "mbtool" / "watch.json"


def load_settings() -> tuple[WatchSettings, str | None]:
    """Return the settings, and a line for the user if their file cannot be used, else None."""
    try:
        return _read(settings_path()) or WatchSettings(), None
    except RuntimeError:  # There is no home folder.
        return WatchSettings(), None
    except InputError as error:
        return WatchSettings(), f"{error}; {_WHAT} are the usual ones"


def save_settings(settings: WatchSettings) -> str | None:
    """Write the settings file; return None, or a line for the user if that fails.

    A file that cannot be used is kept under another name, which ends in _DAMAGED.
    """
    problem = f"{_WHAT} are not remembered: "
    try:
        path = settings_path()
    except RuntimeError:
        return f"{problem}there is no home folder"
    try:
        make_folder(path.parent)
        _keep_damaged(path)
        replace_content(path, msgspec.json.format(msgspec.json.encode(settings)))
    except (FileExistsError, NotADirectoryError):
        file = next(one for one in path.parents if one.exists())
        return f"{problem}{file} is a file, not a folder"
    except OSError as error:
        return f"{problem}{path.parent} cannot be written: {reason_of(error)}"
    return None


def _read(path: Path) -> WatchSettings | None:
    """Return the settings in a file; None if it is absent, InputError if it cannot be used."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=WatchSettings)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason_of(error)}") from error
    except UnicodeDecodeError:
        raise InputError(f"{path}: damaged: not UTF-8") from None
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: damaged: {error}") from error


def _keep_damaged(path: Path) -> None:
    try:
        _read(path)
    except InputError:
        path.replace(path.with_name(f"{path.name}{_DAMAGED}"))


DRAWS_PER_S = 4
_SHARE = 8
"""The pause after drawing the screen is at least this many times as long as drawing took."""
_LONGEST_PAUSE_S = 2.0
_LOOK_S = 1.0
_LOOK_SHARE = 50
"""The search for slaves in trouble runs each second. If a search takes over 1/50 s, the next one
begins only after 50 times the time that this one took."""


class DrawnApp(App[int]):
    """Draws the records of a feed, which reads links or files. `run` returns the exit code."""

    TITLE = "mbtool watch"
    ENABLE_COMMAND_PALETTE = True
    CSS = """
    #detail { height: 10; max-height: 50%; display: none; border-top: solid $accent; }
    #detail.open { display: block; }
    #detail-text { height: auto; }
    #troubles { display: none; }
    #troubles.told { display: block; }
    #note { height: auto; max-height: 8; display: none; }
    #note.told { display: block; }
    OptionList:nocolor > .option-list--option-highlighted { text-style: bold underline; }
    """

    def __init__(
        self,
        feed: WatchFeed,
        place: str,
        *,
        saver: Saver | None = None,
        recording: str | None = None,
        where: str = "",
        is_asked_to_end: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare to draw the records of `feed`.

        `place` names the links or files; `recording` is the path of the log that is written, None
        for no log. `where` is the filter as text, "" for none. `saver` writes records to files.
        `is_asked_to_end` is called before each drawing; it returns True after a signal and
        once the terminal is gone.
        """
        # With NO_COLOR set, textual turns its own colours into greys. It does not do so with the
        # terminal's colours, which ansi_color selects.
        super().__init__(ansi_color=True if is_plain() else None)
        self.feed = feed
        self.place, self.recording = place, recording
        self.where = where
        self.filter_is_on = bool(where)
        self.view_at = 0
        self.frozen: list[Sequence[Any]] | None = None
        """The rows of each view, by its index in VIEWS, while the screen is frozen; else None."""
        self.settings, self._settings_problem = load_settings()
        self._saver = saver
        self._is_asked_to_end = is_asked_to_end
        self._found = ""
        self._saving: str | None = None
        """The text on the screen while a file is being saved; else None."""
        self.unsaid: str | None = None
        """The result of a save whose prompt the user has left, until it is shown; else None."""
        self._before_typing = where
        self._typed_at = 0
        self._notes: Sequence[str] = ()
        """Texts on what the present view does not show, in several lengths; see WatchView."""
        self._contexts = [DrawContext() for _ in VIEWS]
        self._widest: list[dict[str, int]] = [{} for _ in VIEWS]
        """For each view, by column: the width (characters) of the widest cell shown so far."""
        self._next_draw_s = 0.0
        self.drawings = 0
        """The number of times that the screen was drawn."""
        self._troubles: tuple[list[str], str] = [], ""
        """The lines on what is wrong, and their style."""
        self._next_look_s = 0.0
        self._frozen_ns = 0
        self._note_stays = False
        self._told_remarks = 0
        self._told_error = False
        self._follows = True
        self._cursor_keys: list[Any] = [None] * len(VIEWS)

    def compose(self) -> ComposeResult:
        yield OneLine("tabs")
        yield OneLine("status")
        yield OneLine("troubles")
        yield LiveTable()
        with VerticalScroll(id="detail", can_focus=False):
            yield Static(id="detail-text", markup=False)
        yield PromptLine()
        yield Static(id="note", markup=False)
        yield OneLine("keys")

    def on_mount(self) -> None:
        self.table.focus()
        self.set_interval(1 / DRAWS_PER_S, self._tick)
        self.feed.start()
        self.draw()
        if self._settings_problem is not None:
            self.tell(self._settings_problem, "yellow")

    @property
    def view(self) -> WatchView:
        return VIEWS[self.view_at]

    @property
    def table(self) -> LiveTable:
        return self.screen_stack[0].query_one(LiveTable)

    @property
    def context(self) -> DrawContext:
        return self._contexts[self.view_at]

    @property
    def board(self) -> Board:
        """The board (figures and last records) to draw; with a filter, of records that pass it.

        Use it only while the feed's lock is held.
        """
        watched = self.feed.watched
        return watched.filtered if self.filter_is_on and watched.filtered else watched.whole

    # The methods below draw the screen and its parts.

    @property
    def is_up(self) -> bool:
        """False while the screen is being set up or closed; a timer may call back then, too."""
        return bool(self.screen_stack) and bool(self.screen_stack[0].query(LiveTable))

    def _tick(self) -> None:
        if not self.is_up:
            return
        if self._is_asked_to_end():
            self.exit(exit_codes.DONE)
            return
        self._show_remarks()
        if time.perf_counter() >= self._next_draw_s:
            self.draw()

    def draw(self) -> None:
        """Draw the current view, and set the time of the next drawing."""
        if not self.is_up:
            return
        began_s = time.thread_time()
        self.drawings += 1
        width = max(self.size.width, 20)
        if self.frozen is not None:
            rows, now_ns = self.frozen[self.view_at], self._frozen_ns
        else:
            with self.feed.lock:
                now_ns = self.feed.now_ns()
                self._look_for_troubles(width)
                rows = self.view.rows(self.board, width)
        self._notes = self.view.notes(rows)
        self.context.now_ns = now_ns
        self.context.is_over = self.feed.is_over or not self.feed.is_live
        self.context.marked = self.feed.watched.marked
        name, descending = self._sorting
        column = next((one for one in self.view.columns if one.name == name), None)
        if column is not None:
            rows = sorted(rows, key=column.sort, reverse=descending)
        chosen = self.settings.columns.get(self.view.name)
        widest = self._widest[self.view_at]
        table = self.table
        table.can_follow = self.view.can_follow
        table.take(rows, (None if column is None else name, descending))
        self._measure(table.rows_on_screen)
        columns = fitted(self.view.columns, width, chosen, self._places(width), widest)
        table.show(columns, self.context, empty=self._why_empty())
        self._draw_lines(width)
        self._draw_detail()
        self.call_after_refresh(self._plan_next_drawing, began_s)

    def _measure(self, rows: Sequence[Any]) -> None:
        """Note the widest cells of the present view, in `rows`.

        A column never becomes narrower, as the table would jump. One that is as wide as it can
        become is not measured again.
        """
        widest = self._widest[self.view_at]
        columns = [one for one in self.view.columns if widest.get(one.name, 0) < one.most]
        for name, width in widest_cells(rows, columns, self.context).items():
            widest[name] = max(width, widest.get(name, 0))

    def _why_empty(self) -> str:
        """Return the text for a view that has no rows; it says why there are none."""
        if self.filter_is_on:
            return f"no {self.view.what} pass the filter; \\ switches it off"
        if isinstance(self.feed, FileFeed) and not self.feed.is_read:
            return "the file is being read"
        return f"no {self.view.what} {'heard yet' if self.feed.is_live else 'up to here'}"

    def _places(self, width: int) -> Mapping[str, PlaceColumn]:
        """Return the columns that show the link and the master of a row, by column name.

        A column is left out if there is only one link or one master.
        """
        account = self.board.account
        with self.feed.lock:
            links = tuple(account.links)
            masters = {master for _, master in account.tapes if master}
        return place_columns(links, masters, width)

    def _look_for_troubles(self, width: int) -> None:
        """Update the line on slaves in trouble, at most once a second.

        It judges all records, also under a filter, which may let only failures pass. The line fits
        `width` characters. The caller must hold the feed's lock.
        """
        began_s = time.perf_counter()
        if began_s < self._next_look_s:
            return
        self._troubles = watch_text(self.feed.watched.judge(), width - 2)
        took_s = time.perf_counter() - began_s
        self._next_look_s = began_s + max(_LOOK_S, _LOOK_SHARE * took_s)

    def _plan_next_drawing(self, began_s: float) -> None:
        """Set the time of the next drawing by the processor time that this one took.

        `began_s` is the thread's processor time in seconds at the start of this drawing.
        """
        took_s = time.thread_time() - began_s
        pause_s = min(max(_SHARE * took_s, self.view.pause_s), _LONGEST_PAUSE_S)
        self._next_draw_s = time.perf_counter() + pause_s

    def _draw_lines(self, width: int) -> None:
        base = self.screen_stack[0]
        state = ScreenState(
            feed=self.feed,
            place=self.place,
            recording=self.recording,
            is_frozen=self.frozen is not None,
            where=self.where,
            filter_is_on=self.filter_is_on,
        )
        base.query_one("#tabs", OneLine).show(tabs_text(VIEWS, self.view_at, self._notes, width))
        base.query_one("#status", OneLine).show(status_text(state, width))
        troubles = base.query_one("#troubles", OneLine)
        lines, style = self._troubles
        told = [f"{'  ' if at else '! '}{line}" for at, line in enumerate(lines)]
        troubles.show(*([(line, style)] for line in told))
        troubles.set_class(bool(lines), "told")
        keys = keys_line(width, is_of_files=not self.feed.is_live)
        base.query_one("#keys", OneLine).show(keys)

    def _draw_detail(self) -> None:
        pane = self.screen_stack[0].query_one("#detail")
        if not pane.has_class("open"):
            return
        lines = self.detail_lines(max(self.size.width - 2, 20))
        text = Text("\n").join(text_of(line) for line in lines)
        self.screen_stack[0].query_one("#detail-text", Static).update(text)

    def detail_lines(self, width: int) -> list[Spans]:
        """Return the detail lines about the row under the cursor."""
        row = self.table.row
        if isinstance(row, WatchedSlaveRow):
            return slave_detail(row, width)
        if row is None or row.kept is None:
            return [[("no transaction here", "dim")]]
        record = row.kept.record
        profile = None
        if hasattr(record, "outcome"):
            profile = self.feed.watched.whole.profile_for(record)
        if isinstance(row, TroubleRow):
            return trouble_detail(row, profile, width)
        with self.feed.lock:
            damaged = self.feed.watched.whole.damaged.get(row.kept.order)
        return record_detail(row.kept, profile, width, damaged)

    def tell(self, text: str, style: str = "") -> None:
        """Show a message below the table, until the next message or Escape; "" removes it.

        `style` is in the notation of the library rich, such as `red`. A message without a style
        answers a key; it also goes when the view changes.
        """
        if not self.is_up:
            return
        note = self.screen_stack[0].query_one("#note", Static)
        note.update(Text(text, style_of(style, plain=is_plain())))
        note.set_class(bool(text), "told")
        self._note_stays = bool(style)

    def _show_remarks(self) -> None:
        remarks = self.feed.remarks
        if remarks and self._told_remarks != hash(remarks[-1]):
            self._told_remarks = hash(remarks[-1])
            self.tell(remarks[-1], "yellow")
        error = self.feed.error
        if isinstance(error, MbtoolError):
            if not self._told_error:
                self._told_error = True
                self.tell(f"{error}; q ends" if self.feed.is_live else str(error), "bold red")
        elif error is not None:
            self.exit(exit_codes.UNREADABLE)

    @property
    def _sorting(self) -> tuple[str | None, bool]:
        return self.settings.sorted_by.get(self.view.name, (None, False))

    def _remember(self) -> None:
        problem = save_settings(self.settings)
        if problem is not None:
            self.tell(problem, "yellow")
        self.draw()

    def action_freeze(self) -> None:
        if self.frozen is not None:
            self.frozen = None
        else:
            with self.feed.lock:
                self._frozen_ns = self.feed.now_ns()
                self.frozen = [view.rows(self.board, self.size.width) for view in VIEWS]
        self.draw()
