"""A progress bar while a capture is read, on standard error where that is a terminal."""

# It appears after a second, so that what is read at once does not flicker, and goes when all is
# read. It moves as records come.

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.decode.decoder import Record
    from mbtool.workflows.shared.reading import Reading

_APPEARS_S = 1.0
_SHOW_EVERY = 500
"""How many records go by between two looks."""


def with_progress(reading: Reading, records: Iterator[Record]) -> Iterator[Record]:
    """The same records; where there is a terminal, how far reading has come is shown."""
    if not sys.stderr.isatty():
        yield from records
        return
    from rich.console import Console
    from rich.progress import Progress

    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task("reading", total=1.0)
    began_s = time.monotonic()
    with ExitStack() as shown:
        is_shown = False
        for number, record in enumerate(records, 1):
            if number % _SHOW_EVERY == 0 and time.monotonic() - began_s >= _APPEARS_S:
                bar.update(task, completed=reading.fraction)
                if not is_shown:
                    shown.enter_context(bar)
                    is_shown = True
            yield record
