"""The console that tables are printed on."""

from __future__ import annotations

from typing import NoReturn

from rich.console import Console


class PipeConsole(Console):
    """A console that raises BrokenPipeError; main.py turns it into the exit code."""

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError
