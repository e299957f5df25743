"""Shows a progress bar on standard error while a capture is read, if that is a terminal."""

# The bar appears after a second, so that it does not flicker for a small file, and disappears when
# everything is read. It moves only when a record is read.

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import TypeVar

from mbtool.cli.talk import escaped
from mbtool.workflows.shared.read_all import FILES, Work

T = TypeVar("T")

_APPEARS_S = 1.0
_LOOK_EVERY = 100
"""With single records, the clock is read at every 100th, as reading it is slow. A record that is a
block of rows, or a whole file, is so rare that the clock is read at each."""
_PAUSE_S = 0.1
"""The bar is updated at most this often, in s."""


def with_progress(work: Work, records: Iterator[T]) -> Iterator[T]:
    """Yield `records`, and show on a terminal how much of the work is done.

    `work` is what yields the records, such as a reading; a record is a transaction, or a block of
    them, or the result of a file.
    """
    return _with_progress_bar(work, records) if sys.stderr.isatty() else records


def _with_progress_bar(work: Work, records: Iterator[T]) -> Iterator[T]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
        TextColumn("left"), console=Console(stderr=True), transient=True,
    )  # fmt: skip
    task = bar.add_task("reading", total=1.0)
    began_s = time.monotonic()
    with ExitStack() as shown:
        is_shown = False
        number, next_s = 0, began_s + _APPEARS_S
        every = 1 if work.noun == FILES else _LOOK_EVERY
        for record in records:
            rows = getattr(record, "row_count", 1)
            number += rows
            if (rows != 1 or number % every == 0) and (now_s := time.monotonic()) >= next_s:
                next_s = now_s + _PAUSE_S
                rate = number / (now_s - began_s)
                told = f"{work.progress_text}, {rate:,.0f} {work.noun}/s"
                bar.update(task, completed=work.fraction, description=escape(escaped(told)))
                if not is_shown:
                    shown.enter_context(bar)
                    is_shown = True
            yield record
