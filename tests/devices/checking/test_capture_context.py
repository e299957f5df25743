from __future__ import annotations

from mbtool.devices.checking.capture_context import CaptureContext


def test_the_default_context_has_no_devices_lines_or_ports() -> None:
    around = CaptureContext()
    assert around.assignments.profiles == []
    assert around.line_of("rs485") is None
    assert around.ports is None
