"""Gathers bytes that cannot be read, so that a run of them becomes one event."""

from __future__ import annotations

from mbtool.core import EventKind
from mbtool.modbus.adu import Adu, Skipped

MAX_RUN = 1024
"""Bytes after which a run is given out and the next begins, so that noise has a bound."""


class SkipRun:
    """A run of skipped bytes. Holds at most MAX_RUN of them."""

    __slots__ = ("_bytes", "_first_ns", "_reason")

    def __init__(self, reason: str) -> None:
        self._reason = reason
        self._bytes = bytearray()
        self._first_ns = 0

    def __bool__(self) -> bool:
        return bool(self._bytes)

    def add(self, data: bytes, ts_ns: int, events: list[Adu | Skipped]) -> None:
        """Take bytes that arrived at a time; a full run goes to `events`."""
        for byte in data:
            if not self._bytes:
                self._first_ns = ts_ns
            self._bytes.append(byte)
            if len(self._bytes) >= MAX_RUN:
                self.end(events)

    def end(self, events: list[Adu | Skipped]) -> None:
        """Give the run to `events`, if there is one."""
        if self._bytes:
            raw = bytes(self._bytes)
            events.append(Skipped(self._first_ns, EventKind.SKIPPED, self._reason, raw))
            self._bytes.clear()
