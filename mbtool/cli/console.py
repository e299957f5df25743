"""The rich console on which commands print tables."""

from __future__ import annotations

import shutil
from typing import NoReturn

from rich.console import Console, ConsoleDimensions


class PipeConsole(Console):
    """A console that raises BrokenPipeError when the reader of a pipe has gone.

    main.py turns that error into an exit code.
    """

    @property
    def size(self) -> ConsoleDimensions:
        """The size of the terminal in characters; for TERM=dumb, rich would take 80 columns."""
        if self.is_dumb_terminal and self._width is None:
            return ConsoleDimensions(*shutil.get_terminal_size((80, 25)))
        return super().size

    @size.setter
    def size(self, new_size: tuple[int, int]) -> None:
        self._width, self._height = new_size

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError
