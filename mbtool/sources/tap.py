"""A relay in the line of a TCP connection that passes every byte on and records it."""

# The tap listens at one endpoint, calls its target for each connection it accepts, and passes bytes
# both ways, at once and unchanged (relay.py). It has a thread with an event loop of its own, and
# hands over what it records when an answer may have passed (outbox.py).
#
# What it cannot do as a direct connection would: the master's connection is accepted before the
# target has answered. If the target cannot be reached, the master's connection is reset, and a
# REFUSED event says why.
#
# With TLS on a side, the bytes recorded are those inside it; the files it needs are read before the
# tap listens.
#
# Who records opens its log before others' connections take the files that a process may have open:
# a tap that `waits` takes none until it is told to. Those that are left when no more can be opened
# wait in the system's queue, which is an event, at most one in SHORT_S.
#
# Bounds: 64 connections at once, one more is reset with an event; a connection without a byte for
# an hour is closed. A master that polls less often than that is rare, and without a limit peers
# that have vanished would fill the 64 places for good.

from __future__ import annotations

import asyncio
import errno
import os
import socket
from contextlib import suppress
from functools import partial
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Self

from mbtool.core import Endpoint, EventKind, LinkError, Quiet, TapLink, WireEvent
from mbtool.packets import CloseReason
from mbtool.ports.clock import now_ns
from mbtool.ports.tls import client_context, server_context
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.outbox import Outbox
from mbtool.sources.relay import TcpRelay, reset

if TYPE_CHECKING:
    import ssl

MAX_CONNECTIONS = 64
IDLE_S = 3600.0
SHORT_S = 10.0
_SHORT = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))
_TICK_S = 0.1
"""How often the consumer is told that time passes, and idle connections are looked for."""


