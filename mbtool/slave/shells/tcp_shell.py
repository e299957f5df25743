"""Simulates slaves at a TCP endpoint: Modbus/TCP, or RTU over TCP."""

# Each master has a MasterConnection (tcp_connection.py). The listener (ports/tcp_listener.py)
# decides which machines may connect. The rules of the simulated device (connection_policy.py), or
# Bounds if the device has none, decide how many masters stay connected, and how long.
#
# No response is sent to a request whose protocol id is not 0, to bytes that are no request, and to
# a request for which the responder returns None. Bytes from one master never affect the connections
# of others.
#
# Bounds sets the first three of these limits; a device's own rules replace the first two, and the
# user's limits (ports/connection_limits.py) replace both:
#
#     connections   a connection beyond this number is closed at once, and counted, unless another
#                   one has been open for a second without a request: then that one is closed
#     idle          a connection without a complete request for so long is closed
#     waiting       a connection with so many pending responses is not read
#     unread        a connection whose master does not read its responses is not read
#
# An FA3 module takes no connections for a while after a remote reset. Its port then stays bound but
# does not listen, so the system refuses masters, as a real device does while it starts.

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Endpoint, TcpLink
from mbtool.ports.allowed_peers import THIS_MACHINE, AllowedPeers
from mbtool.ports.clock import steady_clock
from mbtool.ports.tcp_listener import TcpListener
from mbtool.slave.device.connection_policy import ConnectionPolicy
from mbtool.slave.shells.shell import OnExchange, Shell
from mbtool.slave.shells.tcp_connection import MasterConnection

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.modbus.response import Responder
    from mbtool.slave.device.connection_policy import Peer

