"""Finds NET-LOST (TCP connections that were reset or refused) and NET-LOSSY (lost packets)."""

# NET-LOST. The account (ledger/account.py) counts how the connections of each master to each slave
# ended; events of the decoder are the evidence. Some masters reset a connection on purpose after
# each poll. If all connections that a master opens for single polls end like this, and no request
# was open then, NET-LOST is a note. A connection that was idle, or that was open at the end of the
# capture, does not count as lost.
#
# A request that was open when its connection was reset has no answer for this reason. If this is
# true of most missing answers of a unit, only NET-LOST reports them, and the unit has no trouble of
# its own. The time in which the master could not ask is the time from a reset to its next
# connection.
#
# Memory: MAX_EVIDENCE events, and a few numbers for each unit, for each of at most MAX_LINKS pairs
# of link and master; the last request of each of at most MAX_LINKS connections.

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import counted, duration, host_of
from mbtool.modbus import RESPONDED, Outcome
from mbtool.troubles.failed_shares import is_grave
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.statistics_connections import ConnectionTally
    from mbtool.ledger.statistics_report import LinkReport

# NET-LOSSY: the network between master and slave loses packets.
#
# A sender that gets no acknowledgement sends its segment again after 200 ms or longer. The decoder
# reports this (EventKind.SENT_AGAIN). Segments to a dead host are sent again, too. So a
# retransmission counts as a loss only if the master gets an answer after it.
#
# False alarms: a busy device that acknowledges late causes the same retransmissions, so the text of
# the trouble names it, too. Copies from a mirror port come within a few ms, and the decoder leaves
# them out.
#
# Memory: MAX_EVIDENCE cases and PENDING retransmissions for each of at most MAX_LINKS masters of a
# link.

MIN_RETRANSMISSIONS = 3
"""NET-LOSSY is reported from this many retransmissions on, or from HELD_NS on."""
HELD_NS = 1_000_000_000
"""NET-LOSSY is also reported for fewer than MIN_RETRANSMISSIONS retransmissions if an answer came
this long (ns) or longer after its request, and something was sent again in between."""
PENDING = 64
"""At most this many retransmissions wait for an answer after them; further ones are not counted."""


@dataclass(slots=True)
class _Path:
    """The retransmissions between one master and one slave."""

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

    def run(self, run: QuietRun) -> None:
        for form in run.forms if self._paths else ():
            path = self._paths.get((form.like.link, host_of(form.like.source)))
            if path is not None and path.pending:
                path.confirm(form.end_ns, form.end_ns)

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        whole = {link.name: link.tally for link in links if link.is_whole}
        for (link, master), path in self._paths.items():
            tally = whole.get(link)
            if tally is None or (path.count < MIN_RETRANSMISSIONS and path.held_ns < HELD_NS):
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


MIN_LOST = 3
"""NET-LOST is a note if fewer connections than this were lost."""
MIN_RESET_SHARE = 0.9
"""NET-LOST is a note if at least this share (0 to 1) of a master's connections is reset while no
request is open: the master ends its connections by a reset."""
MIN_CUT_SHARE = 0.5
"""If at least this share (0 to 1) of a unit's missing answers is missing because the connection was
reset, NET-LOST is their cause, and the unit has no trouble of its own."""
SHORTEST_PAUSE_NS = 100_000_000
"""The trouble says how long a master had no connection only if it is at least this time (ns) in
all."""
NOBODY = -2
"""The only victim of a NET-LOST that caused no unit's missing answers. No unit has this number; an
empty list of victims would mean all units."""
_ENDS = ("connection closed: reset", "connection closed: refused")
"""The beginnings of the messages of events for connections that were reset or refused."""


@dataclass(slots=True)
class _LostMaster:
    """What a master lost at one link."""

    cases: list[Evidence] = field(default_factory=list)
    cut: Counter[int] = field(default_factory=Counter)
    """By unit, the number of requests that were open when their connection was reset."""
    lost_ns: int | None = None
    """The time (UTC ns) of the first lost connection since the master last opened one; None if no
    connection was lost since."""
    pause_ns: int = 0
    """The sum of the times (ns) from a lost connection to the next one that was opened."""


