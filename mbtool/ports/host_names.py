"""Looks up the names of hosts, and says why a name leads to no address."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Iterator
from queue import Empty, SimpleQueue
from threading import Thread

from mbtool.core.errors import reason_of


def why_unknown(error: Exception) -> str | None:
    """Return a text that says why a host has no address; None if the error has another cause.

    Python raises UnicodeError for a name that no host can have, such as `a..b`.
    """
    if isinstance(error, UnicodeError):
        return "no such host"
    if isinstance(error, socket.gaierror):
        return "no such host" if error.errno == socket.EAI_NONAME else str(error.strerror)
    return None


def why_failed(error: OSError | ValueError) -> str:
    """Return a text that says why a connection could not be opened."""
    return "no answer" if isinstance(error, TimeoutError) else reason_of(error)


class HostLookup:
    """Looks up hosts in a thread, as a name server that is down may take half a minute."""

    def __init__(self, hosts: Iterable[str]) -> None:
        self._problems: SimpleQueue[str] = SimpleQueue()
        for host in hosts:
            Thread(target=self._look_up, args=(host,), daemon=True).start()

    def problems(self) -> Iterator[str]:
        """Yield `HOST: WHY` for each host that was found since the last call to have no address."""
        while True:
            try:
                yield self._problems.get_nowait()
            except Empty:
                return

    def _look_up(self, host: str) -> None:
        try:
            socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            self._problems.put(f"{host}: {why_unknown(error) or error}")
