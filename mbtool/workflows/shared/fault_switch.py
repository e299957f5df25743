"""Adds faults to a slave, and takes them away, while it answers."""

# The slave's thread calls `respond`; any other thread may call the other methods.

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from mbtool.workflows.shared.faults import faulty

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from mbtool.core import SerialLink, TcpLink
    from mbtool.devices import Profile
    from mbtool.modbus import Responder, Response


class FaultSwitch:
    """A responder that passes requests to another one, with the faults that are on."""

    def __init__(
        self, slave: Responder, link: SerialLink | TcpLink, profiles: Sequence[Profile] = ()
    ) -> None:
        self._slave = slave
        self._link = link
        self._profiles = profiles
        self._faulty = slave
        self.lock = threading.Lock()
        """Held while a request is answered."""
        self._next: list[Callable[[int], None]] = []

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        with self.lock:
            actions, self._next = self._next, []
            for act in actions:
                act(now_ns)
            return self._faulty.respond(unit, pdu, now_ns)

    def add(self, source: Path | Mapping[str, Any]) -> None:
        """Add the faults of a file, or of its keys and values, behind those that are on.

        Their `seconds` and `nth` count from the next request on. Raises the errors of `faulty`.
        """
        with self.lock:
            self._faulty = faulty(self._faulty, source, self._link, self._profiles)

    def clear(self) -> None:
        """Take all faults away."""
        with self.lock:
            self._faulty = self._slave

    def before_next(self, act: Callable[[int], None]) -> None:
        """Call `act` in the slave's thread, with the time in ns, before the next request.

        The caller holds `lock`.
        """
        self._next.append(act)
