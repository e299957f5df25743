"""Decides whether a file continues the file before it, as a further part of one capture."""

# tcpdump -G and -C, dumpcap -b and sniff --rotate split a capture into several files while
# connections are open, so a transaction may begin in one file and end in the next. A file is the
# next part of the capture
#
#     of packets    if its first packet is not earlier (by more than BACK_NS) than the last packet
#                   of the file before it, is later than the first packet of that file, and has a
#                   link type that the file before has, too
#     of a log      if it has the same run, links, devices and profiles, and the next part number;
#                   and it does not begin earlier
#
# Any other file is a new capture, whose connections are not joined to earlier ones. Two unrelated
# files of packets in order of time are taken as parts of one capture. This does no harm: sequence
# numbers and the time between the files keep their connections apart (packets/reassembler.py).

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Packet

if TYPE_CHECKING:
    from mbtool.decode.decoder import Evidence
    from mbtool.logs import LogReader

BACK_NS = 1_000_000_000
"""A first item up to so many ns earlier than the last item still continues the capture: packets of
several interfaces, and bytes of several ports, are written slightly out of order."""

_PART = "part"


@dataclass(frozen=True, slots=True)
class Part:
    """The capture that a log belongs to, and which part of it. Files of packets do not say that."""

    number: int | None = None
    run: tuple[object, ...] = ()

    @classmethod
    def of_log(cls, log: LogReader) -> Part:
        """Read run and part number from the head of a log, before its items."""
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
    """The state of a capture read so far: times of its first and last item, and its link types."""

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
        """True if this first packet of a file is older than packets of earlier files.

        Then the user has named the files of the capture in the wrong order.
        """
        if self._first_ns is None or self._last_ns is None or not isinstance(item, Packet):
            return False
        is_alike = item.link_type in self._types
        return is_alike and self._first_ns <= item.ts_ns < self._last_ns - BACK_NS
