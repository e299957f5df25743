"""NET-LOSSY: a path between master and slave that loses packets."""

# A sender that gets no acknowledgement sends its segment again, after 200 ms or longer. The decoder
# tells of that (EventKind.SENT_AGAIN). It is a loss if the connection goes on: what is sent to a
# dead host, too, is sent again, but nobody ever answers it. So a retransmission counts only when
# the master gets an answer after it.
#
# False alarms: a device that acknowledges late, as it is busy, looks the same, so the words say so.
# Copies that a mirror port makes come within some ms, and the decoder leaves them out.
#
# Memory: MAX_EVIDENCE cases and PENDING retransmissions for each of at most MAX_LINKS masters of a
# link.

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.core.wording import duration, host_of
from mbtool.modbus import RESPONDED
from mbtool.troubles.failed_shares import is_grave
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.answered_run import AnsweredRun
    from mbtool.ledger.statistics_report import LinkReport

ENOUGH = 3
HELD_NS = 1_000_000_000
"""Fewer retransmissions than ENOUGH are told if one held an answer up for so long (ns)."""
PENDING = 64


@dataclass(slots=True)
class _Path:
    """What was sent again between one master and one slave."""

    count: int = 0
    pending: list[WireEvent] = field(default_factory=list)
    """Retransmissions after which no answer was heard yet."""
    cases: list[Evidence] = field(default_factory=list)
    held_ns: int = 0
    """The greatest latency of a request that waited while something was sent again."""

    def confirm(self, asked_ns: int, answered_ns: int) -> None:
        """Count the retransmissions before an answer, and how long the request waited for them."""
        for event in self.pending:
            if event.ts_ns <= answered_ns:
                self.count += 1
                keep(self.cases, Evidence.of_event(event))
                if asked_ns <= event.ts_ns:
                    self.held_ns = max(self.held_ns, answered_ns - asked_ns)
        self.pending = [event for event in self.pending if event.ts_ns > answered_ns]


class LossyPaths(Sense):
    """Finds NET-LOSSY."""

    def __init__(self) -> None:
        self._paths: dict[tuple[str, str], _Path] = {}
        """By link and the master's host."""

    def begin_capture(self) -> None:
        for path in self._paths.values():
            path.pending.clear()

    def event(self, event: WireEvent) -> None:
        if event.kind is not EventKind.SENT_AGAIN:
            return
        is_request = event.link in (event.destination, host_of(event.destination))
        key = event.link, host_of(event.source if is_request else event.destination)
        path = self._paths.get(key)
        if path is None:
            if len(self._paths) >= MAX_LINKS:
                return
            path = self._paths[key] = _Path()
        if len(path.pending) < PENDING:
            path.pending.append(event)

    def transaction(self, one: NamedTransaction) -> None:
        if not self._paths or one.response_ns is None or one.outcome not in RESPONDED:
            return
        path = self._paths.get((one.link, host_of(one.source)))
        if path is not None and path.pending:
            path.confirm(one.start_ns, one.response_ns)

    def run(self, run: AnsweredRun) -> None:
        for kind in run.forms() if self._paths else ():
            path = self._paths.get((kind.like.link, host_of(kind.like.source)))
            if path is not None and path.pending:
                path.confirm(kind.end_ns, kind.end_ns)

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        whole = {link.name: link.tally for link in links if link.is_whole}
        for (link, master), path in self._paths.items():
            tally = whole.get(link)
            if tally is None or (path.count < ENOUGH and path.held_ns < HELD_NS):
                continue
            held = f", an answer took {duration(path.held_ns)} then" if path.held_ns else ""
            messages = tally.requests + sum(map(tally.count, RESPONDED))
            yield Trouble(
                code="NET-LOSSY", link=link, master=master, count=path.count,
                of=max(messages, path.count), weight=path.count,
                figures={"held": held},
                is_small=not is_grave(path.count, messages), sureness=Sureness.LIKELY,
                evidence=tuple(path.cases),
            )  # fmt: skip
