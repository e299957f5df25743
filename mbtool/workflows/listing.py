"""Finds what there is to open on this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.sources.interfaces_here import interfaces_here
from mbtool.sources.ports_here import ports_here

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core.here import InterfaceHere, SerialPortHere


def links_here() -> tuple[Sequence[SerialPortHere], Sequence[InterfaceHere]]:
    """The serial ports and the interfaces; nothing is opened."""
    return ports_here(), interfaces_here()
