"""Serves one text over HTTP, such as metrics that a Prometheus server fetches."""

# The server runs in threads of its own and only returns the text that was set last. So a slow
# client makes no other part of the program wait. A connection ends after FETCH_S in any case. At
# most MAX_FETCHING requests are served at once; further ones are closed. The same rules as for a
# tap or a slave (tcp_listener.py) decide which machines may connect, and how often.

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import BaseServer, TCPServer
from typing import Any

from mbtool.core import Endpoint, LinkError, UsageError
from mbtool.ports.tcp_listener import BACKLOG, THIS_MACHINE, AllowedPeers, ConnectionRate

CONTENT_TYPE = "application/openmetrics-text; version=1.0.0; charset=utf-8"
FETCH_S = 10.0
"""A request and its answer may take this time (s), as long as Prometheus waits by default."""
MAX_FETCHING = 16


def parse_place(text: str) -> Endpoint:
    """Read HOST:PORT; without a HOST it is 127.0.0.1. Raises UsageError for another form."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 0xFFFF:
        raise UsageError(f"--metrics {text}: write HOST:PORT, or :PORT for 127.0.0.1")
    return Endpoint(host.strip("[]") or "127.0.0.1", int(port))


class MetricsServer:
    """Serves the text at /metrics, while its `with` block runs."""

    def __init__(self, place: Endpoint, allowed: AllowedPeers = THIS_MACHINE) -> None:
        self._place = place
        self._allowed = allowed
        self.text = b"# EOF\n"
        self._server: ThreadingHTTPServer | None = None

    @property
    def place(self) -> str:
        """The address at which it is served, with the port that the system chose for port 0."""
        assert self._server is not None
        return str(Endpoint(self._place.host, self._server.server_port))

    def __enter__(self) -> MetricsServer:
        """Raises LinkError if the address cannot be opened, and UsageError if other machines can
        reach it and none may connect.
        """
        handler = type("_Handler", (_TextHandler,), {"source": self})
        try:
            address = self._place.host, self._place.port
            self._server = _Server(address, handler, self._allowed, f"--metrics {self._place}")
        except OSError as error:
            raise LinkError(f"--metrics {self._place}: cannot be opened: {error}") from error
        threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = BACKLOG

    def __init__(
        self,
        address: tuple[str, int],
        handler: type[BaseHTTPRequestHandler],
        allowed: AllowedPeers,
        name: str,
    ) -> None:
        """`name` is the user's text for the address."""
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._allowed = allowed
        self._name = name
        self._rate = ConnectionRate(allowed.limits.per_second)
        self._room = threading.BoundedSemaphore(MAX_FETCHING)
        super().__init__(address, handler)

    def server_activate(self) -> None:
        self._allowed.demand_for(self._name, str(self.server_address[0]))
        super().server_activate()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        return client_address[0] in self._allowed and self._rate.admits(time.monotonic())

    def server_bind(self) -> None:
        """Bind as HTTPServer does, but ask no DNS server for the name of this machine."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._room.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        deadline = threading.Timer(FETCH_S, _end, (request,))
        deadline.daemon = True
        try:
            deadline.start()
            super().process_request_thread(request, client_address)
        finally:
            deadline.cancel()
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over an error of one connection, such as a peer that is gone."""


def _end(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


class _TextHandler(BaseHTTPRequestHandler):
    source: MetricsServer

    def __init__(self, request: Any, client_address: Any, server: BaseServer) -> None:
        with suppress(OSError):
            super().__init__(request, client_address, server)

    def do_GET(self) -> None:
        if self.path.partition("?")[0] not in ("/", "/metrics"):
            self.send_error(404)
            return
        text = self.source.text
        self.send_response(200)
        self.send_header("Content-Type", CONTENT_TYPE)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass
