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
import ipaddress
import math
import os
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network
from typing import Any, Self

from mbtool.core import Endpoint, LinkError, TapLink, TcpLink, UsageError
from mbtool.core.limits import CONNECTIONS_PER_SECOND

# ConnectionLimits: masters connected at once, new connections per second, idle time.
#
# A connection that comes faster than the rate allows is reset. The rate is a bucket of tokens: a
# burst of as many connections as may come in one second is accepted at once, then one for each
# token that the passing time adds.

SPARE_S = 1.0
"""If a tap has as many connections as its limit allows, a new one replaces an unused one. A
connection is unused if no byte came on it for this time (s), and either the slave has never
answered on it or one side has ended it. (The TCP guide, V1.0b, 4.3.2, also closes the oldest unused
one.)"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionLimits:
    """The limits for connections to one endpoint that the user has set; None means the default."""

    connections: int | None = None
    per_second: float | None = None
    """The most new connections in a second; None means CONNECTIONS_PER_SECOND."""
    idle_s: float | None = None


class ConnectionRate:
    """Limits the rate of new connections with a bucket of tokens."""

    def __init__(self, per_second: float | None) -> None:
        self.per_second = CONNECTIONS_PER_SECOND if per_second is None else per_second
        self._left = self._burst = max(self.per_second, 1.0)
        self._at_s = -math.inf

    def admits(self, now_s: float) -> bool:
        """Count a new connection at `now_s` (seconds); return True if the rate allows it."""
        self._left = min(self._burst, self._left + max(now_s - self._at_s, 0.0) * self.per_second)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


# The code below decides which machines may connect to a TCP listener: this one, and those given by
# --allow.
#
# AllowedPeers also has the limits that the user has set for the connections of these machines.
#
# This machine may always connect, through its loopback address. Other machines may connect if their
# address is in a network given by --allow. A network of prefix length 0 (0.0.0.0/0 or ::/0) admits
# every machine, over IPv4 and IPv6.
#
# A socket for both IPv4 and IPv6 shows the IPv4 address 10.0.0.1 as ::ffff:10.0.0.1 (RFC 4291,
# 2.5.5.2). Such an address is compared, and shown, as IPv4.

_NO_LIMITS = ConnectionLimits()
_MAPPED_BITS = 96
"""An IPv4-mapped IPv6 address (::ffff:a.b.c.d) has 96 bits before the 32 of the IPv4 address."""


@dataclass(frozen=True, slots=True)
class AllowedPeers:
    """The machines that may connect: this one, and all whose address is in one of `networks`."""

    networks: tuple[IPv4Network | IPv6Network, ...] = ()
    limits: ConnectionLimits = _NO_LIMITS

    @classmethod
    def parse(cls, texts: Iterable[str], limits: ConnectionLimits = _NO_LIMITS) -> Self:
        """Read the values of --allow, each a network or the address of one machine.

        Raises UsageError for a value that is neither, such as 192.168.1.7/24, which is an address
        inside a network. `limits` apply to the connections of all machines together.
        """
        return cls(tuple(_network(text) for text in texts), limits)

    def __contains__(self, host: object) -> bool:
        """True if a machine with this IP address may connect; False if `host` is no IP address."""
        try:
            address = plain_address(str(host))
        except ValueError:
            return False
        return address.is_loopback or any(
            network.prefixlen == 0 or address in network for network in self.networks
        )

    def demand_for(self, name: str, host: str) -> None:
        """Raise UsageError if other machines can reach the address `host`, and none may connect.

        `name` is the user's text for the endpoint.
        """
        if not self.networks and host not in THIS_MACHINE:
            raise UsageError(
                f"{name}: other machines can reach {host}; listen at 127.0.0.1, or name "
                "those that may connect: --allow 192.168.1.0/24, or --allow 0.0.0.0/0 for all"
            )


THIS_MACHINE = AllowedPeers()
"""Only this machine may connect: the default of every listener."""


def plain_address(host: str) -> IPv4Address | IPv6Address:
    """Read an IP address; turn an IPv4-mapped IPv6 address (::ffff:10.0.0.1) into the IPv4 address.

    Raises ValueError for a text that is no IP address.
    """
    address = ipaddress.ip_address(host)
    return (isinstance(address, IPv6Address) and address.ipv4_mapped) or address


def _network(text: str) -> IPv4Network | IPv6Network:
    try:
        network = ipaddress.ip_network(text, strict=False)
    except ValueError:
        raise UsageError(
            f"--allow {text!r}: write a network, such as 192.168.1.0/24 or fd00::/8, "
            "or the address of one machine; 0.0.0.0/0 lets everybody in"
        ) from None
    address = text.partition("/")[0]
    if ipaddress.ip_address(address) != network.network_address:
        raise UsageError(
            f"--allow {text!r}: is an address inside {network}; write {network} for the whole "
            f"network, or {address} for one machine"
        )
    if isinstance(network, IPv6Network) and network.prefixlen >= _MAPPED_BITS:
        mapped = network.network_address.ipv4_mapped
        return IPv4Network((mapped, network.prefixlen - _MAPPED_BITS)) if mapped else network
    return network


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
        self._allowed.demand_for(str(self._link), self._address[0])
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
        refusal = self.refusal_text(host)
        if refusal is not None:
            return refusal
        if not self._rate.admits(time.monotonic()):
            return f"more than {self._rate.per_second:g} connections a second; see --max-rate"
        return None

    def refusal_text(self, host: str) -> str | None:
        """Return a text that says that no peer with this address may connect; None if it may."""
        return (
            None if host in self._allowed else f"{_address_text(host)} is in no network of --allow"
        )

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
                # With SO_REUSEADDR, two programs could share a port on Windows, and with UDP on
                # every system.
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


def _address_text(host: str) -> str:
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
