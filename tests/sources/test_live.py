"""Which source a link opens."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError, parse_link
from mbtool.sources.inbox import Inbox
from mbtool.sources.live import live_source


@pytest.mark.parametrize(
    ("text", "kind", "name"),
    [
        ("rtu:/dev/ttyUSB0@19200-8E1", "SerialSource", "ttyUSB0"),
        ("ascii:/dev/ttyUSB1", "SerialSource", "ttyUSB1"),
        ("net:eth0", "InterfaceSource", "eth0"),
        ("tap:127.0.0.1:1502=10.0.0.9:502", "TapSource", "10.0.0.9"),
    ],
)
def test_a_link_has_its_source(text: str, kind: str, name: str) -> None:
    source = live_source(parse_link(text), Inbox())
    assert type(source).__name__ == kind
    assert source.link == name
    assert parse_link(source.place) == parse_link(text)


def test_an_endpoint_cannot_be_listened_to() -> None:
    with pytest.raises(UsageError, match=r"^link tcp:10\.0\.0\.9:502: .*tap:127"):
        live_source(parse_link("tcp:10.0.0.9:502"), Inbox())


def test_a_line_whose_settings_are_unknown_cannot_be_listened_to_yet() -> None:
    with pytest.raises(UsageError, match=r"rtu:/dev/ttyUSB0@auto: its settings"):
        live_source(parse_link("rtu:/dev/ttyUSB0@auto"), Inbox())
