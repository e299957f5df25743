"""Decides whether a file continues the file before it, as a further part of one capture."""

# tcpdump -G and -C, dumpcap -b and sniff --rotate split a capture into several files while
# connections are open, so a transaction may begin in one file and end in the next.
#
# A file of packets continues the capture of the previous file if three conditions are met. Its
# first packet is later than the first packet of that file, and at most BACK_NS earlier than its
# last packet. Its first packet has a link type that also occurs in that file. And the time since
# the last packet is at most GAP_NS, or at most as long as the capture so far.
#
# A log continues the log before it if both have the same metadata of the recording, links, devices
# and profiles, if its part number is the next one, and if it does not begin earlier.
#
# Any other file is a new capture, whose connections are not joined to earlier ones. Two unrelated
# files of packets that follow each other soon are taken as parts of one capture. Sequence numbers
# and the time between the files keep their connections apart (packets/reassembler.py).

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from mbtool.core import EventKind, Packet, WireEvent
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.core.moments import counted
from mbtool.modbus import Transaction, Verdict

if TYPE_CHECKING:
    from mbtool.decode.decoder import Evidence
    from mbtool.logs import LogReader

BACK_NS = 1_000_000_000
"""The first packet or chunk of a file that continues a capture may be earlier than the last one of
the file before by up to this time (ns). Packets of several interfaces, and bytes of several ports,
are written slightly out of order."""

GAP_NS = 60_000_000_000
"""The first packet of a file that continues a capture is at most this (ns) later than the last one
of the file before, or as much later as the capture so far is long."""

_PART = "part"


@dataclass(frozen=True, slots=True)
class Part:
    """Identifies a file as a part of a capture, by its part number and the metadata of the
    recording (`run`).

    A file of packets has no such data: `number` is None and `run` is empty. A log that is no part
    of a rotated one has the number 0.
    """

    number: int | None = None
    run: tuple[object, ...] = ()

    @classmethod
    def of_log(cls, log: LogReader) -> Part:
        """Take the part number and the metadata of the recording from a log."""
        number = log.capture.get(_PART, "")
        capture = {key: value for key, value in log.capture.items() if key != _PART}
        run = (capture, dict(log.links), dict(log.devices), dict(log.profiles))
        return cls(int(number) if number.isdecimal() and len(number) <= 9 else 0, run)

    def follows(self, other: Part | None) -> bool:
        if other is None or self.run != other.run:
            return False
        if self.number is None or other.number is None:
            return self.number is other.number
        return self.number == other.number + 1 > 1


class Seam:
    """The facts about the capture read so far that decide whether the next file continues it.

    These are the times of the first and the last item (packet or chunk), and the link types of all
    packets.
    """

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._types: set[int] = set()

    def note(self, item: Evidence) -> None:
        self._last_ns = item.ts_ns
        if self._first_ns is None:
            self._first_ns = item.ts_ns
        if isinstance(item, Packet):
            self._types.add(item.link_type)

    def is_continued_by(self, item: Evidence) -> bool:
        """True if a file that begins with the packet or chunk `item` can be the next part of the
        capture.
        """
        if self._last_ns is None or self._first_ns is None:
            return True
        if item.ts_ns <= self._first_ns < self._last_ns:
            return False
        if isinstance(item, Packet) and self._types and item.link_type not in self._types:
            return False
        if isinstance(item, Packet):
            longest_ns = max(GAP_NS, self._last_ns - self._first_ns)
            if item.ts_ns - self._last_ns > longest_ns:
                return False
        return item.ts_ns >= self._last_ns - BACK_NS

    def is_overtaken_by(self, item: Evidence) -> bool:
        """True if `item`, the first packet of a file, is earlier than the end of the capture read
        so far, but not than its beginning.

        Then the user has probably named the parts of a capture in the wrong order.
        """
        if self._first_ns is None or self._last_ns is None or not isinstance(item, Packet):
            return False
        is_alike = item.link_type in self._types
        return is_alike and self._first_ns <= item.ts_ns < self._last_ns - BACK_NS


# The code below counts missing data for remarks: cut packets, dropped requests, unreadable log
# messages.

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
