"""A virtual serial line for Python programs, which needs no hardware."""

from __future__ import annotations

from typing import Self

from mbtool.core import LineSettings, UsageError, parse_line
from mbtool.sources.virtual_line import VirtualLine


class SerialBench:
    """A virtual serial line that exists while its `with` block runs; `mbtool.line` makes it."""

    def __init__(self, settings: LineSettings, ends: int) -> None:
        self._settings = settings
        self._line = VirtualLine(ends=ends, format=settings.format)

    @property
    def ports(self) -> list[str]:
        """The path of each end, to be opened as a serial port."""
        return self._line.ports

    def link(self, end: int) -> str:
        """Return the LINK of an end for a slave or `sniff`: `rtu:/dev/pts/4@19200-8E1`.

        Ends are counted from 0. Raises UsageError if the line has no such end.
        """
        if not 0 <= end < len(self.ports):
            raise UsageError(f"end {end}: the line has the ends 0 to {len(self.ports) - 1}")
        return str(self._settings.link_at(self.ports[end]))

    def __enter__(self) -> Self:
        self._line.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._line.close()


def line(settings: str = "rtu", *, ends: int = 2) -> SerialBench:
    """Make a virtual serial line; characters take as long on it as on a real one.

    `ends` is the number of ports that it connects, all of which hear each other. It works on Linux
    and macOS. Raises UsageError for settings that a line cannot have; entering the `with` block
    raises LinkError if the line cannot be made.
    """
    return SerialBench(parse_line(settings), ends)
