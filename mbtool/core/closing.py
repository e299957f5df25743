"""A base for objects that are context managers because they can be closed."""

from __future__ import annotations

from typing import Self


class ClosesOnExit:
    """A context manager whose exit calls `close`."""

    def close(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
