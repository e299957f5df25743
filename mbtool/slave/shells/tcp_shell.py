"""Simulates slaves at a TCP endpoint: Modbus/TCP, or RTU over TCP."""

# Each master has a MasterConnection. The listener (ports/tcp_listener.py)
# decides which machines may connect. The rules of the simulated device (connection_policy.py), or
# Bounds if the device has none, decide how many masters stay connected, and how long.
#
# No response is sent to a request whose protocol id is not 0, to bytes that are no request, and to
# a request for which the responder returns None. Bytes from one master never affect the connections
# of others.
#
# Bounds sets the first three of these limits; a device's own rules replace the first two, and the
# user's limits (ports/tcp_listener.py) replace both:
#
#     connections   a connection beyond this number is closed at once, and counted, unless another
#                   one has been open for a second without a request: then that one is closed
#     idle          a connection without a complete request for this time is closed
#     waiting       a connection with this many pending responses is not read
#     unread        a connection whose master does not read its responses is not read
#
# For a while after a remote reset, an FA3 module accepts no connections. Its port then stays bound
# but does not listen, so the system refuses masters, as a real device does while it starts.

from __future__ import annotations

import asyncio
import errno
import math
import socket
import struct
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from mbtool.core import Direction, Endpoint, TcpLink
from mbtool.core.limits import SLAVE_CONNECTIONS, SLAVE_IDLE_S
from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter
from mbtool.modbus.adu import MAX_TCP_ADU, MBAP_BYTES, Adu, Transport, mbap_adu
from mbtool.modbus.response import ConnectionEnding, Responder, Response, wire_pieces
from mbtool.ports.clock import steady_clock
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers, TcpListener, reset
from mbtool.slave.device.connection_policy import ConnectionPolicy, KeepAlive, Loss, Peer
from mbtool.slave.shells.shell import OnExchange, Shell

# MasterConnection is one master's connection to a TCP slave.
#
# Most reads of the socket bring exactly one request, which is answered straight from the buffer.
# All else goes through the splitter, which finds requests in a stream of bytes: requests in pieces,
# bytes that are no request, RTU frames, and all requests if `on_exchange` is set, which needs them
# as ADUs.
#
# Responses are sent in the order of their requests; a delayed response delays the ones behind it. A
# response with a simulated fault is sent as modbus/response.py says, and may end the connection.
#
# The rules of the device (connection_policy.py) set two timers. A connection without a complete
# request for idle_s is closed. If the last part of a request does not come within split_s of its
# first part, the request is dropped and the connection closed.
#
# Memory: one incomplete request, and the responses to Bounds.waiting requests. While that many
# responses are pending, or the master does not read them, the socket is not read. The last read
# before may still add responses: READ_BYTES / 8 on Modbus/TCP, whose shortest ADU has 8 bytes, and
# READ_BYTES / 4 with RTU frames, whose shortest has 4.

READ_BYTES = 2048

_HEADER = struct.Struct(">HHHB")
"""The MBAP header of Modbus/TCP: transaction id, protocol id, length, unit."""
_MODBUS = 0

_GONE = frozenset({errno.ETIMEDOUT, errno.EHOSTUNREACH, errno.ENETUNREACH})
"""Errors of a connection whose master has stopped answering keep-alive probes or acknowledging.

EHOSTUNREACH and ENETUNREACH come if a router reports that it cannot reach the master.
"""

# The socket options for TCP keep-alive. An option that the system lacks is not set. On macOS,
# TCP_KEEPIDLE is called TCP_KEEPALIVE.
_KEEP_START = getattr(socket, "TCP_KEEPIDLE", getattr(socket, "TCP_KEEPALIVE", None))
_KEEP_INTERVAL = getattr(socket, "TCP_KEEPINTVL", None)
_KEEP_COUNT = getattr(socket, "TCP_KEEPCNT", None)