class TapSource:
    """Relays and records while its context is open. Entering raises LinkError."""

    def __init__(
        self,
        link: TapLink,
        inbox: Inbox,
        *,
        max_connections: int = MAX_CONNECTIONS,
        idle_s: float = IDLE_S,
        waits: bool = False,
    ) -> None:
        """With `waits` nobody is let in before `accept`."""
        self._link = link
        self._inbox = inbox
        self._outbox: Outbox | None = None
        self._max_connections = max_connections
        self._idle_s = idle_s
        self._endpoint = link.listen
        self._listen_tls: ssl.SSLContext | None = None
        self._target_tls: tuple[ssl.SSLContext, str] | None = None
        self._relays: set[TcpRelay] = set()
        self._accepted = 0
        self._waits = waits
        self._server: asyncio.Server | None = None
        self._short_s = -SHORT_S
        """When it was last told that no connection can be taken, on the event loop's clock."""
        self._is_serving = Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._told_to_end: asyncio.Event | None = None
        self._thread: Thread | None = None

    @property
    def link(self) -> str:
        return self._link.name

    @property
    def place(self) -> str:
        return str(TapLink(self._endpoint, self._link.target))

    @property
    def endpoint(self) -> Endpoint:
        """Where the tap listens, with the port that the system chose where 0 was asked."""
        return self._endpoint

    def __enter__(self) -> Self:
        link = self._link
        if link.listen_tls is not None:
            self._listen_tls = server_context(link.listen_tls)
        if link.target_tls is not None:
            self._target_tls = client_context(link.target_tls, link.target.host)
        listener = _listen(self._link)
        host, port = listener.getsockname()[:2]
        self._endpoint = Endpoint(host, port)
        self._thread = Thread(
            target=self._run, args=(listener,), name=f"tap {self.link}", daemon=True
        )
        self._thread.start()
        self._is_serving.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def accept(self) -> None:
        """Let in who calls, where the tap was to wait with that."""
        if self._loop is not None and self._server is not None:
            asyncio.run_coroutine_threadsafe(self._server.start_serving(), self._loop).result()

    def close(self) -> None:
        """Close all connections; what was relayed is in the inbox, then Ended."""
        if self._thread is None or self._loop is None or self._told_to_end is None:
            return
        with suppress(RuntimeError):  # The loop is closed: this is the second call.
            self._loop.call_soon_threadsafe(self._told_to_end.set)
        self._thread.join()

    def _run(self, listener: socket.socket) -> None:
        try:
            asyncio.run(self._serve(listener))
        finally:
            if self._outbox is not None:
                self._outbox.flush()
            self._inbox.put(Ended(self.link))
            self._is_serving.set()

    async def _serve(self, listener: socket.socket) -> None:
        self._loop = asyncio.get_running_loop()
        self._told_to_end = asyncio.Event()
        outbox = self._outbox = Outbox(self._inbox, self._loop)
        self._loop.set_exception_handler(partial(self._note_trouble, outbox))
        server = await self._loop.create_server(
            lambda: self._relay(outbox).master, sock=listener, start_serving=not self._waits
        )
        self._server = server
        self._is_serving.set()
        while not self._told_to_end.is_set():
            with suppress(TimeoutError):
                await asyncio.wait_for(self._told_to_end.wait(), _TICK_S)
            self._tick(self._loop.time(), outbox)
        server.close()
        for relay in tuple(self._relays):
            relay.abort(CloseReason.CAPTURE_END)
        while self._relays:
            await asyncio.sleep(0)

    def _relay(self, outbox: Outbox) -> TcpRelay:
        self._accepted += 1
        return TcpRelay(
            link=self.link,
            target=self._link.target,
            number=self._accepted,
            inbox=outbox,
            on_accept=partial(self._admit, outbox),
            on_end=self._relays.discard,
            listen_tls=self._listen_tls,
            target_tls=self._target_tls,
        )

    def _admit(
        self, outbox: Outbox, relay: TcpRelay, transport: asyncio.Transport, master: Endpoint
    ) -> bool:
        if len(self._relays) < self._max_connections:
            self._relays.add(relay)
            return True
        outbox.put(
            WireEvent(
                ts_ns=now_ns(),
                link=self.link,
                kind=EventKind.DISCARDED,
                message=f"connection turned away: {self._max_connections} are open already",
                source=str(master),
                destination=str(self._link.target),
            )
        )
        reset(transport)
        return False

    def _note_trouble(
        self, outbox: Outbox, loop: asyncio.AbstractEventLoop, context: dict[str, Any]
    ) -> None:
        """Tell once of what asyncio tells at each try: that no connection can be taken."""
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in _SHORT:
            loop.default_exception_handler(context)
            return
        if loop.time() - self._short_s < SHORT_S:
            return
        self._short_s = loop.time()
        outbox.put(
            WireEvent(
                ts_ns=now_ns(),
                link=self.link,
                kind=EventKind.REFUSED,
                message=f"no more connections for now: {error.strerror}; ulimit -n allows more",
                destination=str(self._link.target),
            )
        )

    def _tick(self, now_s: float, outbox: Outbox) -> None:
        for relay in tuple(self._relays):
            if now_s - relay.active_s > self._idle_s:
                relay.abort(CloseReason.IDLE)
        outbox.put(Quiet(now_ns(), self.link))


def _listen(link: TapLink) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            link.listen.host, link.listen.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
        try:
            if os.name == "posix":  # On Windows this option would let two programs share a port.
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen()
        except OSError:
            listener.close()
            raise
    except (OSError, UnicodeError) as error:
        raise LinkError(f"{link}: cannot listen at {link.listen}: {_remedy(error)}") from error
    return listener


def _remedy(error: OSError | UnicodeError) -> str:
    if isinstance(error, socket.gaierror | UnicodeError):
        return "no such host; give an address of this machine, for example 127.0.0.1"
    match error.errno:
        case errno.EADDRINUSE:
            return "the address is in use; give another port, or 0 for any that is free"
        case errno.EACCES | errno.EPERM:
            return "ports below 1024 need a privilege; give a higher one, for example 1502"
        case errno.EADDRNOTAVAIL:
            return "no interface here has this address; give 127.0.0.1, or 0.0.0.0 for all"
        case _:
            return error.strerror or str(error)
