"""A TCP tap: masters connect to it instead of the slave; it relays and records all bytes."""

# The tap listens at one endpoint (ports/tcp_listener.py), connects to its target for each
# connection that it accepts, and passes bytes both ways, at once and unchanged. It runs
# in a thread with an event loop of its own. The consumer gets recorded bytes a few ms later, so
# that decoding does not delay the response (inbox.py).
#
# One thing differs from a direct connection: the master's connection is accepted before the target
# accepts the tap's. If the target cannot be reached, the master's connection is reset, and a
# REFUSED event gives the reason. A master whose address is not allowed is reset at once, also with
# an event.
#
# If a side has TLS, the decrypted bytes are recorded. The certificate files are read before the tap
# listens.
#
# Each connection uses up open files, whose number is limited for a process. The program must open
# its log before they run out, so a tap with `waits` accepts no master until `accept` is called.
# Masters that connect earlier, or while no more files can be opened, wait in the system's queue.
#
# Limits, unless the user sets others (ports/tcp_listener.py): 64 connections at once. A further one
# is reset, with an event, unless another connection is unused: on that connection the slave never
# answered or a side has ended, and no byte came for SPARE_S. Then the unused one is closed instead.
# So a flood of connections blocks masters for SPARE_S at most. A connection without a byte for an
# hour is closed: few masters poll so rarely, and connections whose peers have vanished would
# otherwise add up to 64.
#
# A tap that is read-only passes on only requests that read (read_only.py).

from __future__ import annotations

import asyncio
import os
import re
import ssl
from collections.abc import Callable
from contextlib import suppress

from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    EventKind,
    Quiet,
    Stamp,
    TapLink,
    WireEvent,
)
from mbtool.core.limits import TAP_CONNECTIONS, TAP_IDLE_S
from mbtool.packets import CloseReason, StreamClosed, StreamOpened
from mbtool.ports.clock import now_ns
from mbtool.ports.host_names import why_unknown
from mbtool.ports.tcp_listener import SPARE_S, THIS_MACHINE, AllowedPeers, TcpListener, reset
from mbtool.ports.tls import client_context, described, failure, server_context
from mbtool.sources.inbox import Ended, Outbox, Sink
from mbtool.sources.read_only import ReadOnlyScreen
from mbtool.sources.source import LiveSource

_TICK_S = 0.1
"""The period in seconds at which the tap puts a Quiet item (all bytes up to now are delivered) and
closes idle connections."""


