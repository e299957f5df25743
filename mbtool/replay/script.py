"""Prepares a recording to be played as the master: its requests, their times and responses."""

# A step is one recorded request. It is sent at its recorded time, but it waits for the responses
# that the recorded master had already received when it sent this request. It does not wait for
# requests that were still without a response then. So the player has as many requests pending at
# once as the recorded master had. No step waits for a request that was never answered.
#
# If the recording has the TCP connections of the requests, each is opened and ended as recorded. A
# ConnectionStep is one of three acts: the master tries to connect, the master ends a connection, or
# the slave ends it (the player waits for this). If the master connected again after a refusal, or
# after an end by the slave, the recorded time between the two is kept also at the speed `max`: a
# slave that restarts does not become faster.
#
# Unsolicited responses have no request and are left out; a retry is a request like any other.
#
# Memory grows with the recording: one step for each request and two for each connection, and in
# its `open_before` one number for each request that was pending at the same time.

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from sys import intern
from typing import TYPE_CHECKING, Self

from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.modbus import Outcome, whole_pdu
from mbtool.replay.connections import Beginning, RecordedConnection

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction


@dataclass(frozen=True, slots=True)
class Step:
    """One recorded request, to be sent again by the player."""

    number: int
    """The index of this step in the script, from 0."""
    position_ns: int
    """The time at which the last byte of the request was sent, in ns since the last byte of the
    recording's first request."""
    unit: int
    pdu: bytes
    expected: bytes | None
    """The PDU of the recorded response; None if the slave sent no response, or if the capture lost
    it."""
    latency_ns: int | None
    """The latency of the recorded response in ns; None if there was none."""
    is_broadcast: bool
    reference: str
    """The addresses in the request, in the notation of the device; empty if it has none."""
    function_name: str
    device: str | None
    """The name of the slave's device profile; None if it has none."""
    is_captured: bool = True
    """False if the capture lost the response, so that nobody knows whether there was one."""
    open_before: tuple[int, ...] = ()
    """The numbers of the earlier steps whose responses came only after this request was recorded,
    so that the recorded master did not wait for them. The player does not wait for these either,
    but for all other earlier steps that have a recorded response."""
    connection: int | None = None
    """The number of the connection that carried the request; None if the recording does not tell,
    as on a serial line."""


class Action(Enum):
    """What happens to a TCP connection."""

    OPEN = auto()
    """The master tries to connect."""
    CLOSE = auto()
    """The master ends the connection."""
    AWAIT_END = auto()
    """The slave ends the connection."""


@dataclass(frozen=True, slots=True)
class ConnectionStep:
    """A recorded beginning or end of a TCP connection."""

    number: int
    """The index of the connection among those of the recording, from 0."""
    action: Action
    recorded: RecordedConnection
    position_ns: int
    """The time in ns since the beginning of the script."""
    rest_ns: int = 0
    """The recorded time in ns since its cause: for OPEN, since the last refusal or end by the slave
    (0 if there was none); for AWAIT_END, since the last request or the beginning."""
    open_before: tuple[int, ...] = ()
    """The numbers of the earlier steps whose responses came only after this; as in Step."""


