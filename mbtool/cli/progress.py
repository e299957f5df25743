"""Shows a progress bar on standard error while a capture is read, if that is a terminal."""

# The bar appears after a second, so that it does not flicker for a small file, and disappears when
# everything is read. It moves as records come.

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, TypeVar

from mbtool.cli.talk import escaped

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.workflows.shared.reading import Reading

T = TypeVar("T")

_APPEARS_S = 1.0
_SHOW_EVERY = 500
"""The bar is updated once for so many records."""


def with_progress(reading: Reading, records: Iterator[T]) -> Iterator[T]:
    """Pass records on, and show on a terminal how much of the files has been read."""
    return _shown(reading, records) if sys.stderr.isatty() else records


def _shown(reading: Reading, records: Iterator[T]) -> Iterator[T]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task("reading", total=1.0)
    began_s = time.monotonic()
    with ExitStack() as shown:
        is_shown = False
        for number, record in enumerate(records, 1):
            if number % _SHOW_EVERY == 0 and time.monotonic() - began_s >= _APPEARS_S:
                rate = number / (time.monotonic() - began_s)
                told = f"{reading.progress_text}, {rate:,.0f} rows/s"
                bar.update(task, completed=reading.fraction, description=escape(escaped(told)))
                if not is_shown:
                    shown.enter_context(bar)
                    is_shown = True
            yield record