class TapSource(LiveSource[TapLink]):
    """Relays connections between masters and a slave, and records them, while its context is open.

    Entering the context raises LinkError if the tap cannot listen or a certificate file is wrong,
    UsageError if other machines can reach its endpoint and none is allowed to connect.
    """

    _loop: asyncio.AbstractEventLoop
    _outbox: Outbox

    def __init__(
        self,
        link: TapLink,
        inbox: Sink,
        *,
        allowed: AllowedPeers = THIS_MACHINE,
        max_connections: int = TAP_CONNECTIONS,
        idle_s: float = TAP_IDLE_S,
        waits: bool = False,
    ) -> None:
        """If `waits` is True, the tap accepts no connection before `accept` is called.

        `max_connections` (at once) and `idle_s` (seconds without a byte, after which a connection
        is closed) apply if the user has set no limits in `allowed`.
        """
        super().__init__(link, inbox)
        self._listener = TcpListener(link, link.listen, allowed)
        self._max_connections = allowed.limits.connections or max_connections
        self._idle_s = allowed.limits.idle_s or idle_s
        self._waits = waits
        self._listen_tls: ssl.SSLContext | None = None
        self._target_tls: tuple[ssl.SSLContext, str] | None = None
        self._server: asyncio.Server | None = None
        self._relays: set[TcpRelay] = set()
        self._accepted = 0
        self._told_to_end = asyncio.Event()

    @property
    def place(self) -> str:
        return str(TapLink(self.endpoint, self._link.target))

    @property
    def endpoint(self) -> Endpoint:
        """The endpoint at which the tap listens.

        If the user gave port 0, `open` replaces it by the free port that the system chose.
        """
        return self._listener.endpoint

    def open(self) -> None:
        link = self._link
        if link.listen_tls is not None:
            self._listen_tls = server_context(link.listen_tls)
        if link.target_tls is not None:
            self._target_tls = client_context(link.target_tls, link.target.host)
        self._listener.open()
        self._loop = asyncio.new_event_loop()
        self._outbox = Outbox(self._inbox, self._loop)
        self._start_thread(self._run)
        if not self._waits:
            self.accept()

    def accept(self) -> None:
        asyncio.run_coroutine_threadsafe(self._accept(), self._loop).result()

    def close(self) -> None:
        if self._thread is not None:
            with suppress(RuntimeError):  # An earlier call has closed the loop.
                self._loop.call_soon_threadsafe(self._told_to_end.set)
            self._thread.join()

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._tick_until_told())
        finally:
            self._listener.close()
            self._outbox.flush()
            self._inbox.put(Ended(self.link))

    async def _accept(self) -> None:
        self._server = await self._listener.serve(
            lambda: self._relay().master, lambda text: self._report_event(EventKind.REFUSED, text)
        )

    async def _tick_until_told(self) -> None:
        while not self._told_to_end.is_set():
            with suppress(TimeoutError):
                await asyncio.wait_for(self._told_to_end.wait(), _TICK_S)
            now_s = self._loop.time()
            for relay in tuple(self._relays):
                if now_s - relay.active_s > self._idle_s:
                    relay.abort(CloseReason.IDLE)
            self._outbox.put(Quiet(now_ns(), self.link))
        if self._server is not None:
            self._server.close()
        for relay in tuple(self._relays):
            relay.abort(CloseReason.CAPTURE_END)
        while self._relays:
            await asyncio.sleep(0)

    def _relay(self) -> TcpRelay:
        self._accepted += 1
        return TcpRelay(
            link=self.link,
            target=self._link.target,
            number=self._accepted,
            inbox=self._outbox,
            on_accept=self._admit,
            on_end=self._relays.discard,
            listen_tls=self._listen_tls,
            target_tls=self._target_tls,
            screen=ReadOnlyScreen(is_rtu=self._link.is_rtu) if self._link.read_only else None,
        )

    def _admit(self, relay: TcpRelay, transport: asyncio.Transport, master: Endpoint) -> bool:
        """Keep a master's new connection and return True, or reset it and return False.

        It is reset if the master's address is not allowed or a limit is reached.
        """
        refusal = self._listener.refusal(master.host)
        if refusal is not None:
            self._report_event(EventKind.REFUSED, refusal, str(master))
        elif len(self._relays) >= self._max_connections and not self._make_room():
            text = f"connection turned away: {self._max_connections} are open already"
            self._report_event(EventKind.DISCARDED, text, str(master))
        else:
            self._relays.add(relay)
            return True
        reset(transport)
        return False

    def _make_room(self) -> bool:
        """Close the unused connection (`TcpRelay.is_unused`) without a byte for the longest time.

        Returns False if no connection is unused.
        """
        unused = [relay for relay in self._relays if relay.is_unused(self._loop.time())]
        if unused:
            min(unused, key=lambda relay: relay.active_s).abort(CloseReason.CROWDED_OUT)
        return bool(unused)

    def _report_event(self, kind: EventKind, message: str, master: str = "") -> None:
        self._outbox.put(
            WireEvent(
                ts_ns=now_ns(),
                link=self.link,
                kind=kind,
                message=message,
                source=master,
                destination=str(self._link.target),
            )
        )


# One connection through the tap: two transports that pass bytes to each other.
#
# The relay behaves like a direct connection. If one side closes its sending direction (half-close),
# the relay closes that direction towards the other side, and the other direction goes on. It passes
# on a reset. It passes on back-pressure: if one side does not read, the relay stops reading the
# other side. asyncio's transport buffers 64 KiB for each side before it asks to stop, and may
# exceed this by one read of at most 256 KiB.
#
# Each side may have TLS (ports/tls.py); the decrypted bytes are recorded. The relay connects to the
# target once the master's handshake is complete. Bytes that the master sends right after the
# handshake, at most two reads, are kept until the target is connected, and are recorded with the
# time at which they are passed on. asyncio's TLS supports no half-close: the end of one direction
# ends both, once pending bytes are sent. asyncio buffers at most 256 KiB and one read of bytes that
# are received and not yet decrypted.
#
# Each read is one chunk, or several if it is large. The relay notes the time right after the read,
# passes the bytes on, then records them. The response can only come later, so requests are always
# recorded before their responses. If a side fails, all bytes that came from it before are already
# recorded.

