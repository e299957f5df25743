"""Counts missing data for remarks: cut packets, dropped requests, unreadable log messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from mbtool.core import EventKind, Packet, WireEvent
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.core.wording import counted
from mbtool.modbus import Transaction, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator

_Item = TypeVar("_Item")


class MissingParts:
    """Counts missing data: packets that the snaplen cut, requests that the decoder dropped because
    of a limit, and messages of a log that could not be read.
    """

    def __init__(self) -> None:
        self._cut = 0
        self._shortest = self._longest = 0
        """The captured lengths, in bytes, of the shortest and the longest cut packet; 0 if none was
        cut."""
        self._dropped = 0
        self._left_out: list[str] = []

    def note_item(self, item: object) -> None:
        """Look at the next item of a capture or log, and count it if it is a packet that
        was cut.
        """
        if not isinstance(item, Packet) or item.original_length <= len(item.data):
            return
        self.note_cut(1, len(item.data), len(item.data))

    def note_cut(self, count: int, shortest: int, longest: int) -> None:
        """Count `count` cut packets at once. Their captured lengths are `shortest` to `longest`
        bytes.
        """
        self._shortest = min(self._shortest, shortest) if self._cut else shortest
        self._longest = max(self._longest, longest)
        self._cut += count

    def noted(self, items: Iterator[_Item]) -> Iterator[_Item]:
        """Yield the items unchanged, and call `note_item` for each."""
        for item in items:
            self.note_item(item)
            yield item

    def note_record(self, record: object) -> None:
        """Look at the next transaction or event.

        Count a transaction whose request was dropped because of a limit. Keep the message of an
        event about log messages that could not be read.
        """
        if isinstance(record, Transaction):
            if Verdict.OVER_LIMIT in record.verdicts:
                self._dropped += record.request_raw is not None
        elif isinstance(record, WireEvent) and _is_of_the_log(record):
            self._left_out.append(record.message)

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about cut packets, dropped requests and unreadable log messages.

        If all cut packets have the same length, it is reported as the snaplen of the capture.
        """
        remarks = []
        if self._cut:
            length = f" (snaplen {self._longest})" if self._shortest == self._longest else ""
            verb = "is" if self._cut == 1 else "are"
            remarks.append(f"{counted(self._cut, 'packet')} {verb} cut{length}")
        if self._dropped:
            remarks.append(
                f"{counted(self._dropped, 'request')} not joined with the answer: "
                f"more than {MAX_OPEN_REQUESTS} were open at once"
            )
        return remarks + self._left_out


def _is_of_the_log(event: WireEvent) -> bool:
    """True for an event about messages of a log that could not be read. Unlike other events of its
    kind, it names no link.
    """
    return event.kind is EventKind.UNREADABLE and not event.link
