"""Collects bytes that cannot be read, so that those in a row become one event."""

from __future__ import annotations

from collections.abc import Callable

from mbtool.core import EventKind
from mbtool.modbus.adu import Adu, Checksum, Skipped

Reason = tuple[EventKind, str, Checksum | None]
"""The kind of the event for skipped bytes, the reason in one sentence, and the wrong CRC or LRC if
the bytes are a frame with one."""

MAX_RUN = 1024
"""Skipped bytes in a row are reported when they are this many, to limit memory."""


class SkipRun:
    """Skipped bytes in a row that no event has reported yet; fewer than MAX_RUN of them."""

    __slots__ = ("_bytes", "_first_ns", "_why")

    def __init__(self, why: Callable[[bytes], Reason]) -> None:
        """`why` takes the skipped bytes and returns the reason (Reason) why they cannot be read."""
        self._why = why
        self._bytes = bytearray()
        self._first_ns = 0

    def __bool__(self) -> bool:
        return bool(self._bytes)

    @property
    def room(self) -> int:
        """The number of bytes that can still be added until MAX_RUN bytes are collected."""
        return MAX_RUN - len(self._bytes)

    def add(self, data: bytes, ts_ns: int, events: list[Adu | Skipped]) -> None:
        """Add skipped bytes that arrived at `ts_ns`.

        Appends one event to `events` whenever MAX_RUN bytes are collected.
        """
        while data:
            if not self._bytes:
                self._first_ns = ts_ns
            room = self.room
            self._bytes += data[:room]
            data = data[room:]
            if len(self._bytes) == MAX_RUN:
                self.end(events)

    def take(self) -> bytes:
        """Return the collected bytes without an event, and forget them."""
        raw = bytes(self._bytes)
        self._bytes.clear()
        return raw

    def end(self, events: list[Adu | Skipped]) -> None:
        """Append one event with the collected bytes to `events`, if there are any."""
        if self._bytes:
            raw = bytes(self._bytes)
            kind, reason, checksum = self._why(raw)
            events.append(Skipped(self._first_ns, kind, reason, raw, checksum))
            self._bytes.clear()
