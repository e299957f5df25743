"""Reports on a running `sniff --service`: as messages to the service manager (systemd), and as
records in the log.
"""

# docs/service.md describes the heartbeats, the messages and a unit for systemd.

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from mbtool.core.moments import counted
from mbtool.ports.clock import monotonic_ns, now_ns
from mbtool.ports.service_manager import ServiceManager
from mbtool.workflows.shared.heartbeat import HeartbeatLog, StatusLog

if TYPE_CHECKING:
    from mbtool.workflows.sniff import Sniffer

STATUS_NS = 10_000_000_000
"""The time in ns between two status messages to the service manager."""
STUCK_NS = 20_000_000_000
"""If the thread that writes the log has not called `HeartbeatLog.tick` for this many ns, it is
stuck, as with a disk that does not respond. Then the service manager gets no sign of life, so that
it restarts the service."""


class ServiceRun:
    """Reports on one run of `sniff --service`: status and signs of life to the service manager,
    heartbeats to the log.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._manager = ServiceManager(environment)
        self._sniffer: Sniffer | None = None
        self._log: HeartbeatLog | None = None
        self._status_ns = self._alive_ns = 0

    def with_heartbeats(self, create: Callable[[], StatusLog]) -> HeartbeatLog:
        """Create the log with `create`, and return it in a wrapper that also gives it heartbeats.

        Heartbeats are records that say at intervals that the recording runs (docs/service.md).
        """
        self._log = HeartbeatLog(create(), self._lost_links, now_ns())
        return self._log

    def begin(self, sniffer: Sniffer) -> None:
        """Tell the service manager that the recording has begun."""
        self._sniffer = sniffer
        self._manager.ready(self._sentence())

    def look(self) -> None:
        """Send the messages that are due to the service manager; called several times a second.

        They are a status every STATUS_NS, and a sign of life three times in the watchdog's time.
        """
        at_ns = monotonic_ns()
        if at_ns - self._status_ns >= STATUS_NS:
            self._status_ns = at_ns
            self._manager.status(self._sentence())
        every_s = self._manager.watchdog_s
        is_due = every_s is not None and at_ns - self._alive_ns >= every_s / 3 * 1e9
        if is_due and (self._log is None or now_ns() - self._log.ticked_ns < STUCK_NS):
            self._alive_ns = at_ns
            self._manager.alive()

    def end(self) -> None:
        self._manager.stopping()

    def _lost_links(self) -> list[str]:
        return [] if self._sniffer is None else self._sniffer.lost_links

    def _sentence(self) -> str:
        if self._log is None:
            return "recording"
        counts = self._log.counts
        lost = self._lost_links()
        parts = [f"{counted(counts.outcomes.total(), 'transaction', ',')}"]
        parts += [f"{counts.outcomes[name]:,} {name}" for name in sorted(counts.outcomes)]
        if counts.lost_bytes or counts.lost_packets:
            parts.append(f"{counts.lost_bytes:,} bytes and {counts.lost_packets:,} packets lost")
        if counts.waiting:
            parts.append(f"decoder {counts.waiting:,} pieces behind")
        return "; ".join([f"lost: {', '.join(lost)}" if lost else "recording", ", ".join(parts)])
