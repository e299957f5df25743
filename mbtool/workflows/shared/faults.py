"""Adds the simulated faults that a file describes to a slave."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtool.core import SerialLink, TcpLink, UsageError
from mbtool.slave.faults.fault_file import FaultFile
from mbtool.slave.faults.faults import FaultKind, FaultySlave

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.modbus import Responder, Response

_ENDINGS = frozenset((FaultKind.CLOSE, FaultKind.RESET))


def faulty(
    responder: Responder,
    source: Path | Mapping[str, Any],
    link: SerialLink | TcpLink,
    profiles: Iterable[Profile] = (),
) -> FaultySlave:
    """Return a responder that answers as `responder` does, but with simulated faults.

    `source` is a fault file, or the keys and values of one. It may name registers in the notation
    of `profiles`. `link` is the link on which the responder answers. Raises InputError if the file
    cannot be read, UsageError if it is no TOML or a fault is unknown or impossible on the link.
    """
    file = FaultFile(source, profiles)
    for number, fault in enumerate(file.faults, start=1):
        reason = _why_not(fault.kind, link)
        if reason is not None:
            where = source if isinstance(source, Path) else "faults"
            raise UsageError(f"{where}: fault {number}: {fault.kind} on {link}: {reason}")
    return FaultySlave(responder, file.faults, seed=file.seed)


def _why_not(kind: FaultKind, link: SerialLink | TcpLink) -> str | None:
    """Return a text that says why a kind of fault is impossible on a link, and which kind to use
    instead.

    None if the kind is possible.
    """
    if kind is FaultKind.BAD_CRC and not isinstance(link, SerialLink) and not link.rtu:
        return "Modbus/TCP has no checksum; use truncated or extra-bytes"
    if kind is FaultKind.WRONG_ID and (isinstance(link, SerialLink) or link.rtu):
        return "only Modbus/TCP has transaction ids; use wrong-unit"
    if kind in _ENDINGS and (isinstance(link, SerialLink) or link.is_udp):
        what = "a serial line" if isinstance(link, SerialLink) else "UDP"
        return f"{what} has no connection to end; use no-answer"
    return None


# The code below switches simulated faults of a slave on and off while it runs.
#
# The slave's thread calls `respond`; any other thread may call the other methods.


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
