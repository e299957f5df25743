"""Tells whether a file goes on where the file before it ended: parts of one capture."""

# tcpdump -G and -C, dumpcap -b and sniff --rotate end a file and go on in the next in the middle of
# connections. What was begun in one part then ends in the next. A file is taken for the next part
#
#     of packets    if it begins no earlier than the one before it ended, and with a link type that
#                   was in it
#     of a log      if it says of itself that it is: the same run, links, devices and profiles, and
#                   the next part number; and it begins no earlier
#
# and else as a capture of its own, so that its connections are not joined to others between the
# same ends. Packets of several interfaces and bytes of several ports stand in a file not quite in
# the order of their times, so BACK_NS is no step back. A later file that has nothing to do with the
# one before it does no harm: sequence numbers and the time between them tell (reassembler.py).

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Packet

if TYPE_CHECKING:
    from mbtool.decode.decoder import Evidence
    from mbtool.logs import LogReader

BACK_NS = 1_000_000_000

_PART = "part"


@dataclass(frozen=True, slots=True)
class Part:
    """What a file says of the capture that it is a part of; packets say nothing."""

    number: int | None = None
    run: tuple[object, ...] = ()

    @classmethod
    def of_log(cls, log: LogReader) -> Part:
        """As it stands at the log's beginning, before its items are read."""
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
    """Where what was read so far ends."""

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
        """Whether the first item of a next file can come next."""
        if self._last_ns is None:
            return True
        if isinstance(item, Packet) and self._types and item.link_type not in self._types:
            return False
        return item.ts_ns >= self._last_ns - BACK_NS

    def is_overtaken_by(self, item: Evidence) -> bool:
        """Whether a next file begins with a packet from amidst what was read: out of order."""
        if self._first_ns is None or self._last_ns is None or not isinstance(item, Packet):
            return False
        is_alike = item.link_type in self._types
        return is_alike and self._first_ns <= item.ts_ns < self._last_ns - BACK_NS
