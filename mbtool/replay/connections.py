"""The TCP connections of a recording: how each began and ended, and how much was asked on it."""

# A connection is read from its OPENED and CLOSED events, or from the REFUSED event of a tap that
# could not reach the slave. Its requests are those that its master sent, from the same address and
# port, between its opening and its end.
#
# Memory: one RecordedConnection for each connection of the recording.

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from mbtool.core import CONNECTION_JOINED, ConnectionEnd, EventKind, WireEvent
from mbtool.modbus.response import ConnectionEnding

if TYPE_CHECKING:
    from mbtool.modbus import Transaction
    from mbtool.replay.timeline import TimeRange

_UNREACHED = "cannot be reached"
"""Part of a tap's message when it could not connect to the slave; other refusals are the tap's."""


class Beginning(StrEnum):
    """How a master's attempt to connect went."""

    OPENED = "opened"
    JOINED = "open before the recording"
    REFUSED = "refused"
    UNANSWERED = "not answered"


@dataclass(slots=True)
class RecordedConnection:
    """A master's attempt to connect to a slave, and what became of the connection."""

    link: str
    master: str
    """The master's HOST:PORT."""
    slave: str
    """The slave's HOST:PORT; the name of the link if the recording lacks it."""
    begin_ns: int
    """The time (UTC ns) of the first SYN, or of the first packet in the recording."""
    beginning: Beginning
    end_ns: int | None = None
    """The time (UTC ns) of the end; None if it was open at the end of the recording."""
    end: ConnectionEnd | None = None
    asked: int = 0
    """The number of requests that the master sent."""
    last_ns: int = 0
    """The time (UTC ns) of the last request's last byte; without a request, `begin_ns`."""

    @property
    def is_open(self) -> bool:
        """True if a connection was made, so that requests could be sent."""
        return self.beginning in (Beginning.OPENED, Beginning.JOINED)

    @property
    def ended_by(self) -> str:
        """`master` or `slave`; empty if neither is known to have ended it."""
        return self.end.by if self.end is not None else ""

    @property
    def ending(self) -> ConnectionEnding | None:
        """How it was ended by master or slave: RESET or CLOSE; None if by neither of them."""
        if not self.ended_by or self.end is None:
            return None
        return ConnectionEnding.RESET if self.is_reset else ConnectionEnding.CLOSE

    @property
    def is_reset(self) -> bool:
        return self.end is not None and self.end.reason == "reset"

    @property
    def is_end_known(self) -> bool:
        """False if master or slave ended it, and the recording does not say which, as older
        logs do not.
        """
        is_ended = self.end is not None and self.end.reason in ("finished", "reset")
        return bool(self.ended_by) or not is_ended

    @property
    def text(self) -> str:
        """The kind of connection in words: `opened, reset by the slave`, `refused`."""
        if not self.is_open:
            return self.beginning.value
        return connection_text(self.beginning, self.ended_by, self.ending)


def connection_text(beginning: str, by: str, ending: ConnectionEnding | None) -> str:
    """The words for a connection that was made: how it began, and how `by` (`master`, `slave` or
    empty for neither) ended it.
    """
    how = "reset" if ending is ConnectionEnding.RESET else "closed"
    return f"{beginning}, {how} by the {by}" if by else f"{beginning}, left open"


class ConnectionHistory:
    """Collects the connections of a recording from its events and transactions."""

    def __init__(self) -> None:
        self._all: list[RecordedConnection] = []
        self._by_master: dict[tuple[str, str], list[RecordedConnection]] = {}

    def add_event(self, event: WireEvent) -> None:
        """Take an event; one that is of no connection does nothing."""
        of_master = self._by_master.setdefault((event.link, event.source), [])
        if event.kind is EventKind.OPENED or _is_unreached(event):
            beginning = Beginning.OPENED
            if event.message.startswith(CONNECTION_JOINED):
                beginning = Beginning.JOINED
            elif event.kind is EventKind.REFUSED:
                beginning = Beginning.REFUSED
            one = RecordedConnection(
                link=event.link,
                master=event.source,
                slave=event.destination or event.link,
                begin_ns=event.ts_ns,
                beginning=beginning,
                last_ns=event.ts_ns,
            )
            self._all.append(one)
            of_master.append(one)
        elif of_master and (end := ConnectionEnd.of(event)) is not None:
            _note_end(of_master[-1], end, event.ts_ns)

    def add(self, transaction: Transaction) -> None:
        """Count a request on its connection, whose OPENED event was taken before."""
        at_ns = transaction.request_ns
        of_master = self._by_master.get((transaction.link, transaction.source or ""), ())
        for one in reversed(of_master if at_ns is not None else ()):
            if at_ns is not None and one.begin_ns <= at_ns:
                one.asked += 1
                one.last_ns = max(one.last_ns, at_ns)
                break

    def of_slaves(self, slaves: Collection[str]) -> list[RecordedConnection]:
        """Return the connections to these slaves (HOST:PORT, or a link), by their beginning."""
        chosen = [one for one in self._all if one.slave in slaves]
        return sorted(chosen, key=lambda one: one.begin_ns)


def in_window(
    connections: Sequence[RecordedConnection], window: TimeRange, origin_ns: int
) -> list[RecordedConnection]:
    """Return the connections with a part in `window`, which counts from `origin_ns` (UTC ns)."""
    start_ns = origin_ns + window.start_ns
    chosen = []
    for one in connections:
        last_ns = one.end_ns if one.end_ns is not None else max(one.last_ns, start_ns)
        is_over = window.end_ns is not None and one.begin_ns >= origin_ns + window.end_ns
        if is_over or (window.start_ns and last_ns < start_ns):
            continue
        chosen.append(one)
    return chosen


def _is_unreached(event: WireEvent) -> bool:
    return event.kind is EventKind.REFUSED and _UNREACHED in event.message


def _note_end(one: RecordedConnection, end: ConnectionEnd, at_ns: int) -> None:
    if end.reason == Beginning.REFUSED:
        one.beginning = Beginning.REFUSED
    elif end.reason == "unanswered":
        one.beginning = Beginning.UNANSWERED
    elif one.end is None:
        one.end = end
        one.end_ns = at_ns if end.by else None
