"""Several shells that answer at the same time and are started and stopped together."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.slave.shells.shell import Shell

_GLANCE_S = 0.0


class ShellGroup:
    """Several shells on different links; a context manager that starts and stops all of them."""

    def __init__(self, shells: Sequence[Shell]) -> None:
        self._shells = shells
        self._stack = ExitStack()

    @property
    def place(self) -> str:
        """The link as text for the user; if there are several, their number."""
        count = len(self._shells)
        return self._shells[0].place if count == 1 else f"{count} links"

    @property
    def places(self) -> int:
        """The number of masters that may be connected to one of the shells at once."""
        return max(shell.places for shell in self._shells)

    @property
    def turned_away(self) -> int:
        """The number of connections refused because a shell had as many as it accepts at once."""
        return sum(shell.turned_away for shell in self._shells)

    def notes(self) -> list[str]:
        """Messages for the user on what has happened to connections since the last call."""
        return [note for shell in self._shells for note in shell.notes()]

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until the first shell has ended, or `timeout_s` seconds have passed.

        If an error ended one of the shells, it is raised: LinkError if its link was lost.
        """
        self._shells[0].wait(timeout_s)
        for shell in self._shells[1:]:
            shell.wait(_GLANCE_S)

    def __enter__(self) -> Self:
        """Start all shells; if one cannot be started, stop the others and raise its error."""
        with ExitStack() as stack:
            for shell in self._shells:
                stack.enter_context(shell)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
