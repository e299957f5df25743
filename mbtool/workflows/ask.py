"""Sends requests to a slave as its master, for the commands `read`, `write` and `poll`."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import LinkSpec, SerialLink, TcpLink, WireEvent
from mbtool.core.moments import milliseconds
from mbtool.decode.connections import skipped_event
from mbtool.decode.transactions import Ends, broadcast, no_answer, with_response
from mbtool.devices import Assignment, Assignments, Namer, PointValue, Who, write_reference
from mbtool.ledger.distribution import Distribution
from mbtool.modbus import FUNCTIONS, Adu, Outcome
from mbtool.modbus.adu import Transport
from mbtool.ports.clock import steady_clock

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.master.links import MasterLink

ANSWERED_OUTCOMES = (Outcome.OK, Outcome.BROADCAST)


def transport_of(link: LinkSpec) -> Transport:
    """The transport (RTU, ASCII, TCP, UDP or RTU over these) that a master uses on this link."""
    if isinstance(link, TcpLink):
        return Transport.at_endpoint(is_rtu=link.rtu, is_udp=link.is_udp)
    is_ascii = isinstance(link, SerialLink) and link.ascii
    return Transport.ASCII if is_ascii else Transport.RTU


class Asker:
    """Sends requests to one unit as its master, and returns each with its response as a named
    transaction.
    """

    def __init__(self, master: MasterLink, link: LinkSpec, unit: int, profile: Profile | None):
        self._master = master
        self._unit = unit
        self._ends = Ends(link.name)
        own = [] if profile is None else [Assignment(Who(), profile)]
        self._assignments = Assignments(own)
        self._namer = Namer(self._assignments)
        self._ahead_ns = steady_clock()() - time.monotonic_ns()
        """UTC minus the monotonic clock, in ns. It is measured only once, so that the times of
        transactions never go back if the system's clock is set."""

    def profile_for(self, transaction: NamedTransaction) -> Profile | None:
        return self._assignments.profile_for(transaction)

    def ask(self, pdu: bytes) -> tuple[NamedTransaction, list[WireEvent]]:
        """Send a request (its PDU) to the unit and wait for the response.

        Returns the transaction, and events about received bytes that are no response. Raises
        LinkError if a serial port is lost.
        """
        exchange = self._master.exchange(self._unit, pdu)
        request = self._in_utc(exchange.request)
        if exchange.response is not None:
            response = self._in_utc(exchange.response)
            transaction = with_response(self._ends, request, response, 0, ())
        elif request.unit == 0 and request.transport.is_serial:
            transaction = broadcast(self._ends, request)
        else:
            transaction = no_answer(self._ends, request, 0)
        events = [
            skipped_event(replace(one, ts_ns=one.ts_ns + self._ahead_ns), self._ends.link, ("", ""))
            for one in exchange.unread
        ]
        return self._namer.name(transaction), events

    def stop_when(self, is_stopped: Callable[[], bool]) -> None:
        """Let no request wait for a pause of another master once `is_stopped` returns True."""
        self._master.is_stopped = is_stopped

    def listen(self, time_ns: int) -> None:
        """Hear another master of the line for a time (ns), to learn the pauses that it leaves."""
        self._master.listen(time_ns)

    def _in_utc(self, adu: Adu) -> Adu:
        return msgspec.structs.replace(
            adu, start_ns=adu.start_ns + self._ahead_ns, end_ns=adu.end_ns + self._ahead_ns
        )


@dataclass(slots=True)
class PollTally:
    """Counts requests by outcome, and collects the latencies of their responses."""

    outcomes: Counter[Outcome] = field(default_factory=Counter)
    latencies: Distribution = field(default_factory=Distribution)

    def add(self, transaction: NamedTransaction) -> None:
        self.outcomes[transaction.outcome] += 1
        if transaction.latency_ns is not None:
            self.latencies.add(transaction.latency_ns)

    @property
    def failed(self) -> int:
        """The number of requests that got an exception response, a malformed response, or none."""
        return sum(
            count for outcome, count in self.outcomes.items() if outcome not in ANSWERED_OUTCOMES
        )

    def sentence(self) -> str:
        """A summary for the user: `asked 12, answered 10, failed 2 (1 exception, 1 no-answer);
        latency ...`.
        """
        asked, failed = self.outcomes.total(), self.failed
        text = f"asked {asked:,}, answered {asked - failed:,}, failed {failed:,}"
        if failed:
            kinds = sorted(set(self.outcomes) - set(ANSWERED_OUTCOMES))
            text = f"{text} ({', '.join(f'{self.outcomes[one]:,} {one}' for one in kinds)})"
        if self.latencies.count:
            median, p95 = self.latencies.percentile(50), self.latencies.percentile(95)
            text = (
                f"{text}; latency {milliseconds(median)} median, {milliseconds(p95)} p95, "
                f"{milliseconds(self.latencies.greatest)} at most"
            )
        return text


class Changes:
    """Remembers the last result of each polled request, and finds what changed in the next
    result.
    """

    # Memory: the last transaction of each request, at most as many as a command line can name.

    def __init__(self, profile: Profile | None) -> None:
        self._profile = profile
        self._last: dict[bytes, NamedTransaction] = {}

    def since_last(self, pdu: bytes, now: NamedTransaction) -> NamedTransaction | None:
        """Return the transaction `now` if its result differs from that of the last request with
        this PDU, or if this is the first request with it; None if the result is the same.

        If both requests were answered with values, the returned transaction has only the points
        that changed, with texts for a table: `27.5 (was 27.3)`.
        """
        before = self._last.get(pdu)
        self._last[pdu] = now
        if before is None:
            return now
        if _result(before) == _result(now):
            return None
        if not before.outcome == now.outcome == Outcome.OK:
            return now
        return msgspec.structs.replace(now, points=self._changed_points(before, now))

    def _changed_points(self, before: NamedTransaction, now: NamedTransaction) -> list[PointValue]:
        olds, news = (points_of(one, self._profile) for one in (before, now))
        if len(olds) != len(news):  # `now` may answer another master's request.
            return news
        return [
            msgspec.structs.replace(new, value=None, text=f"{new.text} (was {old.text})")
            for old, new in zip(olds, news, strict=True)
            if old.text != new.text
        ]


def points_of(transaction: NamedTransaction, profile: Profile | None) -> list[PointValue]:
    """Return the points (named values) of a transaction. If the profile names none, make one for
    each register or bit, named by its reference such as HR400001.

    The field `reference` of such a point is empty, so that a table does not show the reference
    twice.
    """
    if transaction.points:
        return transaction.points
    table = FUNCTIONS[transaction.function].table
    assert table is not None
    points = []
    for index, value in enumerate(transaction.response_values or ()):
        reference = write_reference(profile, table, (transaction.address or 0) + index)
        points.append(PointValue(name=reference, reference="", text=str(value)))
    return points


def _result(transaction: NamedTransaction) -> tuple[object, ...]:
    return transaction.outcome, transaction.exception, transaction.response_values
