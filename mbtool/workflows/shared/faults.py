"""Adds the simulated faults that a file describes to a slave."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtool.core import SerialLink, UsageError
from mbtool.slave.faults.fault_file import FaultFile
from mbtool.slave.faults.faults import FaultKind, FaultySlave

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mbtool.core import TcpLink
    from mbtool.devices import Profile
    from mbtool.modbus import Responder

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