class LostConnections(Sense):
    """Finds NET-LOST: connections that were reset or refused."""

    def __init__(self) -> None:
        self._masters: dict[tuple[str, str], _LostMaster] = {}
        self._open: OrderedDict[tuple[str, str], int] = OrderedDict()
        """The key is the link and the endpoint of the master; the value is the unit of the last
        request there, if that request has no answer."""

    def begin_capture(self) -> None:
        self._open.clear()
        for master in self._masters.values():
            master.lost_ns = None

    def transaction(self, one: NamedTransaction) -> None:
        if one.transport.is_serial or one.request_ns is None:
            return
        key = one.link, one.source or ""
        self._open.pop(key, None)
        if one.outcome is Outcome.NO_ANSWER:
            self._open[key] = one.unit
            if len(self._open) > MAX_LINKS:
                self._open.popitem(last=False)

    def event(self, event: WireEvent) -> None:
        is_refused = event.kind is EventKind.REFUSED
        if event.kind is EventKind.OPENED:
            self._note_opened(event.link, host_of(event.source), event.ts_ns)
        elif is_refused or (event.kind is EventKind.CLOSED and event.message.startswith(_ENDS)):
            self._note_lost(event)

    def run(self, run: QuietRun) -> None:
        for one in run.opened_and_closed:
            if one.first_opened_ns is not None:
                self._note_opened(one.link, one.host, one.first_opened_ns)

    def _note_opened(self, link: str, host: str, at_ns: int) -> None:
        master = self._masters.get((link, host))
        if master is not None and master.lost_ns is not None:
            master.pause_ns += at_ns - master.lost_ns
            master.lost_ns = None

    def _note_lost(self, event: WireEvent) -> None:
        key = event.link, host_of(event.source)
        master = self._masters.get(key)
        if master is None:
            if len(self._masters) >= MAX_LINKS:
                return
            master = self._masters[key] = _LostMaster()
        if len(master.cases) < MAX_EVIDENCE:
            master.cases.append(Evidence.of_event(event))
        master.lost_ns = event.ts_ns if master.lost_ns is None else master.lost_ns
        unit = self._open.pop((event.link, event.source or ""), None)
        if unit is not None:
            master.cut[unit] += 1

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        for link in links:
            if not link.is_whole:
                continue
            missing: Counter[int] = Counter()
            for one in link.functions:
                missing[one.unit] += one.tally.count(Outcome.NO_ANSWER)
            for name, tally in link.connections:
                lost = tally.resets + tally.refused
                if lost:
                    master = self._masters.get((link.name, name), _LostMaster())
                    yield _trouble(link, name, master, tally, missing)


def _trouble(
    link: LinkReport, name: str, master: _LostMaster, tally: ConnectionTally, missing: Counter[int]
) -> Trouble:
    lost = tally.resets + tally.refused
    whole = tally.opened + tally.joined + tally.refused
    parts = [f"{tally.resets:,} reset"] if tally.resets else []
    parts += [f"{tally.refused:,} refused"] if tally.refused else []
    is_often = lost >= MIN_LOST and lost >= MIN_RESET_SHARE * whole
    is_habit = is_often and not tally.refused and not master.cut
    units = [unit for unit, cut in master.cut.items() if cut >= MIN_CUT_SHARE * missing[unit]]
    return Trouble(
        code="NET-LOST",
        link=link.name,
        master=name,
        count=lost,
        of=whole,
        weight=lost,
        is_small=lost < MIN_LOST or is_habit,
        victims=tuple(units) or (NOBODY,),
        figures={
            "connections": f"{counted(lost, 'connection', ',')} of {name or 'masters'}",
            "ends": " and ".join(parts),
            "meanwhile": _meanwhile(link, master),
        },
        evidence=tuple(master.cases),
    )


def _meanwhile(link: LinkReport, master: _LostMaster) -> str:
    """Say what was cut off, and for how long nothing was asked; empty if nothing."""
    cut, text = master.cut.total(), ""
    if cut:
        text += f", {counted(cut, 'request', ',')} cut off"
    polled_ns = link.watched_ns - master.pause_ns
    if master.pause_ns >= SHORTEST_PAUSE_NS and polled_ns > 0:
        text += f"; nothing was asked for {duration(master.pause_ns)} in all"
        asked = round(link.tally.requests * master.pause_ns / polled_ns)
        if asked and master.cut:
            text += f", about {counted(asked, 'request', ',')}"
    return text
