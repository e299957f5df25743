"""The full screen of `mbtool watch`: its keys, and the actions behind them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from textual.app import SystemCommand
from textual.binding import Binding

from mbtool.cli import exit_codes
from mbtool.cli.watching.choices import AS_IT_COMES, ColumnChoice, SortChoice
from mbtool.cli.watching.help_window import HelpWindow, key_name
from mbtool.cli.watching.prompted_app import PromptedApp
from mbtool.cli.watching.watch_views import VIEWS
from mbtool.views.watch_columns import left_out
from mbtool.workflows.watch import FileFeed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from textual.screen import Screen

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
        if not self.feed.watched.mark(row.kept):
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
