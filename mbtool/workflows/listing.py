"""Finds what there is to open on this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.ports.local_ports import local_ports
from mbtool.sources.local_interfaces import local_interfaces

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core.local_ports import LocalInterface, LocalSerialPort


def links_here() -> tuple[Sequence[LocalSerialPort], Sequence[LocalInterface]]:
    """The serial ports and the interfaces; nothing is opened."""
    return local_ports(), local_interfaces()
