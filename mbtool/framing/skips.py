"""Collects bytes that cannot be read, so that a run of them becomes one event."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.modbus.adu import Adu, Checksum, Skipped

if TYPE_CHECKING:
    from collections.abc import Callable

Reason = tuple[EventKind, str, Checksum | None]
"""The kind of the event for skipped bytes, the reason in one sentence, and the wrong CRC or LRC if
the bytes are a frame with one."""

MAX_RUN = 1024
"""A run that has this many bytes becomes an event and a new run begins, to limit memory."""


class SkipRun:
    """A run of skipped bytes. Holds less than MAX_RUN of them."""

    __slots__ = ("_bytes", "_first_ns", "_why")

    def __init__(self, why: Callable[[bytes], Reason]) -> None:
        """`why` takes the bytes of a run and returns why they cannot be read."""
        self._why = why
        self._bytes = bytearray()
        self._first_ns = 0

    def __bool__(self) -> bool:
        return bool(self._bytes)

    @property
    def room(self) -> int:
        """The number of bytes that still fit into the run."""
        return MAX_RUN - len(self._bytes)

    def add(self, data: bytes, ts_ns: int, events: list[Adu | Skipped]) -> None:
        """Take bytes that arrived at `ts_ns`. A full run is appended to `events`."""
        while data:
            if not self._bytes:
                self._first_ns = ts_ns
            room = self.room
            self._bytes += data[:room]
            data = data[room:]
            if len(self._bytes) == MAX_RUN:
                self.end(events)

    def end(self, events: list[Adu | Skipped]) -> None:
        """Append the run to `events`, if there is one."""
        if self._bytes:
            raw = bytes(self._bytes)
            kind, reason, checksum = self._why(raw)
            events.append(Skipped(self._first_ns, kind, reason, raw, checksum))
            self._bytes.clear()
