"""Plays the connections of a recorded slave: accepts, refuses and ends them as recorded."""

# The first live connection plays the first recorded connection, the second live one the second, and
# so on. The recorded slave ended or refused connections. Each of these acts is played the recorded
# time after its cause has occurred again:
#
#     act                       cause
#     it ended a connection     the latest of these: the last request of the connection (or its
#                               beginning); the opening of another connection, at most CAUSE_NS
#                               earlier (the slave made room for it); the end of another connection
#                               by the slave, at most TOGETHER_NS earlier
#     it refused connections    the latest beginning or end of a connection before the first
#                               refusal; it refuses until halfway between the last refusal and the
#                               next connection that it accepted
#
# A slave that did not answer a SYN cannot be played, because the system answers the SYN: such a
# connection is accepted, and its requests get no answer. Refusals before the first connection are
# left out, since they have no cause. When all recorded connections have been played, further ones
# are accepted; with `is_loop` the recorded ones begin again.
#
# Recorded times are divided by `rate`. At the rate None (as fast as possible) these times stay as
# they are: a slave that restarts does not become faster than it is.
#
# Memory: two numbers for each recorded connection, and the live connections.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.replay.connections import Beginning, RecordedConnection
from mbtool.slave.device.connection_policy import Admission, ConnectionPolicy, Loss, Peer

if TYPE_CHECKING:
    from fractions import Fraction

    from mbtool.modbus.response import ConnectionEnding

CAUSE_NS = 1_000_000_000
"""If a slave ended a connection at most this long (ns) after another one opened, that opening is
the cause: the slave made room for it."""
TOGETHER_NS = 100_000_000
"""If a slave ended a connection at most this long (ns) after another one, the end of the other one
is the cause: both have one reason, such as a reset."""
LEAST_IDLE_S = 600.0
_SPARE_IDLE = 2.0
"""A live connection is closed if it is idle for this many times the duration of the longest
recorded one, and for at least LEAST_IDLE_S."""


@dataclass(slots=True)
class _Planned:
    """What the recorded slave did to one connection, and because of it."""

    recorded: RecordedConnection
    ends_after: tuple[str, int] | None = None
    """The cause of the slave's ending: `asked` (this connection has had the given number of
    requests), `opened` or `ended` (the connection with the given number). None if the slave did not
    end it."""
    delay_ns: int = 0
    """The time (ns of the recording) from the cause to the ending."""
    closed_ns: dict[str, int] = field(default_factory=dict)
    """For how long (ns of the recording) connections are refused after this one has `opened` or
    `ended`."""


class ConnectionPlayer(ConnectionPolicy):
    """Takes, refuses and ends live connections as the slave of a recording did."""

    closes_all = False
    ends_some = True

    def __init__(
        self,
        recorded: Sequence[RecordedConnection],
        *,
        rate: Fraction | None = None,
        is_loop: bool = False,
    ) -> None:
        """Prepare to play connections of one slave, in the order of their beginnings."""
        super().__init__(idle_s=_idle_timeout_s(recorded))
        self._rate = rate
        self._is_loop = is_loop
        self._plan = _planned(recorded)
        self._taken = 0
        self._numbers: dict[Peer, int] = {}
        """By live connection, the number of the recorded one that it plays."""
        self._ended: set[int] = set()
        """The numbers of the connections that the slave is ending."""
        self._due_ns: dict[int, int] = {}
        """By number of a recorded connection, the time (ns) at which the slave ends it."""
        self._closed_until_ns: int | None = None

    @property
    def closed_until_ns(self) -> int | None:
        return self._closed_until_ns

    def admit(self, host: str, now_ns: int) -> Admission:
        admission = super().admit(host, now_ns)
        if admission.peer is None or not self._plan:
            return admission
        if self._taken >= len(self._plan) and self._is_loop:
            self._taken = 0
        if self._taken < len(self._plan):
            self._numbers[admission.peer] = self._taken
            self._cause("opened", self._taken, now_ns)
            self._taken += 1
        return admission

    def end_of(self, peer: Peer) -> tuple[int, ConnectionEnding] | None:
        number = self._numbers.get(peer)
        if number is None:
            return None
        planned = self._plan[number]
        ending = planned.recorded.ending
        what, count = planned.ends_after or ("", 0)
        if what == "asked" and peer.asked >= count and number not in self._due_ns:
            self._due_ns[number] = peer.heard_ns + self._scaled(planned.delay_ns)
        due_ns = self._due_ns.get(number)
        return None if due_ns is None or ending is None else (due_ns, ending)

    def ends(self, peer: Peer, now_ns: int) -> None:
        number = self._numbers.get(peer)
        if number is not None:
            self._ended.add(number)
            self._cause("ended", number, now_ns)

    def lost(self, peer: Peer, loss: Loss, now_ns: int) -> None:
        super().lost(peer, loss, now_ns)
        number = self._numbers.pop(peer, None)
        if number is not None:
            if number not in self._ended:  # The master has left before the slave's own end was due.
                self._cause("ended", number, now_ns)
            self._ended.discard(number)
            self._due_ns.pop(number, None)

    def _cause(self, what: str, number: int, now_ns: int) -> None:
        """Begin what the recorded slave did after a connection had `opened` or `ended`."""
        for other, planned in enumerate(self._plan):
            if planned.ends_after == (what, number):
                self._due_ns[other] = now_ns + self._scaled(planned.delay_ns)
                self.changed = True
        closed_ns = self._plan[number].closed_ns.get(what)
        if closed_ns is not None:
            self._closed_until_ns = now_ns + self._scaled(closed_ns)
            self.changed = True

    def _scaled(self, recorded_ns: int) -> int:
        return recorded_ns if self._rate is None else round(recorded_ns / self._rate)


