"""Divides the time of a serial line into bytes sent, latencies, missing answers and pauses."""

# At any time, a two-wire line is in one of these states:
#
#     characters   Bytes are on the line. The time is computed from their number, the baud rate and
#                  the character format.
#     slaves       The master waits for a response that comes: the latency of the slave.
#     missing      The master waits until its timeout, and no response comes. After a response with
#                  a wrong CRC the master does not wait, so no time is counted.
#     pauses       All the rest: the master sends nothing and waits for nothing.
#
# The timeout is estimated once for each master (poll_cycle.py), because the time between an
# unanswered request and the next one may also include a pause.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.ledger.link_statistics import LinkStatistics
    from mbtool.ledger.request_tally import RequestTally


@dataclass(frozen=True, slots=True, kw_only=True)
class LineTime:
    """The division of a part of a serial line's time (ns): characters, waits for responses that
    came, and waits for responses that never came.
    """

    characters_ns: int
    slaves_ns: int
    missing_ns: int

    @property
    def total_ns(self) -> int:
        return self.characters_ns + self.slaves_ns + self.missing_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLoad:
    """The division of the time during which a serial line was watched: characters, latencies,
    missing responses and pauses.
    """

    watched_ns: int
    spent: LineTime
    other_ns: int
    """The time (ns) taken by characters that belong to no frame, such as noise."""

    def share_of_time(self, ns: int) -> float:
        """Return `ns` as a share (0 to 1) of the time during which the line was watched."""
        return min(ns / self.watched_ns, 1.0) if self.watched_ns else 0.0

    @property
    def busy_share(self) -> float:
        """The share (0 to 1) of the watched time in which characters were on the line."""
        return self.share_of_time(self.spent.characters_ns + self.other_ns)

    @property
    def pauses_ns(self) -> int:
        return max(self.watched_ns - self.spent.total_ns - self.other_ns, 0)


def line_time(tally: RequestTally, link: LinkStatistics, timeout_ns: int) -> LineTime:
    """Return the time of a serial line that the transactions counted in `tally` took.

    `timeout_ns` is the time, in ns, that the master waits for a missing response.
    """
    return LineTime(
        characters_ns=link.wire_ns(tally.wire_bytes),
        slaves_ns=tally.latency.total,
        missing_ns=(tally.unanswered - tally.damaged) * timeout_ns,
    )


def bus_load(tally: RequestTally, link: LinkStatistics, timeout_ns: int) -> BusLoad | None:
    """Return the division of a serial line's time; `tally` counts all its transactions.

    None if the baud rate or the times of the bytes are unknown, or if the line's settings changed.
    `timeout_ns` is the time, in ns, that the master waits for a missing response.
    """
    if link.format is None or link.is_mixed or not link.watched_ns:
        return None
    return BusLoad(
        watched_ns=link.watched_ns,
        spent=line_time(tally, link, timeout_ns),
        other_ns=link.wire_ns(link.other_bytes),
    )
