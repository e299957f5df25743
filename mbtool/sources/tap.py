"""A TCP tap: masters connect to it instead of the slave; it relays and records all bytes."""

# The tap listens at one endpoint (ports/tcp_listener.py), connects to its target for each
# connection that it accepts, and passes bytes both ways, at once and unchanged (relay.py). It runs
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
from contextlib import suppress
from typing import TYPE_CHECKING

from mbtool.core import Endpoint, EventKind, Quiet, TapLink, WireEvent
from mbtool.core.limits import TAP_CONNECTIONS, TAP_IDLE_S
from mbtool.packets import CloseReason
from mbtool.ports.clock import now_ns
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers, TcpListener, reset
from mbtool.ports.tls import client_context, server_context
from mbtool.sources.inbox import Ended, Outbox
from mbtool.sources.read_only import ReadOnlyScreen
from mbtool.sources.relay import TcpRelay
from mbtool.sources.source import LiveSource

if TYPE_CHECKING:
    import ssl

    from mbtool.sources.inbox import Sink

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
            lambda: self._relay().master, lambda text: self._tell(EventKind.REFUSED, text)
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
            self._tell(EventKind.REFUSED, refusal, str(master))
        elif len(self._relays) >= self._max_connections and not self._make_room():
            text = f"connection turned away: {self._max_connections} are open already"
            self._tell(EventKind.DISCARDED, text, str(master))
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

    def _tell(self, kind: EventKind, message: str, master: str = "") -> None:
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
