"""Divides the time of a serial line into characters, slaves, missing answers and pauses."""

# A line of two wires does one thing at a time:
#
#     characters   bytes on the line, by baud rate and character format
#     slaves       from the end of a request to the start of its response
#     missing      from the end of a request to when the master gave up waiting; nothing for an
#                  answer with a wrong CRC, after which the master does not wait any longer
#     pauses       all the rest: the master asks nothing
#
# The time that a master waits for an answer is estimated once for each master (master_tape.py),
# because the time after a missing answer may also hold a pause.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.overview.link_statistics import LinkStatistics
    from mbtool.overview.request_tally import RequestTally


@dataclass(frozen=True, slots=True, kw_only=True)
class LineTime:
    """The time (ns) that a line spent on characters, waiting for slaves, and missing answers."""

    characters_ns: int
    slaves_ns: int
    missing_ns: int

    @property
    def total_ns(self) -> int:
        return self.characters_ns + self.slaves_ns + self.missing_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLoad:
    """How the time of a serial line was spent while it was watched."""

    watched_ns: int
    spent: LineTime
    other_ns: int
    """The time of characters that belong to no frame, in ns."""

    def share(self, ns: int) -> float:
        """A time as a share of the time that the line was watched, 0 to 1."""
        return min(ns / self.watched_ns, 1.0) if self.watched_ns else 0.0

    @property
    def busy_share(self) -> float:
        """The share of time in which there were characters on the line."""
        return self.share(self.spent.characters_ns + self.other_ns)

    @property
    def pauses_ns(self) -> int:
        return max(self.watched_ns - self.spent.total_ns - self.other_ns, 0)


def line_time(tally: RequestTally, link: LinkStatistics, timeout_ns: int) -> LineTime:
    """How long the requests of a tally kept the line busy."""
    return LineTime(
        characters_ns=link.wire_ns(tally.wire_bytes),
        slaves_ns=tally.latency.total,
        missing_ns=(tally.unanswered - tally.damaged) * timeout_ns,
    )


def bus_load(tally: RequestTally, link: LinkStatistics, timeout_ns: int) -> BusLoad | None:
    """The load of a line by all its requests; None if its baud rate or its times are unknown, or if
    its settings changed.
    """
    if link.format is None or link.is_mixed or not link.watched_ns:
        return None
    return BusLoad(
        watched_ns=link.watched_ns,
        spent=line_time(tally, link, timeout_ns),
        other_ns=link.wire_ns(link.other_bytes),
    )
