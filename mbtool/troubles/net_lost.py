"""NET-LOST: TCP connections that were reset or refused."""

# The account counts the connections of each master to each slave by how they ended; the events give
# the evidence. A reset is also how some masters end a connection on purpose (after each poll, or to
# be quick). So resets of connections that a master opens for single polls, all of which end so, are
# a note. A connection that the capture's end cuts, or that was idle, is none.
#
# Memory: MAX_EVIDENCE events for each of at most MAX_LINKS links.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.core.wording import counted, host_of
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Trouble

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.core import WireEvent
    from mbtool.ledger.statistics_connections import ConnectionTally
    from mbtool.ledger.statistics_report import LinkReport

FEW = 3
"""Fewer lost connections than this are a note."""
MOSTLY = 0.9
"""If at least this share (0 to 1) of a master's connections are reset, it ends them so."""
_ENDS = ("connection closed: reset", "connection closed: refused")


class LostConnections(Sense):
    """Finds NET-LOST: connections that were reset or refused."""

    def __init__(self) -> None:
        self._cases: dict[tuple[str, str], list[Evidence]] = {}

    def event(self, event: WireEvent) -> None:
        is_refused = event.kind is EventKind.REFUSED
        if not is_refused and (
            event.kind is not EventKind.CLOSED or not event.message.startswith(_ENDS)
        ):
            return
        key = event.link, host_of(event.source)
        cases = self._cases.get(key)
        if cases is None:
            if len(self._cases) >= MAX_LINKS:
                return
            cases = self._cases[key] = []
        if len(cases) < MAX_EVIDENCE:
            cases.append(Evidence.of_event(event))

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        for link in links:
            if not link.is_whole:
                continue
            for master, tally in link.connections:
                lost = tally.resets + tally.refused
                if lost:
                    yield self._trouble(link.name, master, tally, lost)

    def _trouble(self, link: str, master: str, tally: ConnectionTally, lost: int) -> Trouble:
        whole = tally.opened + tally.joined + tally.refused
        parts = [f"{tally.resets:,} reset"] if tally.resets else []
        parts += [f"{tally.refused:,} refused"] if tally.refused else []
        is_habit = not tally.refused and lost >= MOSTLY * whole and lost >= FEW
        return Trouble(
            code="NET-LOST",
            link=link,
            master=master,
            count=lost,
            of=whole,
            weight=lost,
            is_small=lost < FEW or is_habit,
            figures={
                "connections": f"{counted(lost, 'connection', ',')} of {master or 'masters'}",
                "ends": " and ".join(parts),
            },
            evidence=tuple(self._cases.get((link, master), ())),
        )
