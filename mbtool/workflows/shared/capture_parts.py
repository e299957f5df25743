"""Decides whether a file continues the file before it, as a further part of one capture."""

# tcpdump -G and -C, dumpcap -b and sniff --rotate split a capture into several files while
# connections are open, so a transaction may begin in one file and end in the next.
#
# A file of packets continues the capture of the file before it if its first packet is later than
# the first packet of that file, at most BACK_NS earlier than its last packet, and has a link type
# that also occurs in that file; and if it does not come later than GAP_NS, and than the capture so
# far is long. A rotated capture goes on at once, or as soon as somebody speaks again.
#
# A log continues the log before it if both have the same metadata of the recording, links, devices
# and profiles, if its part number is the next one, and if it does not begin earlier.
#
# Any other file is a new capture, whose connections are not joined to earlier ones. Two unrelated
# files of packets that follow each other soon are taken as parts of one capture. Sequence numbers
# and the time between the files keep their connections apart (packets/reassembler.py).

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Packet

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
    """The facts about the capture read so far that decide if the next file continues it.

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
