"""Plays slaves at a TCP endpoint: Modbus/TCP, or RTU over TCP."""

# Each connection has a splitter and a queue of answers that wait for their time. Answers leave in
# the order of their requests; one that waits holds up those behind it, on its connection only.
#
# Not answered: a request whose protocol id is not 0, bytes that are no request, and whatever the
# responder keeps silent about. What one peer sends harms no other connection.
#
# Bounds, of which Bounds has the first three:
#
#     connections   more are closed as soon as they are made, and counted
#     idle          a connection without a whole request for so long is closed
#     waiting       with so many answers in its queue a connection is not read from; a read that
#                   came just before may add READ_BYTES / 8 more, with RTU frames READ_BYTES / 4
#                   (the shortest ADU has 8 bytes, or 4)
#     unread        while a peer does not take its answers it is not read from either
#
# A socket that others could reach is opened only with leave: what is checked is the address that
# the host's name stands for, not the name.

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Direction, Endpoint, LinkError, TcpLink, UsageError
from mbtool.modbus.adu import Adu
from mbtool.modbus.framing import mbap_adu, rtu_adu
from mbtool.modbus.mbap import MbapSplitter
from mbtool.modbus.rtu_stream import RtuStreamSplitter
from mbtool.slave.clock import steady_clock
from mbtool.slave.shell import OnExchange, Shell

if TYPE_CHECKING:
    from mbtool.modbus.answer import Responder

READ_BYTES = 2048
BACKLOG = 64


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
        on_exchange: OnExchange | None = None,
    ) -> None:
        super().__init__()
        self.link = link
        self.responder = responder
        self.bounds = bounds or Bounds()
        self.on_exchange = on_exchange
        self.connections: set[_Connection] = set()
        self.clock = steady_clock()
        self._allow_remote = allow_remote
        self._endpoint = link.endpoint
        self._stopping = asyncio.Event()

    @property
    def endpoint(self) -> Endpoint:
        """Where it listens; with the port that was given to it, if it asked for port 0."""
        return self._endpoint

    @property
    def place(self) -> str:
        return str(TcpLink(self._endpoint, rtu=self.link.rtu))

    @property
    def places(self) -> int:
        return self.bounds.connections

    def _open(self) -> None:
        self._socket = _listen(self.link, allow_remote=self._allow_remote)
        host, port = self._socket.getsockname()[:2]
        self._endpoint = Endpoint(host, port)
        self._loop = asyncio.new_event_loop()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    def _interrupt(self) -> None:
        self._loop.call_soon_threadsafe(self._stopping.set)

    async def _serve(self) -> None:
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: _Connection(self), sock=self._socket)
        await self._stopping.wait()
        server.close()
        while self.connections:
            for connection in list(self.connections):
                connection.abort()
            await asyncio.sleep(0)  # An aborted connection is lost in the loop's next round.
        await server.wait_closed()


class _Connection(asyncio.BufferedProtocol):
    """One master."""

    _transport: asyncio.Transport

    def __init__(self, slave: TcpSlave) -> None:
        self._slave = slave
        self._loop = asyncio.get_running_loop()
        self._buffer = memoryview(bytearray(READ_BYTES))
        rtu = slave.link.rtu
        self._splitter: MbapSplitter | RtuStreamSplitter
        self._splitter = (RtuStreamSplitter if rtu else MbapSplitter)(Direction.REQUEST)
        self._waiting: deque[tuple[float, bytes]] = deque()
        """Answers and when they are due, in the loop's time."""
        self._peer_is_slow = False
        self._last_request = self._loop.time()
        self._send_timer: asyncio.TimerHandle | None = None
        self._idle_timer: asyncio.TimerHandle | None = None

    def abort(self) -> None:
        self._transport.abort()

    # What asyncio calls.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if len(self._slave.connections) >= self._slave.bounds.connections:
            self._slave.turned_away += 1
            transport.abort()
            return
        self._slave.connections.add(self)
        self._watch_idle()

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        slave = self._slave
        now_ns, now = slave.clock(), self._loop.time()
        for event in self._splitter.feed(bytes(self._buffer[:nbytes]), now_ns):
            if not isinstance(event, Adu):
                continue
            self._last_request = now
            answer = slave.responder.respond(event.unit, event.pdu, now_ns)
            if answer is not None:
                due = now + answer.delay_ns / 1e9
                self._waiting.append((due, self._framed(event, answer.pdu)))
            if slave.on_exchange is not None:
                slave.on_exchange(event, answer)
        self._send_due()

    def pause_writing(self) -> None:
        self._peer_is_slow = True
        self._pause_or_resume_reading()

    def resume_writing(self) -> None:
        self._peer_is_slow = False
        self._pause_or_resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        self._slave.connections.discard(self)
        for timer in (self._send_timer, self._idle_timer):
            if timer is not None:
                timer.cancel()

    # Their parts.

    def _framed(self, request: Adu, pdu: bytes) -> bytes:
        if request.transaction_id is None:
            return rtu_adu(request.unit, pdu)
        return mbap_adu(request.transaction_id, request.unit, pdu)

    def _send_due(self) -> None:
        """Send the answers whose time has come, and come back for the next."""
        if self._send_timer is not None:
            self._send_timer.cancel()
            self._send_timer = None
        now = self._loop.time()
        due = []
        while self._waiting and self._waiting[0][0] <= now:
            due.append(self._waiting.popleft()[1])
        if due:
            self._transport.write(b"".join(due))
        if self._waiting:
            self._send_timer = self._loop.call_at(self._waiting[0][0], self._send_due)
        self._pause_or_resume_reading()

    def _pause_or_resume_reading(self) -> None:
        if self._peer_is_slow or len(self._waiting) >= self._slave.bounds.waiting:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()

    def _watch_idle(self) -> None:
        """Close a connection that has been idle too long, else look again when it could be."""
        ends = self._last_request + self._slave.bounds.idle_s
        if ends <= self._loop.time():
            self._transport.abort()
        else:
            self._idle_timer = self._loop.call_at(ends, self._watch_idle)


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
