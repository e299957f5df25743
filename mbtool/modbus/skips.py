"""Gathers bytes that cannot be read, so that a run of them becomes one event."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.adu import Adu, Skipped

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import EventKind

MAX_RUN = 1024
"""Bytes after which a run is given out and the next begins, so that noise has a bound."""


class SkipRun:
    """A run of skipped bytes. Holds less than MAX_RUN of them."""

    __slots__ = ("_bytes", "_first_ns", "_why")

    def __init__(self, why: Callable[[bytes], tuple[EventKind, str]]) -> None:
        """`why` says of a run what it is."""
        self._why = why
        self._bytes = bytearray()
        self._first_ns = 0

    def __bool__(self) -> bool:
        return bool(self._bytes)

    def add(self, data: bytes, ts_ns: int, events: list[Adu | Skipped]) -> None:
        """Take bytes that arrived at a time; a full run goes to `events`."""
        while data:
            if not self._bytes:
                self._first_ns = ts_ns
            room = MAX_RUN - len(self._bytes)
            self._bytes += data[:room]
            data = data[room:]
            if len(self._bytes) == MAX_RUN:
                self.end(events)

    def end(self, events: list[Adu | Skipped]) -> None:
        """Give the run to `events`, if there is one."""
        if self._bytes:
            raw = bytes(self._bytes)
            events.append(Skipped(self._first_ns, *self._why(raw), raw))
            self._bytes.clear()
