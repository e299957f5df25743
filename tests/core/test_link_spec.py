"""The LINK strings of the command line."""

from __future__ import annotations

import pytest

from mbtool.core import (
    Endpoint,
    InterfaceLink,
    LinkSpec,
    SerialFormat,
    SerialLink,
    TapLink,
    TcpLink,
    UsageError,
    parse_link,
)

E8 = SerialFormat(19200, 8, "E", 1)


@pytest.mark.parametrize(
    ("text", "link"),
    [
        ("rtu:/dev/ttyUSB0@19200-8E1", SerialLink("/dev/ttyUSB0", E8)),
        ("rtu:COM3@9600-8N2", SerialLink("COM3", SerialFormat(9600, 8, "N", 2))),
        ("rtu:/dev/ttyUSB0", SerialLink("/dev/ttyUSB0", E8)),
        ("rtu:/dev/a@b@9600", SerialLink("/dev/a@b", SerialFormat(9600))),
        ("ascii:/dev/ttyS0@9600-7E1", SerialLink("/dev/ttyS0", SerialFormat(9600, 7), ascii=True)),
        ("ascii:/dev/ttyS0", SerialLink("/dev/ttyS0", SerialFormat(9600, 7), ascii=True)),
        ("net:eth0", InterfaceLink("eth0")),
        (
            "tap:127.0.0.1:1502=10.0.0.9:502",
            TapLink(Endpoint("127.0.0.1", 1502), Endpoint("10.0.0.9", 502)),
        ),
        ("tap:[::1]:1502=plc", TapLink(Endpoint("::1", 1502), Endpoint("plc", 502))),
        ("tcp:127.0.0.1:1502", TcpLink(Endpoint("127.0.0.1", 1502))),
        ("tcp:10.0.0.9", TcpLink(Endpoint("10.0.0.9", 502))),
        ("tcp:[fe80::1%eth0]", TcpLink(Endpoint("fe80::1%eth0", 502))),
        ("tcp:[::1]:1502", TcpLink(Endpoint("::1", 1502))),
        ("rtu+tcp:127.0.0.1:1502", TcpLink(Endpoint("127.0.0.1", 1502), rtu=True)),
    ],
)
def test_reads_a_link(text: str, link: LinkSpec) -> None:
    assert parse_link(text) == link
    assert parse_link(str(link)) == link


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("rtu:/dev/serial/by-id/usb-1@9600", "usb-1"),
        ("net:eth0", "eth0"),
        ("tap:127.0.0.1:1502=10.0.0.9:502", "10.0.0.9"),
        ("tap:127.0.0.1:1502=10.0.0.9:503", "10.0.0.9:503"),
        ("tcp:127.0.0.1:1502", "127.0.0.1:1502"),
    ],
)
def test_link_has_a_name_without_a_slash(text: str, name: str) -> None:
    assert parse_link(text).name == name


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("", "write rtu:PORT"),
        ("rtu", "write rtu:PORT"),
        ("rtu:", "write rtu:PORT"),
        ("usb:/dev/ttyUSB0", "write rtu:PORT"),
        ("rtu:@19200-8E1", "no port is named"),
        ("rtu:/", "no port is named"),
        ("rtu:/dev/ttyUSB0@", "line settings ''"),
        ("rtu:/dev/ttyUSB0@fast", "line settings 'fast'"),
        ("rtu:/dev/ttyUSB0@9600-7E1", "RTU needs 8 data bits"),
        ("rtu:/dev/a,/dev/b@9600", "name one port"),
        ("tap:127.0.0.1:1502", "whom to call"),
        ("tap:=10.0.0.9", "'' is no address"),
        ("tcp:1502:", "is no address"),
        ("tcp::1502", "is no address"),
        ("tcp:::1", "is no address"),
        ("tcp:[::1", "is no address"),
        ("tcp:[]:502", "is no address"),
        ("tcp://10.0.0.9:502", "is no address"),
        ("tcp:10.0.0.9:65536", "is no address"),
        ("tcp:10.0.0.9:-1", "is no address"),
        ("tcp:10.0.0.9:٥٠٢", "is no address"),
        ("tcp:10.0.0.9:" + "9" * 5000, "is no address"),
    ],
)
def test_link_that_cannot_be_says_what_would_be_right(text: str, advice: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_link(text)
    assert advice in str(caught.value)
    assert "\n" not in str(caught.value)
