"""Listens at one TCP or UDP endpoint, for the slave and for the tap."""

# An endpoint that other machines can reach is opened only with --allow. The table is by IP address;
# a host name is first resolved to its address.
#
#     endpoint             without --allow         with --allow
#     127.0.0.1, ::1       this machine connects   the same
#     any other address    UsageError              this machine and the named networks connect
#
# The address [::] takes IPv4 and IPv6 peers, on every system. For port 0 the system chooses a free
# port.
#
# The system completes a connection before the program sees the peer's address. So the slave and
# the tap call `refusal` for each connection and close it if the peer must not connect.

from __future__ import annotations

import asyncio
import errno
import os
import socket
import struct
import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from mbtool.core import Endpoint, LinkError, TcpLink, UsageError
from mbtool.ports.allowed_peers import THIS_MACHINE, AllowedPeers, plain_address
from mbtool.ports.connection_limits import ConnectionRate

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import TapLink

BACKLOG = 64
"""The most connections that may wait in the system's queue until they are accepted."""
TELL_EVERY_S = 10.0
"""The shortest time in seconds between two reports that no more connections can be opened."""

_EXHAUSTED = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))


class TcpListener:
    """A socket that listens at the endpoint of a link, and the machines that may connect to it."""

    sock: socket.socket
    """The listening socket, which `open` makes."""

    def __init__(
        self, link: TcpLink | TapLink, endpoint: Endpoint, allowed: AllowedPeers = THIS_MACHINE
    ) -> None:
        self._link = link
        self._endpoint = endpoint
        self._allowed = allowed
        self._is_udp = isinstance(link, TcpLink) and link.is_udp
        self._kind = socket.SOCK_DGRAM if self._is_udp else socket.SOCK_STREAM
        self._rate = ConnectionRate(allowed.limits.per_second)
        self._told_s = -TELL_EVERY_S
        """The time of the last call of `on_exhausted` by `serve`, in seconds on the event loop's
        clock."""

    def open(self) -> None:
        """Bind a socket to the endpoint, and listen.

        Raises UsageError if other machines can reach the endpoint and none is allowed to connect,
        LinkError if the host is unknown or the system refuses the endpoint.
        """
        self._family, self._address = self._resolve()
        host = self._address[0]
        if not self._allowed.networks and host not in THIS_MACHINE:
            raise UsageError(
                f"{self._link}: other machines can reach {host}; listen at 127.0.0.1, or name "
                "those that may connect: --allow 192.168.1.0/24, or --allow 0.0.0.0/0 for all"
            )
        self.sock = self._bind()
        try:
            if not self._is_udp:
                self.sock.listen(BACKLOG)
        except OSError as error:
            self.sock.close()
            raise self._not_listening(error) from error
        self._address = self.sock.getsockname()
        self._endpoint = Endpoint(*self._address[:2])

    @property
    def endpoint(self) -> Endpoint:
        """The endpoint at which the socket listens.

        If the user gave port 0, `open` replaces it by the free port that the system chose.
        """
        return self._endpoint

    def refusal(self, host: str) -> str | None:
        """Return a text that says why a peer with this address may not connect; None if it may.

        Call this once for each connection: each call counts as one connection for the limit on the
        rate.
        """
        stranger = self.stranger(host)
        if stranger is not None:
            return stranger
        if not self._rate.admits(time.monotonic()):
            return f"more than {self._rate.per_second:g} connections a second; see --max-rate"
        return None

    def stranger(self, host: str) -> str | None:
        """Return a text that says that no peer with this address may connect; None if it may."""
        return None if host in self._allowed else f"{_shown(host)} is in no network of --allow"

    async def serve(
        self,
        protocol: Callable[[], asyncio.BaseProtocol],
        on_exhausted: Callable[[str], None],
    ) -> asyncio.Server:
        """Accept connections in the running event loop.

        `protocol` makes the asyncio protocol of a connection. While the process can open no more
        connections (too many files are open), `on_exhausted` gets a line for the user, at most one
        in TELL_EVERY_S. Raises LinkError if another program listens at the endpoint; it can have
        taken the endpoint after a call of `hold`.
        """
        loop = asyncio.get_running_loop()

        def note_trouble(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
            error = context.get("exception")
            if not isinstance(error, OSError) or error.errno not in _EXHAUSTED:
                loop.default_exception_handler(context)
            elif loop.time() - self._told_s >= TELL_EVERY_S:
                self._told_s = loop.time()
                on_exhausted(
                    f"no more connections for now: {error.strerror}; ulimit -n allows more"
                )

        loop.set_exception_handler(note_trouble)
        try:
            return await loop.create_server(protocol, sock=self.sock, backlog=BACKLOG)
        except OSError as error:  # After `hold`, another program may listen there.
            raise self._not_listening(error) from error

    def hold(self) -> None:
        """Replace the socket, which the server has closed, by one that is bound and not listening.

        The new socket reserves the address; the system refuses all connections until `serve` is
        called again. Raises LinkError if the address cannot be bound.
        """
        self.sock = self._bind()

    def close(self) -> None:
        self.sock.close()

    def _resolve(self) -> tuple[int, tuple[Any, ...]]:
        """Return the endpoint's address family and address. Raises LinkError if it has none."""
        try:
            found = socket.getaddrinfo(
                self._endpoint.host,
                self._endpoint.port,
                type=self._kind,
                flags=socket.AI_PASSIVE,
            )
        except (socket.gaierror, UnicodeError) as error:
            raise self._not_listening(error) from error
        return found[0][0], found[0][4]

    def _bind(self) -> socket.socket:
        try:
            bound = socket.socket(self._family, self._kind)
            try:
                # On Windows two programs could then share a port, and everywhere with UDP.
                if os.name == "posix" and not self._is_udp:
                    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if self._family == socket.AF_INET6:
                    bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
                bound.bind(self._address)
            except OSError:
                bound.close()
                raise
        except OSError as error:
            raise self._not_listening(error) from error
        return bound

    def _not_listening(self, error: OSError | UnicodeError) -> LinkError:
        return LinkError(f"{self._link}: cannot listen at {self._endpoint}: {_remedy(error)}")


def reset(transport: asyncio.Transport) -> None:
    """Close a connection with RST instead of FIN; bytes not yet sent are lost."""
    reset_on_close(transport.get_extra_info("socket"))
    transport.abort()


def reset_on_close(connected: socket.socket) -> None:
    """Make the system send RST instead of FIN when a socket is closed."""
    no_linger = struct.pack("hh" if sys.platform == "win32" else "ii", 1, 0)
    with suppress(OSError):
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, no_linger)


def _shown(host: str) -> str:
    try:
        return str(plain_address(host))
    except ValueError:
        return host


def _remedy(error: OSError | UnicodeError) -> str:
    if isinstance(error, socket.gaierror | UnicodeError):
        return "no such host; give an address of this machine, for example 127.0.0.1"
    match error.errno:
        case errno.EADDRINUSE:
            return "the port is in use; give another one, or 0 for any that is free"
        case errno.EACCES | errno.EPERM:
            return "ports below 1024 need a privilege; give a higher one, for example 1502"
        case errno.EADDRNOTAVAIL:
            return "no interface here has this address; give 127.0.0.1, or 0.0.0.0 for all"
        case _:
            return error.strerror or str(error)