def _planned(recorded: Sequence[RecordedConnection]) -> list[_Planned]:
    plan = [_Planned(one) for one in recorded if one.beginning is not Beginning.REFUSED]
    for number, planned in enumerate(plan):
        if planned.recorded.ended_by == "slave":
            _plan_end(plan, number)
    for first_ns, last_ns, next_ns in _refusals(recorded):
        causes = [
            (at_ns, what, planned)
            for planned in plan
            for what, at_ns in (
                ("opened", planned.recorded.begin_ns),
                ("ended", planned.recorded.end_ns),
            )
            if at_ns is not None and at_ns <= first_ns
        ]
        if causes:
            at_ns, what, cause = max(causes, key=lambda one: one[0])
            cause.closed_ns[what] = (last_ns + next_ns) // 2 - at_ns
    return plan


def _plan_end(plan: Sequence[_Planned], number: int) -> None:
    """Find the cause of the end of a connection that the recorded slave ended."""
    planned = plan[number]
    end_ns = planned.recorded.end_ns or 0
    causes = [(planned.recorded.last_ns, ("asked", planned.recorded.asked))]
    for other, each in enumerate(plan):
        one = each.recorded
        if other == number:
            continue
        if end_ns - CAUSE_NS <= one.begin_ns <= end_ns:
            causes.append((one.begin_ns, ("opened", other)))
        ended_ns = one.end_ns if one.ended_by == "slave" else None
        is_before = ended_ns is not None and (ended_ns, other) < (end_ns, number)
        if ended_ns is not None and is_before and end_ns - TOGETHER_NS <= ended_ns:
            causes.append((ended_ns, ("ended", other)))
    at_ns, planned.ends_after = max(causes, key=lambda one: one[0])
    planned.delay_ns = end_ns - at_ns


def _refusals(recorded: Sequence[RecordedConnection]) -> list[tuple[int, int, int]]:
    """Return the runs of refused connections: the times of the first and the last refusal, and of
    the next connection that was taken. If none was, it is as far behind the last as the refusals
    are apart.
    """
    runs: list[tuple[int, int, int]] = []
    begun: list[int] = []
    for one in recorded:
        if one.beginning is Beginning.REFUSED:
            begun.append(one.begin_ns)
        elif begun:
            runs.append((begun[0], begun[-1], one.begin_ns))
            begun = []
    if begun:
        runs.append((begun[0], begun[-1], 2 * begun[-1] - begun[0]))
    return runs


def _idle_timeout_s(recorded: Sequence[RecordedConnection]) -> float:
    longest_ns = max(((one.end_ns or one.last_ns) - one.begin_ns for one in recorded), default=0)
    return max(LEAST_IDLE_S, _SPARE_IDLE * longest_ns / 1e9)