MAX_REFUSED_HOSTS = 64
"""At most this many refused machines are reported to the user; further ones are refused
silently."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """The limits of one TCP endpoint: its number of connections, the seconds that a connection may
    be without a request, and its number of pending responses.
    """

    connections: int = 32
    idle_s: float = 600.0
    waiting: int = 16
    """The most pending responses of a connection; 16 is the number in the TCP guide (V1.0b,
    4.3.2)."""


class TcpSlave(Shell):
    """Accepts masters at one TCP endpoint, and answers their requests with a responder."""

    def __init__(
        self,
        link: TcpLink,
        responder: Responder,
        *,
        allowed: AllowedPeers = THIS_MACHINE,
        bounds: Bounds | None = None,
        rules: ConnectionPolicy | None = None,
        on_exchange: OnExchange | None = None,
    ) -> None:
        """Prepare to answer at the endpoint of `link` with the responses of `responder`.

        `rules` decide which connections the simulated device accepts, and when it closes them. None
        means a device without rules of its own: `bounds` then sets how many connections there may
        be, and how long one may be idle.
        """
        super().__init__()
        self.link = link
        self.responder = responder
        self.bounds = bounds or Bounds()
        self.rules = rules or ConnectionPolicy(self.bounds.connections, self.bounds.idle_s)
        if allowed.limits.connections is not None:
            self.rules.places = allowed.limits.connections
        if allowed.limits.idle_s is not None:
            self.rules.idle_s = allowed.limits.idle_s
        self.on_exchange = on_exchange
        self.connections: set[MasterConnection] = set()
        self.clock = steady_clock()
        self._listener = TcpListener(link, link.endpoint, allowed)
        self._refused_hosts: set[str] = set()
        self._woken = asyncio.Event()
        """Set when the slave must stop, or when the rules accept no connection for a while."""
        self._is_stopping = False
        self._is_closed = False
        """True while the port does not listen."""
        self._once_closed: list[Callable[[], None]] = []
        """Functions to call as soon as the port does not listen."""

    @property
    def endpoint(self) -> Endpoint:
        """The endpoint that the slave listens at.

        If the port is 0, it is replaced by the port that the system chose when the slave opened.
        """
        return self._listener.endpoint

    @property
    def place(self) -> str:
        return str(TcpLink(self.endpoint, rtu=self.link.rtu))

    @property
    def places(self) -> int:
        return self.rules.places

    def notes(self) -> list[str]:
        return [self.rules.notes.popleft() for _ in range(len(self.rules.notes))]

    # The connections (MasterConnection) use the following members.

    @property
    def is_rtu(self) -> bool:
        return self.link.rtu

    @property
    def waiting(self) -> int:
        return self.bounds.waiting

    def arrived(self, connection: MasterConnection, host: str) -> Peer | None:
        refusal = self._listener.refusal(host)
        if refusal is not None:
            self._tell_refused(host, refusal)
        if refusal is not None or self._is_stopping:
            return None
        admission = self.rules.admit(host, self.clock())
        if admission.leaves is not None:
            for other in self.connections:
                if other.peer is admission.leaves:
                    other.abort()
        if admission.peer is None:
            self.turned_away += admission.is_full
        else:
            self.connections.add(connection)
        return admission.peer

    def left(self, connection: MasterConnection) -> None:
        self.connections.discard(connection)

    def follow_rules(self) -> None:
        self.rules.changed = False
        for connection in self.connections:
            connection.keep_alive(self.rules.keep_alive)
            connection.plan_end()
        if self._closed_s() > 0:
            self._woken.set()

    def once_closed(self, ends: Callable[[], None]) -> None:
        if self.rules.changed:
            self.follow_rules()
        if self._closed_s() > 0 and not self._is_closed:
            self._once_closed.append(ends)
        else:
            ends()

    def _tell_refused(self, host: str, refusal: str) -> None:
        """Report a refused machine to the user once, as it usually tries again and again.

        `host` is the machine's IP address, `refusal` the message for the user.
        """
        if host not in self._refused_hosts and len(self._refused_hosts) < MAX_REFUSED_HOSTS:
            self._refused_hosts.add(host)
            self.rules.notes.append(f"a master was turned away: {refusal}")

    # The following methods open the endpoint, accept connections and close it.

    def _open(self) -> None:
        self._listener.open()
        self._loop = asyncio.new_event_loop()

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._serve())
        finally:  # Also if it was stopped before it began to serve.
            self._listener.close()

    def _interrupt(self) -> None:
        self._loop.call_soon_threadsafe(self._stop)

    def _stop(self) -> None:
        self._is_stopping = True
        self._woken.set()

    async def _serve(self) -> None:
        while not self._is_stopping:
            server = await self._listener.serve(
                lambda: MasterConnection(self), self.rules.notes.append
            )
            await self._woken.wait()
            self._woken.clear()
            await self._finish_accepting()
            server.close()
            self._is_closed = True
            for ends in self._once_closed:
                ends()
            self._once_closed.clear()
            if self.rules.closes_all:
                await self._close_connections()
                await server.wait_closed()
            if not self._is_stopping:
                self._listener.hold()
                await self._stay_closed()
            self._is_closed = False
        await self._close_connections()

    async def _finish_accepting(self) -> None:
        """Wait until asyncio has made a MasterConnection for each connection that it accepted.

        asyncio runs a task for each of them; closing the server earlier would drop them. While this
        waits, no other connection is accepted, except on Windows, whose event loop cannot stop
        accepting.
        """
        with suppress(NotImplementedError):
            asyncio.get_running_loop().remove_reader(self._listener.sock)
        while arriving := asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.wait(arriving)

    async def _close_connections(self) -> None:
        while self.connections:
            for connection in list(self.connections):
                connection.abort()
            await asyncio.sleep(0)  # asyncio ends an aborted connection in its next round.

    async def _stay_closed(self) -> None:
        while self._closed_s() > 0 and not self._is_stopping:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._woken.wait(), self._closed_s())
            self._woken.clear()
        self._woken.clear()

    def _closed_s(self) -> float:
        """Return the number of seconds, from now, for which the rules let no master connect."""
        until_ns = self.rules.closed_until_ns
        return 0.0 if until_ns is None else max(until_ns - self.clock(), 0) / 1e9
