"""The rules of a device for TCP connections: their greatest number, the one that must leave for a
new one, and the times at which one is closed.
"""

# The TCP shell (shells/tcp_shell.py) owns the sockets and the clock, and asks the device's policy:
#
#     admit             a master has connected: may it stay, and must another one leave for it?
#     lost              a connection has ended, and why
#     end_of            when and how the device ends a connection by itself
#     ends              the device ends a connection now
#     closed_until_ns   no connection is accepted until this time; with `closes_all`, all those that
#                       are open are closed now
#
# The policy also gives the sockets' keep-alive and idle times. A request may change these times;
# `changed` is then True until the shell has read them again.
#
# Memory: one Peer for each accepted connection, at most `places` of them, and the last MAX_NOTES
# messages for the user.

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING

from mbtool.core.limits import SLAVE_CONNECTIONS, SLAVE_IDLE_S

if TYPE_CHECKING:
    from mbtool.modbus.response import ConnectionEnding

MAX_NOTES = 16
SPARE_NS = 1_000_000_000
"""Least age, in ns, of a connection that is closed in favour of a new one. This happens if `places`
masters are connected and one of them has sent nothing since it connected (TCP guide, V1.0b, 4.3.2:
the oldest unused connection is closed)."""


class Loss(Enum):
    """The reason why a connection ended."""

    CLOSED = auto()
    """The master or the slave closed or reset the connection."""
    NOT_ALIVE = auto()
    """The master did not answer the keep-alive probes."""
    SPLIT = auto()
    """The last part of a request did not arrive in time."""


@dataclass(slots=True, eq=False)
class Peer:
    """A master whose connection was accepted."""

    host: str
    heard_ns: int
    """The time in ns when the master last sent bytes, or connected. The shell updates it."""
    asked: int = 0
    """The number of complete requests that the master has sent. The shell updates it."""
    connected_ns: int = -1
    """The time in ns when the master connected; -1 if this connection is never closed in favour of
    another."""


@dataclass(frozen=True, slots=True)
class Admission:
    """The decision if a new connection is accepted, and which other one must be closed for it."""

    peer: Peer | None
    """The admitted master; None if the connection is refused."""
    leaves: Peer | None = None
    """The master whose connection must be closed to make room for the new one; None if none."""
    is_full: bool = False
    """True if the new connection is refused because too many masters are connected."""


@dataclass(frozen=True, slots=True)
class KeepAlive:
    """TCP keep-alive: how the slave finds out that a master is gone."""

    start_s: int
    """Seconds of silence before the first probe."""
    interval_s: int
    """Seconds from one probe to the next."""
    count: int
    """The connection is closed after this many unanswered probes."""


class ConnectionPolicy:
    """Decides which connections a simulated device accepts, for a device whose manual has no rules.

    At most `places` masters may be connected, and an idle connection is closed after `idle_s`.
    """

    closes_all = True
    """True if a device that accepts no connection for a while also closes all that are open."""
    ends_some = False
    """True if `end_of` may return a time, so that the shell asks."""

    def __init__(self, places: int = SLAVE_CONNECTIONS, idle_s: float = SLAVE_IDLE_S) -> None:
        self.places = places
        self.idle_s = idle_s
        """A connection is closed after this many seconds without a complete request."""
        self.changed = False
        """True if `keep_alive`, `split_s`, `closed_until_ns` or an `end_of` may have changed.

        The shell sets it to False when it has read them again.
        """
        self.peers: list[Peer] = []
        self.notes: deque[str] = deque(maxlen=MAX_NOTES)
        """Messages for the user, such as that a connection was closed, and why."""

    @property
    def keep_alive(self) -> KeepAlive | None:
        """The keep-alive settings, or None for no keep-alive."""
        return None

    @property
    def split_s(self) -> float:
        """The longest time that a request in several TCP segments may take to arrive, in
        seconds.
        """
        return math.inf

    @property
    def closed_until_ns(self) -> int | None:
        """No connection is accepted until this time in ns; None if one may be open now."""
        return None

    def end_of(self, peer: Peer) -> tuple[int, ConnectionEnding] | None:
        """Return the time (ns) at which the device ends a master's connection by itself, and how;
        None if it does not. The shell asks after each read of the connection, and when `changed` is
        True.
        """
        return None

    def ends(self, peer: Peer, now_ns: int) -> None:
        """Called when the time that `end_of` gave has come, before the connection is ended."""

    def admit(self, host: str, now_ns: int) -> Admission:
        """Decide whether a master that has connected from the IP address `host` may stay.

        If `places` masters are connected, the oldest one that has sent nothing leaves for it; if
        all have sent something, the new one is refused.
        """
        leaves = None
        if len(self.peers) >= self.places:
            leaves = next((one for one in self.peers if _is_unused(one, now_ns)), None)
            if leaves is None:
                return Admission(None, is_full=True)
            self.peers.remove(leaves)
        peer = Peer(host, now_ns, connected_ns=now_ns)
        self.peers.append(peer)
        return Admission(peer, leaves)

    def lost(self, peer: Peer, loss: Loss, now_ns: int) -> None:
        """Forget a master whose connection has ended, so that another may connect.

        `loss` is the reason; this policy does not need it, some devices' do. A second call for the
        same master does nothing.
        """
        if peer in self.peers:
            self.peers.remove(peer)


def _is_unused(peer: Peer, now_ns: int) -> bool:
    """True if a master connected at least SPARE_NS ago and has sent nothing."""
    return peer.heard_ns == peer.connected_ns <= now_ns - SPARE_NS
