"""The line in which the user types a filter, a text to find, or a file name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

from textual.binding import Binding
from textual.message import Message
from textual.widgets import Input

from mbtool.core import UsageError, WireEvent
from mbtool.query.mistakes import find_mistake
from mbtool.query.where import Where, parse_where
from mbtool.views.watch_columns import DrawContext, WatchColumn, row_text

# The code below finds rows of a live table by text, or by bytes in hexadecimal.

_HEX = re.compile(r"(?:0x)?((?:[0-9a-f]{2}[ :]?)+)", re.IGNORECASE)


def find_row(
    rows: Sequence[Any], columns: Sequence[WatchColumn], text: str, start: int, step: int
) -> int | None:
    """Return the index of the next row that shows `text`, or whose frames have its bytes.

    `text` stands for bytes if it is hexadecimal, such as `01 03`. The search begins with the row
    after `start` (`step` 1) or before it (-1), and wraps around; row `start` itself comes last.
    Returns None if no row matches.
    """
    wanted, data = text.lower(), hex_bytes(text)
    context = DrawContext()
    for distance in range(1, len(rows) + 1):
        index = (start + step * distance) % len(rows)
        row = rows[index]
        if wanted in row_text(row, columns, context).lower() or (data and _has_bytes(row, data)):
            return index
    return None


def hex_bytes(text: str) -> bytes:
    """Return the bytes of `01 03`, `0103` or `0x0103`; empty for a text that is not hexadecimal."""
    match = _HEX.fullmatch(text.strip())
    return bytes.fromhex(match[1].replace(":", " ")) if match is not None else b""


def _has_bytes(row: Any, data: bytes) -> bool:
    if row.kept is None:
        return False
    record = row.kept.record
    if isinstance(record, WireEvent):
        return data in record.raw
    return data in (record.request_raw or b"") or data in (record.response_raw or b"")


class Asking(StrEnum):
    """The kind of text that the user is typing: a filter, a text to find, or a file name."""

    FILTER = "filter"
    FIND = "find"
    SAVE = "save as"


class PromptLine(Input):
    """One line of input. Up and Down go through earlier texts; Escape leaves the line."""

    DEFAULT_CSS = """
    PromptLine { height: 1; border: none; padding: 0; background: $surface; display: none; }
    PromptLine:focus { border: none; }
    PromptLine.asking { display: block; }
    """
    BINDINGS = [  # noqa: RUF012 - textual reads the list from the class
        Binding("escape", "leave", "Leave"),
        Binding("up", "earlier(1)", "Earlier"),
        Binding("down", "earlier(-1)", "Later"),
    ]

    class Left(Message):
        """Sent when the user leaves the line with Escape."""

    def __init__(self) -> None:
        super().__init__(compact=True)
        self.asking = Asking.FILTER
        self._earlier: Sequence[str] = ()
        self._at = -1

    def ask(self, asking: Asking, text: str, earlier: Sequence[str], hint: str) -> None:
        """Show the line with `text` in it; `earlier` are texts to choose from, the newest first."""
        self.asking, self._earlier, self._at = asking, earlier, -1
        self.placeholder = hint
        self.value = text
        self.cursor_position = len(text)
        self.add_class("asking")
        self.focus()

    def close(self) -> None:
        self.remove_class("asking")

    def action_leave(self) -> None:
        self.post_message(self.Left())

    def action_earlier(self, by: int) -> None:
        at = self._at + by
        if 0 <= at < len(self._earlier):
            self._at = at
            self.value = self._earlier[at]
            self.cursor_position = len(self.value)


def read_filter(text: str) -> Where | None:
    """Return the filter that a text describes; None for an empty text.

    Raises UsageError if the text is no valid filter.
    """
    return parse_where(text) if text.strip() else None


def why_wrong(text: str, error: UsageError) -> tuple[int, str]:
    """Return the place of the error in the filter `text`, and the reason for the user.

    The place is the index of a character from 0; if it is not known, the length of the text.
    """
    reason = str(error).partition(": ")[2] if ": " in str(error) else str(error)
    if not str(error).startswith("--where"):
        reason = str(error)
    if "did you mean" in reason:
        reason = f"{reason.partition('?')[0]}?"  # The list of all names has no room.
    cause = error.__cause__
    mistake = find_mistake(text) if cause is not None else None
    if mistake is not None:
        return mistake
    if isinstance(cause, SyntaxError):
        # If an expression ends too early, Python reports no offset, or the first one.
        offset = (cause.offset or 0) - 1
        is_short = offset < 1 or offset >= len(text)
        if is_short:
            return len(text), "not complete, or not an expression"
        return offset, "not an expression from here"
    for word in re.findall(r"'([^']+)'", reason) + re.findall(r"^(\w+)", reason):
        if word in text:
            return text.index(word), reason
    return len(text), reason
