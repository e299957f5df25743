"""What there is to open here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.here import InterfaceHere, SerialPortHere
from mbtool.workflows import listing

if TYPE_CHECKING:
    import pytest


def test_ports_and_interfaces_are_found_together(monkeypatch: pytest.MonkeyPatch) -> None:
    port, interface = SerialPortHere(device="/dev/ttyUSB0"), InterfaceHere(name="eth0")
    monkeypatch.setattr(listing, "ports_here", lambda: [port])
    monkeypatch.setattr(listing, "interfaces_here", lambda: [interface])
    assert listing.links_here() == ([port], [interface])