@dataclass(frozen=True, slots=True)
class Script:
    """The requests of a recording, as steps, in the order in which they were sent."""

    steps: tuple[Step, ...]
    items: tuple[Step | ConnectionStep, ...] = ()
    """The steps, with what happened to connections between them, in the order of time."""

    @classmethod
    def of(
        cls,
        transactions: Iterable[NamedTransaction],
        connections: Sequence[RecordedConnection] = (),
    ) -> Self:
        """Build a script; the transactions may come in any order, `connections` by their
        beginning.
        """
        asked = [
            (one.request_ns, pdu, one)
            for one in transactions
            if one.request_raw is not None and one.request_ns is not None
            if (pdu := whole_pdu(one.transport, one.request_raw)) is not None
        ]
        asked.sort(key=lambda each: each[0])
        begins_ns = [request_ns for request_ns, _, _ in asked[:1]]
        begins_ns += [one.begin_ns for one in connections[:1] if asked]
        origin_ns = min(begins_ns, default=0)
        upcoming = deque(sorted(_connection_steps(connections, origin_ns), key=_order))
        pending = _Pending()
        steps: list[Step] = []
        items: list[Step | ConnectionStep] = []
        pdus: dict[bytes, bytes] = {}
        """Each PDU as key and as value, so that equal PDUs share one bytes object and memory is
        saved."""
        number_of: dict[str, int] = {}
        """By HOST:PORT of a master, the number of the connection that it opened last."""
        for number, (request_ns, pdu, one) in enumerate(asked):
            while upcoming and _order(upcoming[0]) <= (request_ns - origin_ns, _REQUEST):
                item = upcoming.popleft()
                items.append(replace(item, open_before=pending.at(origin_ns + item.position_ns)))
                if item.action is Action.OPEN and item.recorded.is_open:
                    number_of[item.recorded.master] = item.number
            steps.append(
                Step(
                    number=number,
                    position_ns=request_ns - origin_ns,
                    unit=one.unit,
                    pdu=pdus.setdefault(pdu, pdu),
                    expected=whole_pdu(one.transport, one.response_raw),
                    latency_ns=one.latency_ns,
                    is_broadcast=one.outcome is Outcome.BROADCAST,
                    reference=intern(one.reference or ""),
                    function_name=one.function_name,
                    device=one.device,
                    is_captured=one.outcome is not Outcome.NOT_CAPTURED,
                    open_before=pending.at(request_ns),
                    connection=number_of.get(one.source or ""),
                )
            )
            items.append(steps[-1])
            if one.response_ns is not None:
                pending.until_ns[number] = one.response_ns
        for item in upcoming:
            items.append(replace(item, open_before=pending.at(origin_ns + item.position_ns)))
        return cls(tuple(steps), tuple(items))

    @property
    def length_ns(self) -> int:
        """The time (ns) from the beginning of the script to its last item."""
        items = self.items or self.steps
        return items[-1].position_ns if items else 0

    @property
    def units(self) -> frozenset[int]:
        """The units that the requests are for, except broadcasts."""
        return frozenset(step.unit for step in self.steps if not step.is_broadcast)


@dataclass(slots=True)
class _Pending:
    """The requests that were pending at a time of the recording."""

    until_ns: dict[int, int] = field(default_factory=dict)
    """By number of a request's step, the time (UTC ns) at which its response came."""

    def at(self, now_ns: int) -> tuple[int, ...]:
        """Return the numbers of the requests that still wait at `now_ns`, which never decreases."""
        for number in [number for number, end in self.until_ns.items() if end <= now_ns]:
            del self.until_ns[number]
        while len(self.until_ns) > MAX_OPEN_REQUESTS:
            del self.until_ns[next(iter(self.until_ns))]
        return tuple(self.until_ns)


_OPENS, _REQUEST, _ENDS = range(3)
"""The order of what happens at one time."""


def _order(item: ConnectionStep) -> tuple[int, int]:
    """The sort key of a connection step: its time, then its place among what happens then."""
    return item.position_ns, _OPENS if item.action is Action.OPEN else _ENDS


def _connection_steps(
    connections: Sequence[RecordedConnection], origin_ns: int
) -> Iterator[ConnectionStep]:
    """Yield the steps of all connections, not in the order of time."""
    troubles = sorted(
        at_ns
        for one in connections
        for at_ns in (
            one.begin_ns if one.beginning is Beginning.REFUSED else None,
            one.end_ns if one.ended_by == "slave" else None,
        )
        if at_ns is not None
    )
    for number, one in enumerate(connections):
        at_ns = max(one.begin_ns, origin_ns)
        before = bisect_left(troubles, at_ns)
        rest_ns = at_ns - troubles[before - 1] if before else 0
        yield ConnectionStep(number, Action.OPEN, one, at_ns - origin_ns, rest_ns)
        if one.end_ns is not None and one.ended_by:
            is_master = one.ended_by == "master"
            yield ConnectionStep(
                number,
                Action.CLOSE if is_master else Action.AWAIT_END,
                one,
                one.end_ns - origin_ns,
                0 if is_master else one.end_ns - one.last_ns,
            )
