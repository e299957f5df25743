"""A master that asks one request at a time and waits for its answer."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Self

from mbtool.core import Endpoint, TcpLink
from mbtool.master.links import open_master

if TYPE_CHECKING:
    from mbtool.core import LinkSpec

TIMEOUT_S = 2.0

_NS = 1_000_000_000
_LEAST_PAUSE_NS = 5_000_000
"""On a line: time for the adapter of who listens there, where t3.5 is shorter."""


class Poller:
    """Asks on a link. A context manager whose exit closes it."""

    def __init__(self, link: LinkSpec) -> None:
        """Open the link. Raises LinkError, UsageError."""
        self._link = open_master(link, round(TIMEOUT_S * _NS))
        self._number = 0

    def ask(self, unit: int, pdu: bytes) -> bytes | None:
        """The response PDU, or None where none comes in time. Raises LinkError."""
        limits = self._link.limits
        if limits.pause_ns:
            time.sleep(max(2 * limits.pause_ns, _LEAST_PAUSE_NS) / _NS)
        self._number += 1
        self._link.send(self._number, unit, pdu)
        until_ns = time.monotonic_ns() + limits.timeout_ns
        while (rest_ns := until_ns - time.monotonic_ns()) > 0:
            for answer in self._link.receive(rest_ns):
                if answer.number == self._number:
                    return answer.pdu
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()


class TcpPoller(Poller):
    """Speaks Modbus/TCP."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(TcpLink(endpoint))
