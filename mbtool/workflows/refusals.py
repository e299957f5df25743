"""Tells which refusals of a tap are news: a master that tries again and again is told of once."""

# A reason is news once for each link, until a master was served again: by a connection that opened
# after the refusal, since one that was open before it shows nothing, and with an answer, since a
# slave with TLS 1.3 may refuse the tap just after the opening.
#
# Holds for each link that refused, until then, at most MAX_REASONS reasons (what comes beyond is no
# news) and the masters' ends of the connections that are open since.

from __future__ import annotations

from typing import TYPE_CHECKING, TypeGuard

from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Outcome

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

MAX_REASONS = 64


class Refusals:
    """Why masters were turned away, by link."""

    def __init__(self) -> None:
        self._reasons: dict[str, set[str]] = {}
        self._open: dict[str, set[str]] = {}

    def is_news(self, record: NamedTransaction | WireEvent) -> TypeGuard[WireEvent]:
        """Take what happened next; whether it is a refusal that was not told yet."""
        link = record.link
        if not isinstance(record, WireEvent):
            is_answered = record.outcome in (Outcome.OK, Outcome.EXCEPTION)
            if is_answered and record.source in self._open.get(link, ()):
                del self._reasons[link], self._open[link]
            return False
        if record.kind is EventKind.REFUSED:
            reasons = self._reasons.setdefault(link, set())
            if record.message in reasons or len(reasons) >= MAX_REASONS:
                return False
            reasons.add(record.message)
            return True
        if record.kind is EventKind.OPENED and link in self._reasons:
            self._open.setdefault(link, set()).add(record.source)
        elif record.kind is EventKind.CLOSED and link in self._open:
            self._open[link].discard(record.source)
        return False
