"""Switches simulated faults of a slave on and off while it runs."""

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
    """A responder that passes requests on to a slave, and applies those faults that are switched
    on.
    """

    def __init__(
        self, slave: Responder, link: SerialLink | TcpLink, profiles: Sequence[Profile] = ()
    ) -> None:
        self._slave = slave
        self._link = link
        self._profiles = profiles
        self._faulty = slave
        self.lock = threading.Lock()
        """The lock that the slave's thread holds while it answers a request, so that faults change
        only between requests."""
        self._next: list[Callable[[int], None]] = []

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        with self.lock:
            actions, self._next = self._next, []
            for act in actions:
                act(now_ns)
            return self._faulty.respond(unit, pdu, now_ns)

    def add(self, source: Path | Mapping[str, Any]) -> None:
        """Switch on more faults; those that are on stay on.

        `source` is a fault file, or the keys and values of one. The `seconds` and `nth` of its
        faults count from the next request on. Raises InputError for a file that cannot be read,
        UsageError for a fault that is unknown or impossible on the link.
        """
        with self.lock:
            self._faulty = faulty(self._faulty, source, self._link, self._profiles)

    def clear(self) -> None:
        """Switch all faults off."""
        with self.lock:
            self._faulty = self._slave

    def before_next(self, act: Callable[[int], None]) -> None:
        """Let the slave's thread call `act` just before it answers the next request; the argument
        is the time in ns.

        The caller must hold `lock`.
        """
        self._next.append(act)
