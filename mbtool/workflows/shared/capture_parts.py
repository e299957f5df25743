"""Decides whether a file continues the file before it, as a further part of one capture."""

# tcpdump -G and -C, dumpcap -b and sniff --rotate split a capture into several files while
# connections are open, so a transaction may begin in one file and end in the next.
#
# A file of packets continues the capture of the file before it if its first packet is later than
# the first packet of that file, at most BACK_NS earlier than its last packet, and has a link type
# that also occurs in that file.
#
# A log continues the log before it if both have the same metadata of the recording, links, devices
# and profiles, if its part number is the next one, and if it does not begin earlier.
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
"""A file continues a capture even if its first packet or chunk is earlier than the last one of the
file before, by up to this time (ns): packets of several interfaces, and bytes of several ports, are
written slightly out of order."""

_PART = "part"


@dataclass(frozen=True, slots=True)
class Part:
    """Identifies a file as a part of a capture: by a part number and the metadata of its recording.

    A file of packets has no such data, so its number is None and `run` is empty.
    """

    number: int | None = None
    run: tuple[object, ...] = ()

    @classmethod
    def of_log(cls, log: LogReader) -> Part:
        """Take the part number and the metadata of the recording from the head of a log."""
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
    """The end of the capture read so far, to check if the next file continues it.

    It has the times of the first and the last item (packet or chunk), and all link types.
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
        """True if a file whose first packet or chunk is `item` can be the next part."""
        if self._last_ns is None or self._first_ns is None:
            return True
        if item.ts_ns <= self._first_ns < self._last_ns:
            return False
        if isinstance(item, Packet) and self._types and item.link_type not in self._types:
            return False
        return item.ts_ns >= self._last_ns - BACK_NS

    def is_overtaken_by(self, item: Evidence) -> bool:
        """True if `item`, the first packet of a file, is older than packets of earlier files.

        Then the user has probably named the parts of a capture in the wrong order.
        """
        if self._first_ns is None or self._last_ns is None or not isinstance(item, Packet):
            return False
        is_alike = item.link_type in self._types
        return is_alike and self._first_ns <= item.ts_ns < self._last_ns - BACK_NS
