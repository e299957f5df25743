"""What the tests of the tap share: a target, a tap before it, and whoever calls."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from mbtool.core import Endpoint, ListenTls, TapLink, TargetTls
from mbtool.ports.tcp_listener import AllowedPeers, ConnectionLimits
from mbtool.sources.inbox import Inbox
from mbtool.sources.tap import TapSource
from tests.sources.live_helpers import PATIENCE_S

if TYPE_CHECKING:
    import ssl
    from contextlib import ExitStack

ANY_PORT = Endpoint("127.0.0.1", 0)


class Bench:
    """A target that listens, a tap before it with TLS on either side, and the tap's inbox."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.inbox = Inbox()
        self.server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        self.server.settimeout(PATIENCE_S)
        self.target = Endpoint(*self.server.getsockname())

    def tap(
        self,
        listen: ListenTls | None = None,
        target: TargetTls | None = None,
        *,
        max_connections: int = 64,
        idle_s: float = 3600.0,
        read_only: bool = False,
        limits: ConnectionLimits | None = None,
    ) -> TapSource:
        link = TapLink(
            ANY_PORT, self.target, listen_tls=listen, target_tls=target, read_only=read_only
        )
        allowed = AllowedPeers(limits=limits or ConnectionLimits())
        return self._stack.enter_context(
            TapSource(
                link, self.inbox, allowed=allowed, max_connections=max_connections, idle_s=idle_s
            )
        )

    def call(self, tap: TapSource, tls: ssl.SSLContext | None = None) -> socket.socket:
        address = (tap.endpoint.host, tap.endpoint.port)
        plain = self._stack.enter_context(socket.create_connection(address, PATIENCE_S))
        if tls is None:
            return plain
        return self._stack.enter_context(tls.wrap_socket(plain, server_hostname="localhost"))

    def accept(self, tls: ssl.SSLContext | None = None) -> socket.socket:
        slave, _ = self.server.accept()
        slave.settimeout(PATIENCE_S)
        self._stack.enter_context(slave)
        if tls is None:
            return slave
        return self._stack.enter_context(tls.wrap_socket(slave, server_side=True))
