"""The console that tables are printed on."""

from __future__ import annotations

from typing import NoReturn

from rich.console import Console


class PipeConsole(Console):
    """A console that raises BrokenPipeError when the reader of a pipe has gone.

    main.py turns the error into an exit code.
    """

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError
