"""One connection through the tap: two transports that pass on to each other."""

# What a direct connection would do, the relay does: a half-close is passed on and the other
# direction goes on; a reset becomes a reset; a side that does not read stops the other from writing
# (asyncio's transport holds 64 KiB for each side before it says stop, and one read of at most 256
# KiB may exceed that).
#
# Each piece is one chunk. Its time is taken right after it was received, then it is passed on, then
# recorded; an answer can only come later, so the record keeps the order of cause and effect. A
# side that dies takes nothing out of the record: what came of it was recorded when it came.

from __future__ import annotations

import asyncio
import os
import re
import socket
import struct
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Connection, Direction, Endpoint, EventKind, Stamp, WireEvent
from mbtool.packets import CloseReason, StreamClosed, StreamOpened
from mbtool.sources.clock import now_ns

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.sources.inbox import Sink

CALL_S = 10.0
"""How long the target may take to accept."""

_ERRNO = re.compile(r"\[Errno (\d{1,5})\]")


class Relay:
    """Passes bytes between a master that has called and the target."""

    def __init__(
        self,
        *,
        link: str,
        target: Endpoint,
        number: int,
        inbox: Sink,
        on_accept: Callable[[Relay, asyncio.Transport, Endpoint], bool],
        on_end: Callable[[Relay], None],
    ) -> None:
        self._link = link
        self._target = target
        self._number = number
        self._inbox = inbox
        self._on_accept = on_accept
        self._on_end = on_end
        self._connection: Connection | None = None
        self._call: asyncio.Task[None] | None = None
        self._reason: CloseReason | None = None
        self._is_open = False
        self.active_s = 0.0
        """When a byte last passed, on the event loop's clock."""
        self.master = _Side(self, Direction.REQUEST)
        self.slave = _Side(self, Direction.RESPONSE)
        self.master.peer, self.slave.peer = self.slave, self.master

    def abort(self, reason: CloseReason) -> None:
        """Close both sides at once."""
        self._reason = self._reason or reason
        if self._call is not None:
            self._call.cancel()
        for side in (self.master, self.slave):
            if side.transport is not None:
                side.transport.abort()

    def connected(self, side: _Side, transport: asyncio.Transport) -> None:
        loop = asyncio.get_running_loop()
        self.active_s = loop.time()
        if side is self.slave:
            self._open(transport)
            return
        host, port = transport.get_extra_info("peername")[:2]
        self._connection = Connection(Endpoint(host, port), self._target, self._number)
        if self._on_accept(self, transport, self._connection.master):
            # Up to Python 3.11.3 asyncio adds the reader after connection_made, whatever that did,
            # so a pause must come later than that.
            loop.call_soon(transport.pause_reading)
            self._call = loop.create_task(self._call_target(self._connection))

    def received(self, side: _Side, ts_ns: int, data: bytes) -> None:
        self.active_s = asyncio.get_running_loop().time()
        self._inbox.put(
            Chunk(
                ts_ns=ts_ns,
                link=self._link,
                data=data,
                direction=side.direction,
                stamp=Stamp.AT_ONCE,
                connection=self._connection,
            )
        )

    def lost(self, side: _Side, error: Exception | None) -> None:
        """A side's transport is closed; the other's follows."""
        if error is not None:
            self._reason = self._reason or CloseReason.RESET
        peer = side.peer
        if peer.transport is not None and not peer.is_lost:
            if error is not None:
                reset(peer.transport)
            else:
                peer.transport.close()
        if side is self.master and self._call is not None:
            self._call.cancel()
        if self.master.is_lost and (self.slave.is_lost or self.slave.transport is None):
            self._close()

    async def _call_target(self, connection: Connection) -> None:
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(CALL_S):
                await loop.create_connection(
                    lambda: self.slave, self._target.host, self._target.port
                )
        except (OSError, UnicodeError) as error:  # UnicodeError: no host can have such a name.
            self._inbox.put(
                WireEvent(
                    ts_ns=now_ns(),
                    link=self._link,
                    kind=EventKind.REFUSED,
                    message=f"{self._target} cannot be reached: {_why(error)}",
                    source=str(connection.master),
                    destination=str(self._target),
                )
            )
            if self.master.transport is not None:
                reset(self.master.transport)

    def _open(self, slave: asyncio.Transport) -> None:
        if self.master.is_lost or self.master.transport is None or self._connection is None:
            slave.abort()  # The master has gone while the target was called.
            return
        self._is_open = True
        self._inbox.put(StreamOpened(now_ns(), self._connection, joined=False))
        self.master.transport.resume_reading()

    def _close(self) -> None:
        if self._is_open and self._connection is not None:
            self._is_open = False
            reason = self._reason or CloseReason.FINISHED
            self._inbox.put(StreamClosed(now_ns(), self._connection, reason))
        self._on_end(self)


class _Side(asyncio.Protocol):
    """The relay's end of one of the two connections."""

    peer: _Side

    def __init__(self, relay: Relay, direction: Direction) -> None:
        self._relay = relay
        self.direction = direction
        self.transport: asyncio.Transport | None = None
        self.is_lost = False
        self._has_ended = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self._relay.connected(self, transport)

    def data_received(self, data: bytes) -> None:
        ts_ns = now_ns()
        onward = self.peer.transport
        if onward is not None and not onward.is_closing():
            onward.write(data)
        self._relay.received(self, ts_ns, data)

    def eof_received(self) -> bool:
        self._has_ended = True
        onward = self.peer.transport
        if self.peer._has_ended or onward is None:
            return False
        with suppress(OSError):  # The other side has been reset and connection_lost will say so.
            onward.write_eof()
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        self.is_lost = True
        self._relay.lost(self, exc)

    def pause_writing(self) -> None:
        if self.peer.transport is not None and not self.peer._has_ended:
            self.peer.transport.pause_reading()

    def resume_writing(self) -> None:
        # After its end of file a transport that resumes would report the end a second time.
        if self.peer.transport is not None and not self.peer._has_ended:
            self.peer.transport.resume_reading()


def reset(transport: asyncio.Transport) -> None:
    """Close a connection with RST instead of FIN."""
    no_linger = struct.pack("hh" if sys.platform == "win32" else "ii", 1, 0)
    with suppress(OSError):
        transport.get_extra_info("socket").setsockopt(
            socket.SOL_SOCKET, socket.SO_LINGER, no_linger
        )
    transport.abort()


def _why(error: Exception) -> str:
    """What keeps the target from being called, as the user would say it."""
    if isinstance(error, UnicodeError):
        return "no such host"
    if isinstance(error, socket.gaierror):
        return "no such host" if error.errno == socket.EAI_NONAME else str(error.strerror)
    if isinstance(error, TimeoutError) and error.errno is None:
        return f"no answer in {CALL_S:g} s"
    number = error.errno if isinstance(error, OSError) else None
    if number is None:  # asyncio joins what it got from several addresses of one host.
        found = _ERRNO.search(str(error))
        number = int(found[1]) if found is not None else 0
    return os.strerror(number) if number > 0 else str(error)
