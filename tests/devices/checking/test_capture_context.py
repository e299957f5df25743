from __future__ import annotations

from mbtool.devices.checking.capture_context import CaptureContext


def test_where_nothing_is_known_no_device_no_line_and_no_port_is() -> None:
    around = CaptureContext()
    assert around.assignments.profiles == []
    assert around.line_of("rs485") is None
    assert around.ports is None
