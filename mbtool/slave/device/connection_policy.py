"""Which connections a device takes, how it watches them, and what it does when one is lost."""

# A TCP shell owns the sockets and the clock; it asks these rules who may stay:
#
#     admit      a master has connected: it is let in or not, and another may have to leave for it
#     lost       a connection has ended, and why
#     turn_out   whatever the device wants ended now, and until when it takes no connection
#
# and reads from them what its sockets and timers are to be set to. A request may change these:
# then `changed` is true until the shell has looked again.
#
# Rules hold one Peer for each connection that is let in, `places` at most, and the last MAX_NOTES
# sentences for the user that nobody has taken.

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum, auto

MAX_NOTES = 16


class Loss(Enum):
    """Why a connection ended."""

    CLOSED = auto()
    """The master closed it or broke it off, or the slave did."""
    NOT_ALIVE = auto()
    """The master did not answer the alive check."""
    SPLIT = auto()
    """The last part of a request did not come in time."""


@dataclass(slots=True, eq=False)
class Peer:
    """A master that is let in."""

    host: str
    heard_ns: int
    """When it last said something, or connected. The shell keeps this up to date."""


@dataclass(frozen=True, slots=True)
class Admission:
    """What becomes of a new connection."""

    peer: Peer | None
    """None where it is turned away."""
    leaves: Peer | None = None
    """Whose connection is to be closed for it."""
    is_full: bool = False
    """It is turned away because all places are taken. For another reason the rules' notes tell."""


@dataclass(frozen=True, slots=True)
class KeepAlive:
    """How TCP finds out that a master is gone."""

    start_s: int
    """How long nothing is said before the first probe."""
    interval_s: int
    """From one probe to the next."""
    count: int
    """How many go without an answer before the connection is given up."""


class ConnectionPolicy:
    """The rules of a device whose manual states none: so many, and no longer idle than this."""

    def __init__(self, places: int = 32, idle_s: float = 600.0) -> None:
        self.places = places
        self.idle_s = idle_s
        """A connection without a whole request for so long is closed."""
        self.changed = False
        """Whether `keep_alive`, `split_s` or `closed_until_ns` may say something else now."""
        self.peers: list[Peer] = []
        self.notes: deque[str] = deque(maxlen=MAX_NOTES)
        """What the rules have done, in sentences for the user."""

    @property
    def keep_alive(self) -> KeepAlive | None:
        """None leaves it off."""
        return None

    @property
    def split_s(self) -> float:
        """A request whose last part comes later than this after its first one is given up."""
        return math.inf

    @property
    def closed_until_ns(self) -> int | None:
        """All connections are closed, and none is taken before this time."""
        return None

    def admit(self, host: str, now_ns: int) -> Admission:
        """Learn that a master has connected."""
        if len(self.peers) >= self.places:
            return Admission(None, is_full=True)
        peer = Peer(host, now_ns)
        self.peers.append(peer)
        return Admission(peer)

    def lost(self, peer: Peer, loss: Loss, now_ns: int) -> None:
        """Learn that a connection has ended; the second time this says nothing."""
        if peer in self.peers:
            self.peers.remove(peer)
