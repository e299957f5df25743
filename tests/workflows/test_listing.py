"""What there is to open here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.local_ports import LocalInterface, LocalSerialPort
from mbtool.workflows import listing

if TYPE_CHECKING:
    import pytest


def test_ports_and_interfaces_are_found_together(monkeypatch: pytest.MonkeyPatch) -> None:
    port, interface = LocalSerialPort(device="/dev/ttyUSB0"), LocalInterface(name="eth0")
    monkeypatch.setattr(listing, "local_ports", lambda: [port])
    monkeypatch.setattr(listing, "local_interfaces", lambda: [interface])
    assert listing.links_here() == ([port], [interface])
