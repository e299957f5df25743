"""The shell for a link."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError, parse_link
from mbtool.slave.shells.opening import open_shell
from mbtool.slave.shells.serial_shell import SerialSlave
from mbtool.slave.shells.tcp_shell import TcpSlave
from tests.slave.scripted import Scripted, echo


@pytest.mark.parametrize(
    ("link", "kind"),
    [
        ("rtu:/dev/ttyUSB0@19200-8E1", SerialSlave),
        ("ascii:/dev/ttyUSB0@9600-7E1", SerialSlave),
        ("tcp:127.0.0.1:1502", TcpSlave),
        ("rtu+tcp:127.0.0.1:1502", TcpSlave),
    ],
)
def test_every_link_of_a_slave_has_its_shell(link: str, kind: type[object]) -> None:
    assert type(open_shell(parse_link(link), Scripted(echo))) is kind


def test_a_link_with_two_ports_is_none_for_a_slave() -> None:
    with pytest.raises(UsageError, match="two ports can only listen; to answer, name one"):
        open_shell(parse_link("rtu:/dev/a,/dev/b@9600"), Scripted(echo))


@pytest.mark.parametrize("link", ["net:eth0", "tap:127.0.0.1:1502=10.0.0.9:502"])
def test_a_link_to_listen_on_is_none_for_a_slave(link: str) -> None:
    with pytest.raises(UsageError, match=f"link {link}: a slave needs rtu:PORT"):
        open_shell(parse_link(link), Scripted(echo))
