"""Writes a log of `sniff --service` with heartbeats: records with counters for `mbtool status`.

A heartbeat is a metadata record `mbtool.status` (docs/service.md). It is written at the start,
after 1 s, 3 s, 7 s and so on, then every minute, when a link is lost or returns, and at the end.
"""

# The recorder's thread calls `write` and `tick`. So a heartbeat also proves that this thread runs.
#
# Memory: the counters.

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

from mbtool.core import Chunk, EventKind, Packet, WireEvent
from mbtool.devices import NamedTransaction
from mbtool.workflows.shared.checked_log import FindingsLog

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.logs.messages import DecodingMark, LogItem

HEARTBEAT_NS = 60_000_000_000
"""The longest time (ns) from one heartbeat to the next. One also comes when a link is lost or is
back."""


_FIRST_NS = 1_000_000_000
"""The time (ns) from the first heartbeat to the second one; then it doubles up to HEARTBEAT_NS, so
that a recording that has just begun soon shows what it hears."""


class StatusLog(FindingsLog, Protocol):
    """A log writer to which heartbeats can be written, too."""

    def add_status(self, values: Mapping[str, str]) -> None: ...


class Counts:
    """Counts what was recorded so far: chunks and packets, their bytes, transactions, events and
    losses.
    """

    def __init__(self) -> None:
        self.pieces = 0
        self.bytes = 0
        self.outcomes: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.lost_bytes = 0
        self.lost_packets = 0
        self.waiting = 0
        """The number of recorded chunks and packets that are not decoded yet, according to the last
        mark in the log."""
        self.last_ns = 0
        """The time of the latest chunk or packet, in UTC ns."""

    def add(self, item: LogItem | DecodingMark) -> None:
        if isinstance(item, Chunk | Packet):
            self.pieces += 1
            self.bytes += len(item.data)
            self.last_ns = max(self.last_ns, item.ts_ns)
        elif isinstance(item, NamedTransaction):
            self.outcomes[item.outcome] += 1
        elif isinstance(item, WireEvent):
            self.events[item.kind] += 1
            if item.kind is EventKind.DISCARDED:
                self.lost_bytes += item.missing
                self.lost_packets += item.packets
        else:
            self.waiting = item.waiting

    def values(self) -> dict[str, str]:
        """Return the counters as the keys and values (both texts) of a heartbeat."""
        transactions = {f"transactions.{name}": str(n) for name, n in self.outcomes.items()}
        events = {f"events.{name}": str(count) for name, count in self.events.items()}
        return {
            "pieces": str(self.pieces),
            "bytes": str(self.bytes),
            "last_ns": str(self.last_ns),
            "lost_bytes": str(self.lost_bytes),
            "lost_packets": str(self.lost_packets),
            "waiting": str(self.waiting),
            **transactions,
            **events,
        }


class HeartbeatLog:
    """A log writer that passes all items on to another one, counts them, and adds the
    heartbeats.
    """

    def __init__(
        self,
        log: StatusLog,
        lost_links: Callable[[], list[str]],
        now_ns: int,
    ) -> None:
        """`log` is the log writer to pass items to. `lost_links` returns the names of the links
        that are lost at present. `now_ns` is the present time in UTC ns.
        """
        self._log = log
        self._lost_links = lost_links
        self._began_ns = now_ns
        self._beat_ns: int | None = None
        self._period_ns = _FIRST_NS
        self._told_lost: list[str] = []
        self.counts = Counts()
        self.ticked_ns = now_ns
        """The time (UTC ns) at which the recorder's thread last called `tick`. A watchdog checks it
        to see that the thread runs."""

    def write(self, item: LogItem | DecodingMark) -> None:
        self.counts.add(item)
        self._log.write(item)

    def add_finding(self, finding: Finding, known_ns: int) -> None:
        self._log.add_finding(finding, known_ns)

    def tick(self, now_ns: int) -> None:
        self.ticked_ns = now_ns
        lost = self._lost_links()
        if (
            self._beat_ns is None
            or lost != self._told_lost
            or not 0 <= now_ns - self._beat_ns < self._period_ns
        ):
            if self._beat_ns is not None:
                self._period_ns = min(2 * self._period_ns, HEARTBEAT_NS)
            self._beat_ns, self._told_lost = now_ns, lost
            self._beat("recording", now_ns)
        self._log.tick(now_ns)

    def close(self, final: Mapping[str, str]) -> None:
        try:
            self._beat("ended", self.ticked_ns)
        finally:
            self._log.close(final)

    def _beat(self, state: str, now_ns: int) -> None:
        self._log.add_status(
            {
                "state": state,
                "ts_ns": str(now_ns),
                "began_ns": str(self._began_ns),
                "lost_links": " ".join(self._told_lost),
                **self.counts.values(),
            }
        )
