"""Tells whether a file continues the file before it: parts of one capture."""

# tcpdump -G and -C, dumpcap -b and sniff --rotate go on in a next file while connections are open,
# so a transaction may begin in one file and end in the next. A file is the next part
#
#     of packets    if its first packet is not earlier than the last one of the file before it (by
#                   more than BACK_NS), but later than the first one, and has a link type that was
#                   in that file
#     of a log      if it has the same run, links, devices and profiles, and the next part number;
#                   and it does not begin earlier
#
# Any other file is a capture of its own, and its connections are not joined to those before it. Two
# unrelated files of packets in order of time are taken for parts, which does no harm: sequence
# numbers and the time between them keep their connections apart (packets/reassembler.py).

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Packet

if TYPE_CHECKING:
    from mbtool.decode.decoder import Evidence
    from mbtool.logs import LogReader

BACK_NS = 1_000_000_000
"""So many ns before the last item, an item still continues the capture: packets of several
interfaces, and bytes of several ports, are written slightly out of order."""

_PART = "part"


@dataclass(frozen=True, slots=True)
class Part:
    """Which part of which capture a file is, as a log tells it. Files of packets tell neither."""

    number: int | None = None
    run: tuple[object, ...] = ()

    @classmethod
    def of_log(cls, log: LogReader) -> Part:
        """Read the number and the run from the head of a log, before its items."""
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
    """How far a capture has been read: the times of its first and last item, its link types."""

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
        """True if a file that begins with this item can be the next part."""
        if self._last_ns is None or self._first_ns is None:
            return True
        if item.ts_ns <= self._first_ns < self._last_ns:
            return False
        if isinstance(item, Packet) and self._types and item.link_type not in self._types:
            return False
        return item.ts_ns >= self._last_ns - BACK_NS

    def is_overtaken_by(self, item: Evidence) -> bool:
        """True if this first packet of a file is from the time between packets already read.

        Then the parts of the capture are named in the wrong order.
        """
        if self._first_ns is None or self._last_ns is None or not isinstance(item, Packet):
            return False
        is_alike = item.link_type in self._types
        return is_alike and self._first_ns <= item.ts_ns < self._last_ns - BACK_NS
