"""Finds LINE-ONE-SIDE, LINE-ECHO and LINE-REPEATED: one side missing, or frames that come twice."""

# LINE-ONE-SIDE  Only requests, or only responses, are heard: the tap is on one pair of a four-wire
#                line, or at one of two ports. Only responses: at least MIN_ALONE responses have no
#                request, and all requests are writes, which look like their responses. Only
#                requests: none of at least MIN_ALONE requests has a response, no other byte is on
#                the line, and at least two units are asked. With one unit, a dead slave is as
#                likely; then the trouble is reported only if the master mostly sends the next
#                request sooner than any master gives up, which shows that it got the responses.
# LINE-ECHO      The decoder reports a second copy of a request (EventKind.ECHO): the adapter hears
#                its own bytes. This causes no failure, so it is a note.
# LINE-REPEATED  A response without a request has the same bytes as the previous response, or the
#                decoder reports a second copy of a response (EventKind.REPEATED): frames come
#                twice, as from a repeater or from two taps on one line. An answered retry gives
#                equal responses, too, but then the second one has a request.
#
# Memory: a few numbers, the last response, and MAX_EVIDENCE cases, for each of at most MAX_LINKS
# links.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus import RESPONDED, Outcome
from mbtool.troubles.line_late import SHORTEST_TIMEOUT_NS
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from mbtool.ledger.statistics_report import LinkReport

MIN_ALONE = 10
"""LINE-ONE-SIDE is reported from this many requests, or responses, on."""
MIN_COPIES = 3
"""LINE-ECHO and LINE-REPEATED are reported from this many copies on."""
SOON_NS = 1_000_000_000
"""A response without a request counts as a copy of the last response, if its bytes are the same and
it comes at most this long (ns) after it."""
MIN_COPIED_SHARE = 0.1
"""LINE-REPEATED is reported if copies are at least this share (0 to 1) of the responses."""
MIN_QUICK_REQUESTS = 0.5
"""If only one unit is asked, LINE-ONE-SIDE is reported only if at least this share (0 to 1) of the
requests came within SHORTEST_TIMEOUT_NS of the one before."""
_ECHOING = frozenset((0x05, 0x06, 0x08, 0x0F, 0x10, 0x16))
"""Functions whose response can have the form of a request."""
_BYTES = frozenset((EventKind.SKIPPED, EventKind.BAD_CHECK, EventKind.ECHO, EventKind.REPEATED))


@dataclass(slots=True)
class _SidedLine:
    units: set[int] = field(default_factory=set)
    requests: int = 0
    other_requests: int = 0
    """The number of requests with a function whose response never looks like a request."""
    last_ns: int = 0
    """The time (UTC ns) of the last request."""
    soon: int = 0
    """The number of requests that came less than SHORTEST_TIMEOUT_NS after the request before: no
    master gives up a request within this time."""
    responses: int = 0
    alone: int = 0
    """The number of responses without a request."""
    copies: int = 0
    echoes: int = 0
    other: int = 0
    """The number of events about bytes that are no frame."""
    last: NamedTransaction | None = None
    """The last transaction with a response."""
    alone_cases: list[Evidence] = field(default_factory=list)
    copy_cases: list[Evidence] = field(default_factory=list)
    echo_cases: list[Evidence] = field(default_factory=list)
    asked_cases: list[Evidence] = field(default_factory=list)


class HeardSides(Sense):
    """Finds LINE-ONE-SIDE, LINE-ECHO and LINE-REPEATED."""

    def __init__(self) -> None:
        self._lines: dict[str, _SidedLine] = {}

    def _line(self, link: str) -> _SidedLine | None:
        line = self._lines.get(link)
        if line is None and len(self._lines) < MAX_LINKS:
            line = self._lines[link] = _SidedLine()
        return line

    def event(self, event: WireEvent) -> None:
        if event.kind not in _BYTES or event.source or (line := self._line(event.link)) is None:
            return
        if event.kind is EventKind.ECHO:
            line.echoes += 1
            keep(line.echo_cases, Evidence.of_event(event))
        elif event.kind is EventKind.REPEATED:
            line.copies += 1
            keep(line.copy_cases, Evidence.of_event(event))
        else:
            line.other += 1

    def transaction(self, one: NamedTransaction) -> None:
        if not one.transport.is_serial or (line := self._line(one.link)) is None:
            return
        if len(line.units) < 256:
            line.units.add(one.unit)
        if one.request_ns is not None:
            line.requests += 1
            line.other_requests += one.function not in _ECHOING
            line.soon += 0 < one.request_ns - line.last_ns < SHORTEST_TIMEOUT_NS
            line.last_ns = one.request_ns
            if one.outcome is Outcome.NO_ANSWER:
                keep(line.asked_cases, Evidence.of(one))
        if one.outcome not in RESPONDED and one.request_ns is not None:
            return
        line.responses += 1
        last, line.last = line.last, one
        if one.request_ns is not None:
            return
        line.alone += 1
        keep(line.alone_cases, Evidence.of(one))
        if last is None or last.response_ns is None or one.response_ns is None:
            return
        if not one.response_raw or last.response_raw != one.response_raw:
            return
        if one.response_ns - last.response_ns <= SOON_NS:
            line.copies += 1
            keep(line.copy_cases, Evidence.of(one))

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        for link in links:
            line = self._lines.get(link.name)
            if line is None or not link.is_whole:
                continue
            is_repeated = line.copies >= max(MIN_COPIES, MIN_COPIED_SHARE * line.responses)
            if line.echoes >= MIN_COPIES and not is_repeated:
                yield Trouble(
                    code="LINE-ECHO", link=link.name, count=line.echoes, of=line.requests,
                    evidence=tuple(line.echo_cases),
                )  # fmt: skip
            if is_repeated:
                yield Trouble(
                    code="LINE-REPEATED", link=link.name, count=line.copies, of=line.responses,
                    evidence=tuple(line.copy_cases),
                )  # fmt: skip
            elif line.alone >= MIN_ALONE and not line.other_requests:
                yield Trouble(
                    code="LINE-ONE-SIDE", link=link.name, count=line.alone, of=line.responses,
                    figures={"side": "responses", "lacking": "requests"},
                    sureness=Sureness.LIKELY, evidence=tuple(line.alone_cases),
                )  # fmt: skip
            elif (
                line.requests >= MIN_ALONE
                and not line.responses
                and not line.other
                and (len(line.units) > 1 or line.soon >= MIN_QUICK_REQUESTS * line.requests)
            ):
                yield Trouble(
                    code="LINE-ONE-SIDE", link=link.name, count=line.requests, of=line.requests,
                    figures={"side": "requests", "lacking": "responses"},
                    sureness=Sureness.LIKELY, evidence=tuple(line.asked_cases),
                )  # fmt: skip
