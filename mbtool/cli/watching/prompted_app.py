"""Handles what the user types into the prompt: a filter, a text to find, a file to save to."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING

from mbtool.cli.watching.drawn_app import DrawnApp
from mbtool.cli.watching.prompt import (
    Asking,
    PromptLine,
    find_row,
    hex_bytes,
    read_filter,
    why_wrong,
)
from mbtool.core import MbtoolError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

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
        self._thaw()

    def _thaw(self) -> None:
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
        self._thaw()
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
            self.call_from_thread(self._saved, is_done=is_done)

    def _saved(self, *, is_done: bool) -> None:
        self._saving = None
        if self.return_value is not None or self.unsaid is None or not self.is_up:
            return
        self.tell(self.unsaid, "green" if is_done else "bold red")
        self.unsaid = None
        if is_done and self.prompt.asking is Asking.SAVE:
            self._leave_prompt()