class Host(Protocol):
    """The slave that a connection belongs to: the methods that the connection calls."""

    responder: Responder
    rules: ConnectionPolicy
    on_exchange: OnExchange | None
    clock: Callable[[], int]

    @property
    def is_rtu(self) -> bool: ...

    @property
    def waiting(self) -> int: ...

    def arrived(self, connection: MasterConnection, host: str) -> Peer | None:
        """Called with a new connection from the IP address `host`; the rules admit or refuse it.

        Returns the master's Peer in the rules, or None if the connection must be closed.
        """

    def note_left(self, connection: MasterConnection) -> None:
        """Called when a connection has ended."""

    def apply_changed_rules(self) -> None:
        """Called after the rules changed: apply the times that they give, and take no connection
        for as long as they say.
        """

    def after_rules_applied(self, ends: Callable[[], None]) -> None:
        """Apply the rules, and call `ends` once they are in force."""


class MasterConnection(asyncio.BufferedProtocol):
    """One master's TCP connection; asyncio calls its methods when something happens on the
    socket.
    """

    peer: Peer
    _transport: asyncio.Transport

    def __init__(self, shell: Host) -> None:
        self._shell = shell
        self._responder = shell.responder
        self._clock = shell.clock
        self._rules = shell.rules
        self._loop = asyncio.get_running_loop()
        self._bytes = bytearray(READ_BYTES)
        self._buffer = memoryview(self._bytes)
        self._splitter: MbapSplitter | RtuStreamSplitter
        self._splitter = (RtuStreamSplitter if shell.is_rtu else MbapSplitter)(Direction.REQUEST)
        self._reads_in_place = not shell.is_rtu and shell.on_exchange is None
        self._is_in_pieces = False
        """True if the splitter has part of a request, or is looking for the next one after bad
        bytes."""
        self._pending: deque[tuple[int, bytes | ConnectionEnding]] = deque()
        """The next actions, in order, each with its time in ns: send these bytes, or end the
        connection in the given way."""
        self._has_ended = False
        """True once the master has sent FIN: it sends no more requests."""
        self._peer_is_slow = False
        self._is_paused = False
        self._last_request_ns = self._clock()
        self._loss = Loss.CLOSED
        self._send_timer: asyncio.TimerHandle | None = None
        self._idle_timer: asyncio.TimerHandle | None = None
        self._split_timer: asyncio.TimerHandle | None = None
        self._end_timer: asyncio.TimerHandle | None = None

    def abort(self) -> None:
        self._transport.abort()

    def plan_end(self) -> None:
        """Set a timer for the time at which the device ends this connection by itself, if it
        does.
        """
        planned = self._rules.end_of(self.peer)
        if planned is not None and self._end_timer is None:
            due_ns, ending = planned
            rest_s = max(due_ns - self._clock(), 0) / 1e9
            self._end_timer = self._loop.call_later(rest_s, self._end_as_planned, ending)

    def keep_alive(self, setting: KeepAlive | None) -> None:
        """Switch TCP keep-alive on with the times of `setting`; off if it is None."""
        sock = self._transport.get_extra_info("socket")
        with suppress(OSError):  # The connection may be broken; asyncio reports it.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, setting is not None)
            if setting is None:
                return
            for option, value in (
                (_KEEP_START, setting.start_s),
                (_KEEP_INTERVAL, setting.interval_s),
                (_KEEP_COUNT, setting.count),
            ):
                if option is not None:
                    sock.setsockopt(socket.IPPROTO_TCP, option, value)

    # asyncio calls the following methods.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        host = (transport.get_extra_info("peername") or ("",))[0]
        peer = self._shell.arrived(self, host)
        if peer is None:
            transport.abort()
            return
        self.peer = peer
        self.keep_alive(self._rules.keep_alive)
        self._watch_idle()
        self.plan_end()
        if self._rules.changed:
            self._shell.apply_changed_rules()

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        now_ns = self._clock()
        self.peer.heard_ns = now_ns
        if not self._answer_in_place(nbytes, now_ns):
            self._split(bytes(self._buffer[:nbytes]), now_ns)
        if self._rules.ends_some:
            self.plan_end()
        if self._rules.changed:
            self._shell.apply_changed_rules()
        if self._pending:
            self._send_due()

    def eof_received(self) -> bool:
        """Note that the master sends no more.

        Returns True to keep the connection open for pending responses.
        """
        self._has_ended = True
        return bool(self._pending)

    def pause_writing(self) -> None:
        self._peer_is_slow = True
        self._pause_or_resume_reading()

    def resume_writing(self) -> None:
        self._peer_is_slow = False
        self._pause_or_resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        for timer in (self._send_timer, self._idle_timer, self._split_timer, self._end_timer):
            if timer is not None:
                timer.cancel()
        if hasattr(self, "peer"):
            is_gone = isinstance(exc, OSError) and exc.errno in _GONE
            loss = Loss.NOT_ALIVE if is_gone else self._loss
            self._rules.lost(self.peer, loss, self._clock())
            self._shell.note_left(self)
            if self._rules.changed:
                self._shell.apply_changed_rules()

    # The following methods are called by the methods above.

    def _answer_in_place(self, nbytes: int, now_ns: int) -> bool:
        """Answer the request in the first `nbytes` bytes of the buffer, if they are exactly one.

        Otherwise, or if all requests must go through the splitter, does nothing and returns False.
        """
        if self._is_in_pieces or not self._reads_in_place or not MBAP_BYTES < nbytes <= MAX_TCP_ADU:
            return False
        transaction_id, protocol, length, unit = _HEADER.unpack_from(self._bytes)
        if protocol != _MODBUS or length != nbytes - MBAP_BYTES + 1:
            return False
        pdu = bytes(self._buffer[MBAP_BYTES:nbytes])
        answer = self._responder.respond(unit, pdu, now_ns)
        self._last_request_ns = now_ns
        self.peer.asked += 1
        if answer is None:
            return True
        if answer.delay_ns or answer.distortion is not None or self._pending:
            self._put(answer, transaction_id, unit, now_ns)
        else:
            self._transport.write(mbap_adu(transaction_id, unit, answer.pdu))
        return True

    def _split(self, data: bytes, now_ns: int) -> None:
        """Give the bytes `data` to the splitter, and answer the requests that they complete.

        `now_ns` is the time at which they were read.
        """
        events = self._splitter.feed(data, now_ns)
        for event in events:
            if isinstance(event, Adu):
                answer = self._responder.respond(event.unit, event.pdu, now_ns)
                self._last_request_ns = now_ns
                self.peer.asked += 1
                if answer is not None:
                    self._put(answer, event.transaction_id, event.unit, now_ns)
                if self._shell.on_exchange is not None:
                    self._shell.on_exchange(event, answer)
                if (self._rules.closed_until_ns or 0) > now_ns:
                    break  # A remote reset closes it: later requests are lost.
        self._is_in_pieces = not self._splitter.is_idle
        self._watch_parts(has_ended_one=bool(events))

    def _put(self, answer: Response, transaction_id: int | None, unit: int, now_ns: int) -> None:
        """Queue a response for `now_ns` plus its delay.

        `transaction_id` is None for RTU over TCP. A simulated fault may split the response into
        pieces, or end the connection after it.
        """
        due_ns = last_ns = now_ns + answer.delay_ns
        transport = Transport.RTU_TCP if transaction_id is None else Transport.TCP
        for after_ns, piece in wire_pieces(answer, transport, unit, transaction_id or 0):
            last_ns = due_ns + after_ns
            self._pending.append((last_ns, piece))
        if answer.distortion is not None and answer.distortion.ending is not None:
            self._pending.append((last_ns, answer.distortion.ending))

    def _send_due(self) -> None:
        """Send the responses that are due now, and set a timer for the later ones.

        If nothing is left to send and the master has sent FIN, close the connection.
        """
        if self._send_timer is not None:
            self._send_timer.cancel()
            self._send_timer = None
        now_ns = self._clock()
        due = bytearray()
        while self._pending and self._pending[0][0] <= now_ns:
            _, part = self._pending.popleft()
            if isinstance(part, ConnectionEnding):
                self._end(bytes(due), part)
                return
            due += part
        if due:
            self._transport.write(bytes(due))
        if self._pending:
            rest_s = (self._pending[0][0] - now_ns) / 1e9
            self._send_timer = self._loop.call_later(rest_s, self._send_due)
        elif self._has_ended:
            self._transport.close()
            return
        self._pause_or_resume_reading()

    def _end_as_planned(self, ending: ConnectionEnding) -> None:
        """End the connection when the responses that wait have been sent. If the device then
        accepts no connection, the listening socket is closed first, so that a master that connects
        again at once is refused.
        """
        if self._pending:
            rest_s = max(self._pending[-1][0] - self._clock(), 0) / 1e9
            self._end_timer = self._loop.call_later(rest_s, self._end_as_planned, ending)
            return
        self._rules.ends(self.peer, self._clock())
        self._shell.after_rules_applied(lambda: self._end(b"", ending))

    def _end(self, last: bytes, ending: ConnectionEnding) -> None:
        """Send the bytes `last`, then close or reset the connection, as `ending` says."""
        self._pending.clear()
        if last:
            self._transport.write(last)
        if ending is ConnectionEnding.CLOSE:
            self._transport.close()
        else:
            reset(self._transport)

    def _pause_or_resume_reading(self) -> None:
        pauses = self._peer_is_slow or len(self._pending) >= self._shell.waiting
        if pauses is not self._is_paused:
            self._is_paused = pauses
            if pauses:
                self._transport.pause_reading()
            else:
                self._transport.resume_reading()

    def _watch_idle(self) -> None:
        """Close the connection if no complete request came for idle_s seconds; else set a timer to
        check again.
        """
        if math.isinf(self._rules.idle_s):
            return
        rest_s = self._rules.idle_s - (self._clock() - self._last_request_ns) / 1e9
        if rest_s <= 0:
            self._transport.abort()
        else:
            self._idle_timer = self._loop.call_later(rest_s, self._watch_idle)

    def _watch_parts(self, *, has_ended_one: bool) -> None:
        """Start the timer for the missing last part of a request, or stop it.

        `has_ended_one` is True if the last read completed a request.
        """
        if self._split_timer is not None and (has_ended_one or not self._is_in_pieces):
            self._split_timer.cancel()
            self._split_timer = None
        if self._is_in_pieces and self._split_timer is None and math.isfinite(self._rules.split_s):
            self._split_timer = self._loop.call_later(
                self._rules.split_s, self._abort_split_request
            )

    def _abort_split_request(self) -> None:
        self._loss = Loss.SPLIT
        self._transport.abort()


MAX_REFUSED_HOSTS = 64
"""At most this many refused machines are reported to the user; further ones are refused
silently."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """The limits of one TCP endpoint: its number of connections, the seconds that a connection may
    be without a request, and its number of pending responses.
    """

    connections: int = SLAVE_CONNECTIONS
    idle_s: float = SLAVE_IDLE_S
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
            self._report_refused(host, refusal)
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

    def note_left(self, connection: MasterConnection) -> None:
        self.connections.discard(connection)

    def apply_changed_rules(self) -> None:
        self.rules.changed = False
        for connection in self.connections:
            connection.keep_alive(self.rules.keep_alive)
            connection.plan_end()
        if self._closed_s() > 0:
            self._woken.set()

    def after_rules_applied(self, ends: Callable[[], None]) -> None:
        if self.rules.changed:
            self.apply_changed_rules()
        if self._closed_s() > 0 and not self._is_closed:
            self._once_closed.append(ends)
        else:
            ends()

    def _report_refused(self, host: str, refusal: str) -> None:
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