CONNECT_S = 10.0
"""Timeout in seconds for the target to accept the connection, and for the master to complete a TLS
handshake."""
MAX_PIECE = 2**13
"""The most bytes of a chunk; a larger read is split. One read may bring 256 KiB, that is 20,000
pipelined requests, which take the decoder a second. The decoder looks only between two chunks if
the user wants to end the run, so chunks are kept small."""
MAX_WAITING = 2**16
"""While more bytes than this wait to be sent to one side, the relay does not read the other side.

With TLS, asyncio lets more bytes wait.
"""

_ERRNO = re.compile(r"\[Errno (\d{1,5})\]")


class TcpRelay:
    """Passes bytes between one master that has connected and the target (the slave)."""

    def __init__(
        self,
        *,
        link: str,
        target: Endpoint,
        number: int,
        inbox: Sink,
        on_accept: Callable[[TcpRelay, asyncio.Transport, Endpoint], bool],
        on_end: Callable[[TcpRelay], None],
        listen_tls: ssl.SSLContext | None = None,
        target_tls: tuple[ssl.SSLContext, str] | None = None,
        screen: ReadOnlyScreen | None = None,
    ) -> None:
        """Prepare a relay for the connection of one master.

        `link` is the link's name and `number` the connection's number in it. `listen_tls` is the
        TLS context for masters, `target_tls` that for the target, and the name that the target's
        certificate must have; None means no TLS. `on_accept` gets the relay, the master's transport
        and address; it returns True to keep the connection. `on_end` is called when both sides are
        closed. `screen` chooses the requests that are passed on; None passes on all bytes.
        """
        self._link = link
        self._target = target
        self._number = number
        self._inbox = inbox
        self._on_accept = on_accept
        self._on_end = on_end
        self._listen_tls = listen_tls
        self._target_tls = target_tls
        self._connection: Connection | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._reason: CloseReason | None = None
        self._ended_by: Direction | None = None
        """The direction of the side that ended its connection first; None before that."""
        self.screen = screen
        self._has_answered = False
        """True once any bytes were sent to the master, by the slave or by a read-only tap."""
        self._is_open = False
        self.active_s = 0.0
        """The time at which bytes last arrived from either side, in seconds on the event loop's
        clock."""
        self.master = _RelaySide(self, Direction.REQUEST)
        self.slave = _RelaySide(self, Direction.RESPONSE)
        self.master.peer, self.slave.peer = self.slave, self.master

    def abort(self, reason: CloseReason) -> None:
        """Close both connections at once, and discard bytes not yet sent.

        `reason` is recorded as the reason why the connection ended, unless there already is one.
        """
        self._reason = self._reason or reason
        if self._connecting is not None:
            self._connecting.cancel()
        for side in (self.master, self.slave):
            if side.transport is not None:
                # In the first releases of Python 3.11, a TLS transport that has ended raises
                # AttributeError in abort().
                with suppress(AttributeError):
                    side.transport.abort()

    def is_unused(self, now_s: float) -> bool:
        """True if no byte came for SPARE_S, and either the slave never answered or a side ended.

        `now_s` is the time on the event loop's clock, in seconds.
        """
        is_ending = self.master.has_ended or self.slave.has_ended
        return now_s - self.active_s >= SPARE_S and (is_ending or not self._has_answered)

    def record_and_filter(self, ts_ns: int, data: bytes) -> bytes:
        """Record bytes that the master sent at `ts_ns`; return those that a read-only tap passes
        on.

        The tap answers each other request with an exception. Bytes that are no whole requests end
        the connection.
        """
        assert self.screen is not None
        self.received(self.master, ts_ns, data)
        result = self.screen.ask(data, ts_ns)
        for refused in result.refused:
            self._report_event(
                EventKind.BLOCKED, f"read-only: {refused}; answered here with exception 01"
            )
        if result.is_broken:
            self._report_event(
                EventKind.BLOCKED, "read-only: bytes that are no requests; connection ended"
            )
            self.abort(CloseReason.RESET)
            return b""
        self.answer_refused()
        return result.onward

    def answer_refused(self) -> None:
        """Send the master the exceptions that can be sent now, and record them as the slave's."""
        assert self.screen is not None
        onward = self.master.transport
        due = self.screen.due()
        if due and onward is not None and not onward.is_closing():
            onward.write(due)
            self.received(self.slave, now_ns(), due)

    def connected(self, side: _RelaySide, transport: asyncio.Transport) -> None:
        loop = asyncio.get_running_loop()
        self.active_s = loop.time()
        if side is self.slave:
            self._open(transport)
            return
        host, port = transport.get_extra_info("peername")[:2]
        self._connection = Connection(Endpoint(host, port), self._target, self._number)
        if self._on_accept(self, transport, self._connection.master):
            # Up to Python 3.11.3 asyncio starts to read after connection_made, even if
            # connection_made has paused reading. So reading is paused by a callback that runs after
            # that.
            loop.call_soon(transport.pause_reading)
            self._connecting = loop.create_task(self._begin(transport, self._connection))

    def received(self, side: _RelaySide, ts_ns: int, data: bytes) -> None:
        self.active_s = asyncio.get_running_loop().time()
        self._has_answered = self._has_answered or side is self.slave
        for at in range(0, len(data), MAX_PIECE):
            self._inbox.put(
                Chunk(
                    ts_ns=ts_ns,
                    link=self._link,
                    data=data[at : at + MAX_PIECE],
                    direction=side.direction,
                    stamp=Stamp.AT_ONCE,
                    connection=self._connection,
                )
            )

    def note_end(self, side: _RelaySide) -> None:
        """Note that a side has ended its connection, unless the other one did so before."""
        if self._reason is None:  # Else the tap itself has ended both.
            self._ended_by = self._ended_by or side.direction

    def lost(self, side: _RelaySide, error: Exception | None) -> None:
        """Called when the connection of `side` has ended: close the other side, too.

        If `error` ended this connection, the other one is reset; otherwise it is closed normally.
        """
        self.note_end(side)
        if error is not None:
            self._reason = self._reason or CloseReason.RESET
        why = failure(error, side.who) if isinstance(error, OSError) else None
        if why is not None:
            self._report_refused(why)
        peer = side.peer
        if peer.transport is not None and not peer.is_lost:
            if error is not None:
                reset(peer.transport)
            else:
                peer.close()
        if side is self.master and self._connecting is not None:
            self._connecting.cancel()
        if self.master.is_lost and (self.slave.is_lost or self.slave.transport is None):
            self._close()

    async def _begin(self, transport: asyncio.Transport, connection: Connection) -> None:
        if self._listen_tls is None or await self._do_handshake(transport, self._listen_tls):
            await self._connect_target(connection)

    async def _do_handshake(self, transport: asyncio.Transport, tls: ssl.SSLContext) -> bool:
        """Do the TLS handshake with the master; return True if it succeeded."""
        inner = None
        try:
            inner = await asyncio.get_running_loop().start_tls(
                transport, self.master, tls, server_side=True, ssl_handshake_timeout=CONNECT_S
            )
        except OSError as error:
            self._report_refused(
                failure(error, self.master.who) or f"TLS: {_unreachable_reason(error)}"
            )
        finally:
            # If the connection ends during the handshake, asyncio may not call connection_lost, so
            # it is called here.
            if inner is None and not self.master.is_lost:
                self.master.connection_lost(None)
        if inner is None or self.master.is_lost:
            return False
        inner.pause_reading()
        self.master.transport = inner
        return True

    async def _connect_target(self, connection: Connection) -> None:
        loop = asyncio.get_running_loop()
        tls, name = self._target_tls or (None, None)
        try:
            async with asyncio.timeout(CONNECT_S):
                await loop.create_connection(
                    lambda: self.slave,
                    self._target.host,
                    self._target.port,
                    ssl=tls,
                    server_hostname=name,
                )
        except (OSError, UnicodeError) as error:  # UnicodeError comes from an invalid host name.
            of_tls = failure(error, self.slave.who) if isinstance(error, OSError) else None
            why = of_tls or f"cannot be reached: {_unreachable_reason(error)}"
            if tls is not None and isinstance(error, TimeoutError):
                why += "; perhaps it speaks no TLS"
            colon = ":" if of_tls else ""
            self._report_refused(f"{self._target}{colon} {why}")
            if self.master.transport is not None:
                reset(self.master.transport)

    def _report_refused(self, message: str) -> None:
        self._report_event(EventKind.REFUSED, message)

    def _report_event(self, kind: EventKind, message: str) -> None:
        assert self._connection is not None
        self._inbox.put(
            WireEvent(
                ts_ns=now_ns(),
                link=self._link,
                kind=kind,
                message=message,
                source=str(self._connection.master),
                destination=str(self._target),
            )
        )

    def _open(self, slave: asyncio.Transport) -> None:
        if self.master.is_lost or self.master.transport is None or self._connection is None:
            slave.abort()  # The master has disconnected in the meantime.
            return
        self._is_open = True
        sides = [(side, tls) for side in (self.master, self.slave) if (tls := side.tls) is not None]
        for side, _ in sides:
            side.limit_waiting()
        note = "; ".join(f"{side.who} {described(tls)}" for side, tls in sides)
        self._inbox.put(StreamOpened(now_ns(), self._connection, joined=False, note=note))
        self.master.pass_on_early()
        self.master.transport.resume_reading()

    def _close(self) -> None:
        if self._is_open and self._connection is not None:
            self._is_open = False
            reason = self._reason or CloseReason.FINISHED
            is_known = reason in (CloseReason.FINISHED, CloseReason.RESET)
            by = self._ended_by if is_known else None
            self._inbox.put(StreamClosed(now_ns(), self._connection, reason, by))
        self._on_end(self)


