"""Plays slaves at a TCP endpoint: Modbus/TCP, or RTU over TCP."""

# Each master has a Connection (tcp_connection.py). Who may stay, and how long, is for the rules of
# the device played here (connection_rules.py); without a device's own they are those of Bounds.
#
# Not answered: a request whose protocol id is not 0, bytes that are no request, and whatever the
# responder keeps silent about. What one peer sends harms no other connection.
#
# Bounds, of which Bounds has the first three, or the device's rules the first two:
#
#     connections   more are closed as soon as they are made, and counted
#     idle          a connection without a whole request for so long is closed
#     waiting       with so many answers in its queue a connection is not read from
#     unread        while a peer does not take its answers it is not read from either
#
# While a device takes no connections its port stays bound, but nobody listens: who calls is
# refused, as by a device that is starting.
#
# A socket that others could reach is opened only with leave: what is checked is the address that
# the host's name stands for, not the name.

from __future__ import annotations

import asyncio
import errno
import ipaddress
import os
import socket
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbtool.core import Endpoint, LinkError, TcpLink, UsageError
from mbtool.ports.steady_clock import steady_clock
from mbtool.slave.device.connection_policy import ConnectionPolicy
from mbtool.slave.shells.shell import OnExchange, Shell
from mbtool.slave.shells.tcp_connection import MasterConnection

if TYPE_CHECKING:
    from mbtool.modbus.response import Responder
    from mbtool.slave.device.connection_policy import Peer

BACKLOG = 64
SHORT_S = 10.0
"""How often it is said, at most, that no more connections can be taken."""
_SHORT = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """How much one endpoint takes on."""

    connections: int = 32
    idle_s: float = 600.0
    waiting: int = 16
    """As many transactions as the TCP guide lets a server accept at once (V1.0b, 4.3.2)."""


class TcpSlave(Shell):
    """Answers the connections of one endpoint."""

    def __init__(
        self,
        link: TcpLink,
        responder: Responder,
        *,
        allow_remote: bool = False,
        bounds: Bounds | None = None,
        rules: ConnectionPolicy | None = None,
        on_exchange: OnExchange | None = None,
    ) -> None:
        """`rules` are those of the device played here, where it has its own."""
        super().__init__()
        self.link = link
        self.responder = responder
        self.bounds = bounds or Bounds()
        self.rules = rules or ConnectionPolicy(self.bounds.connections, self.bounds.idle_s)
        self.on_exchange = on_exchange
        self.connections: set[MasterConnection] = set()
        self.clock = steady_clock()
        self._allow_remote = allow_remote
        self._endpoint = link.endpoint
        self._woken = asyncio.Event()
        """It is to stop, or the rules want no connections for a while."""
        self._is_stopping = False
        self._short_s = -SHORT_S

    @property
    def endpoint(self) -> Endpoint:
        """Where it listens; with the port that was given to it, if it asked for port 0."""
        return self._endpoint

    @property
    def place(self) -> str:
        return str(TcpLink(self._endpoint, rtu=self.link.rtu))

    @property
    def places(self) -> int:
        return self.rules.places

    def notes(self) -> list[str]:
        return [self.rules.notes.popleft() for _ in range(len(self.rules.notes))]

    # What its connections ask.

    @property
    def is_rtu(self) -> bool:
        return self.link.rtu

    @property
    def waiting(self) -> int:
        return self.bounds.waiting

    def arrived(self, connection: MasterConnection, host: str) -> Peer | None:
        if self._is_stopping:
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
        if self._closed_s() > 0:
            self._woken.set()

    # How it runs.

    def _open(self) -> None:
        self._socket = _listen(self.link, allow_remote=self._allow_remote)
        host, port = self._socket.getsockname()[:2]
        self._endpoint = Endpoint(host, port)
        self._loop = asyncio.new_event_loop()

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._serve())
        finally:  # Also where it was stopped before it began to serve.
            self._socket.close()

    def _interrupt(self) -> None:
        self._loop.call_soon_threadsafe(self._stop)

    def _stop(self) -> None:
        self._is_stopping = True
        self._woken.set()

    async def _serve(self) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(self._note_trouble)
        while not self._is_stopping:
            try:
                server = await loop.create_server(
                    lambda: MasterConnection(self), sock=self._socket, backlog=BACKLOG
                )
            except OSError as error:  # Another may listen where nobody did for a while.
                raise LinkError(f"{self.place}: {_why_not_listening(error)}") from error
            await self._woken.wait()
            address = self._socket.getsockname()
            await self._finish_accepting()
            server.close()
            await self._close_connections()
            await server.wait_closed()
            if not self._is_stopping:
                self._socket = _bind(self._socket.family, address)
                await self._stay_closed()

    async def _finish_accepting(self) -> None:
        """Let those arrive whom the loop has accepted: asyncio forgets them in a closed server.

        It has a task for each. Nobody else is accepted meanwhile where the loop can be told so.
        """
        with suppress(NotImplementedError):
            asyncio.get_running_loop().remove_reader(self._socket)
        while arriving := asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.wait(arriving)

    def _note_trouble(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Say once what asyncio says at each try: that no connection can be taken."""
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in _SHORT:
            loop.default_exception_handler(context)
        elif loop.time() - self._short_s >= SHORT_S:
            self._short_s = loop.time()
            self.rules.notes.append(
                f"no more connections for now: {error.strerror}; ulimit -n allows more"
            )

    async def _close_connections(self) -> None:
        while self.connections:
            for connection in list(self.connections):
                connection.abort()
            await asyncio.sleep(0)  # An aborted connection is lost in the loop's next round.

    async def _stay_closed(self) -> None:
        self._woken.clear()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._woken.wait(), self._closed_s())

    def _closed_s(self) -> float:
        """How long the rules want no connections."""
        until_ns = self.rules.closed_until_ns
        return 0.0 if until_ns is None else max(until_ns - self.clock(), 0) / 1e9


def _listen(link: TcpLink, *, allow_remote: bool) -> socket.socket:
    host, port = link.endpoint.host, link.endpoint.port
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (socket.gaierror, UnicodeError) as error:
        raise LinkError(
            f"{link}: no host is named {host!r}; write an address of this one"
        ) from error
    family, _, _, _, address = found[0]
    if not allow_remote and not ipaddress.ip_address(address[0]).is_loopback:
        raise UsageError(
            f"{link}: others can reach {address[0]}; name 127.0.0.1, or add --allow-remote"
        )
    try:
        return socket.create_server((str(address[0]), port), family=family, backlog=BACKLOG)
    except OSError as error:
        raise LinkError(f"{link}: {_why_not_listening(error)}") from error


def _bind(family: int, address: tuple[str | int, ...]) -> socket.socket:
    """A socket that holds an address again, without listening. Raises LinkError."""
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        sock.bind(address)
    except OSError as error:
        sock.close()
        raise LinkError(f"{address[0]}:{address[1]}: {_why_not_listening(error)}") from error
    return sock


def _why_not_listening(error: OSError) -> str:
    match error.errno:
        case errno.EADDRINUSE:
            return "the port is in use; end what listens there, or choose another port"
        case errno.EACCES:
            return "a port below 1024 needs a privilege; choose a higher one, for example 1502"
        case errno.EADDRNOTAVAIL:
            return "no interface here has this address"
        case _:
            return f"cannot listen: {error.strerror or error}"