class _RelaySide(asyncio.Protocol):
    """The relay's end of one of its two connections: with the master, or with the slave.

    `peer` is the end of the other connection.
    """

    peer: _RelaySide

    def __init__(self, relay: TcpRelay, direction: Direction) -> None:
        self._relay = relay
        self.direction = direction
        self.who = "master" if direction is Direction.REQUEST else "slave"
        self.transport: asyncio.Transport | None = None
        self.is_lost = False
        self.has_ended = False
        self._is_told_to_close = False
        self._early = b""
        """Bytes that arrived here before the other side was connected, to be passed on later."""

    @property
    def tls(self) -> ssl.SSLObject | None:
        held = None if self.transport is None else self.transport.get_extra_info("ssl_object")
        return held if isinstance(held, ssl.SSLObject) else None

    def limit_waiting(self) -> None:
        if self.transport is not None:
            self.transport.set_write_buffer_limits(MAX_WAITING)

    def close(self) -> None:
        """Send pending bytes, then close this connection. A second call does nothing.

        TLS does not permit a second close.
        """
        if self.transport is not None and not self._is_told_to_close:
            self._is_told_to_close = True
            self.transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self._relay.connected(self, transport)

    def data_received(self, data: bytes) -> None:
        ts_ns = now_ns()
        onward = self.peer.transport
        if onward is None:
            self._early += data
            return
        screen = self._relay.screen
        if screen is not None and self.direction is Direction.REQUEST:
            data = self._relay.record_and_filter(ts_ns, data)
            if data and not onward.is_closing():
                onward.write(data)
            return
        if not onward.is_closing():
            onward.write(data)
        self._relay.received(self, ts_ns, data)
        if screen is not None:
            screen.respond(data, ts_ns)
            self._relay.answer_refused()

    def pass_on_early(self) -> None:
        """Pass on the bytes that arrived here before the other side was connected.

        They are recorded with the present time, not with that of their arrival.
        """
        early, self._early = self._early, b""
        if early:
            self.data_received(early)

    def eof_received(self) -> bool:
        self.has_ended = True
        self._relay.note_end(self)
        onward = self.peer.transport
        if self.peer.has_ended or onward is None:
            return False
        if onward.can_write_eof():
            with suppress(OSError):  # The peer was reset; connection_lost reports it.
                onward.write_eof()
        else:
            self.peer.close()
        return self.transport is not None and self.transport.can_write_eof()

    def connection_lost(self, exc: Exception | None) -> None:
        if self.is_lost:  # A failed TLS handshake has called this already.
            return
        self.is_lost = True
        # asyncio reports an error if the other program does not answer when the relay closes TLS.
        # This counts as a normal end nevertheless.
        is_over = self._is_told_to_close and isinstance(exc, ssl.SSLError | TimeoutError)
        self._relay.lost(self, None if is_over else exc)

    def pause_writing(self) -> None:
        if self.peer.transport is not None and not self.peer.has_ended:
            self.peer.transport.pause_reading()

    def resume_writing(self) -> None:
        # If the peer has ended, its transport has already reported the end of file. If it resumed
        # reading, it would report the end a second time.
        if self.peer.transport is not None and not self.peer.has_ended:
            self.peer.transport.resume_reading()


def _unreachable_reason(error: Exception) -> str:
    """Return a text for the user that says why the target cannot be reached."""
    unknown = why_unknown(error)
    if unknown is not None:
        return unknown
    if isinstance(error, TimeoutError) and error.errno is None:
        return f"no answer in {CONNECT_S:g} s"
    number = error.errno if isinstance(error, OSError) else None
    if number is None:  # With several addresses, asyncio gives only a text.
        found = _ERRNO.search(str(error))
        number = int(found[1]) if found is not None else 0
    return os.strerror(number) if number > 0 else str(error)
