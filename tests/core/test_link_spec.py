"""The LINK strings of the command line."""

from __future__ import annotations

import pytest

from mbtool.core.errors import UsageError
from mbtool.core.evidence import Endpoint
from mbtool.core.link_spec import (
    HEARD,
    AutoLink,
    InterfaceLink,
    LinkSpec,
    ListenTls,
    SerialLink,
    TapLink,
    TargetTls,
    TcpLink,
    parse_link,
)
from mbtool.core.serial_format import SerialFormat, Silence

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
        ("rtu:/dev/ttyUSB0@auto", AutoLink(("/dev/ttyUSB0",))),
        ("ascii:/dev/ttyUSB0@AUTO", AutoLink(("/dev/ttyUSB0",), only_ascii=True)),
        ("rtu:/dev/a,/dev/b@auto", AutoLink(("/dev/a", "/dev/b"))),
        ("rtu:auto", SerialLink("auto", E8)),
        (
            "rtu:/dev/ttyUSB0,/dev/ttyUSB1@9600-8E1",
            SerialLink("/dev/ttyUSB0", SerialFormat(9600), slave_port="/dev/ttyUSB1"),
        ),
        ("rtu:COM3,COM4", SerialLink("COM3", E8, slave_port="COM4")),
        (
            "ascii:/dev/a,/dev/b@9600-7E1",
            SerialLink("/dev/a", SerialFormat(9600, 7), ascii=True, slave_port="/dev/b"),
        ),
        (
            "rtu:/dev/ttyUSB0@9600-8E1,t3.5=28bits",
            SerialLink("/dev/ttyUSB0", SerialFormat(9600, t3_5=Silence.parse("28bits"))),
        ),
        (
            "rtutap:/dev/a@9600-8N2=/dev/b",
            SerialLink("/dev/a", SerialFormat(9600, 8, "N", 2), slave_port="/dev/b", is_relay=True),
        ),
        ("rtutap:/dev/a=/dev/b", SerialLink("/dev/a", E8, slave_port="/dev/b", is_relay=True)),
        (
            "rtutap:/dev/a@9600,t3.5=28bits=/dev/b",
            SerialLink(
                "/dev/a",
                SerialFormat(9600, t3_5=Silence.parse("28bits")),
                slave_port="/dev/b",
                is_relay=True,
            ),
        ),
        (
            "asciitap:/dev/a=/dev/b",
            SerialLink(
                "/dev/a", SerialFormat(9600, 7), ascii=True, slave_port="/dev/b", is_relay=True
            ),
        ),
        ("net:eth0", InterfaceLink(("eth0",))),
        ("net:eth0,eth1.7", InterfaceLink(("eth0", "eth1.7"))),
        ("net:any", InterfaceLink(("any",))),
        (
            "tap:127.0.0.1:1502=10.0.0.9:502",
            TapLink(Endpoint("127.0.0.1", 1502), Endpoint("10.0.0.9", 502)),
        ),
        ("tap:[::1]:1502=plc", TapLink(Endpoint("::1", 1502), Endpoint("plc", 502))),
        ("tcp:127.0.0.1:1502", TcpLink(Endpoint("127.0.0.1", 1502))),
        ("tcp:10.0.0.9", TcpLink(Endpoint("10.0.0.9", 502))),
        (
            "tap:127.0.0.1:0=127.0.0.1:1502",
            TapLink(Endpoint("127.0.0.1", 0), Endpoint("127.0.0.1", 1502)),
        ),
        (
            "tap:127.0.0.1:1502=127.0.0.2:1502",
            TapLink(Endpoint("127.0.0.1", 1502), Endpoint("127.0.0.2", 1502)),
        ),
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
        ("rtu:/dev/ttyUSB0,/dev/ttyUSB1@9600", "ttyUSB0+ttyUSB1"),
        ("rtutap:/dev/ttyUSB0@9600=/dev/ttyUSB1", "ttyUSB0+ttyUSB1"),
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
        ("rtu:/dev/ttyUSB0@99999999-8E1", "no port has 99999999 baud; write 50 to 4000000"),
        ("rtu:/dev/a@9600-7E1", "RTU needs 8 data bits, for example rtu:/dev/a@19200-8E1"),
        ("rtu:/dev/a,/dev/b,/dev/c@9600", "a line has one tap, or two different ones"),
        ("rtu:/dev/a,/dev/a@9600", "a line has one tap, or two different ones"),
        ("rtu:/dev/a,@9600", "no port is named"),
        ("rtu:,/dev/b@9600", "no port is named"),
        ("rtu:/dev/a@9600,t3.5=fast", "silence 'fast'"),
        ("rtu:/dev/a@9600,t2=5ms", "'t2=5ms' is neither t1.5=SILENCE nor t3.5=SILENCE"),
        (
            "rtu:/dev/a@auto,t3.5=5ms",
            "auto takes no silences; give them with --t1-5 and --t3-5, "
            "for example rtu:/dev/a@auto --t3-5 5ms",
        ),
        ("ascii:/dev/a,/dev/b@AUTO,t1.5=1ms", "for example ascii:/dev/a,/dev/b@auto --t3-5 5ms"),
        ("rtutap:/dev/a@auto,t3.5=5ms=/dev/b", "its settings cannot be found; give them"),
        ("rtutap:/dev/a@9600", "for example rtutap:/dev/ttyUSB0@19200-8E1=/dev/ttyUSB1"),
        ("rtutap:/dev/a@9600=", "a tap needs the port on the master's side and the port on"),
        ("asciitap:/dev/a", "for example asciitap:/dev/ttyUSB0@9600-7E1=/dev/ttyUSB1"),
        ("rtutap:/dev/a=/dev/b@9600", "the settings are those of both ports and stand behind"),
        ("rtutap:/dev/a@auto=/dev/b", "its settings cannot be found; give them"),
        ("rtutap:/dev/a@9600=/dev/a", "a tap joins two different ports"),
        ("rtutap:/dev/a,/dev/c@9600=/dev/b", "a tap joins two different ports"),
        ("rtutap:@9600=/dev/b", "no port is named, for example rtutap:/dev/ttyUSB0@19200-8E1="),
        (
            "rtutap:/dev/a@9600-7E1=/dev/b",
            "8 data bits, for example rtutap:/dev/ttyUSB0@19200-8E1=",
        ),
        ("tap:127.0.0.1:1502", "whom to call"),
        ("tap:=10.0.0.9", "'' is no address"),
        ("tap:127.0.0.1:1704=127.0.0.1:1704", "the tap would call itself"),
        ("tap:0.0.0.0:1704=127.0.0.1:1704", "for example tap:0.0.0.0:0=127.0.0.1:1704"),
        ("tap:localhost:1704=127.0.0.1:1704", "the tap would call itself"),
        ("tap:[::]=[::1]", "the tap would call itself"),
        ("tap:[::]=127.0.0.1", "the tap would call itself"),
        ("tap:127.0.0.1:1704=10.0.0.9:0", "for example tap:127.0.0.1:1704=10.0.0.9:502"),
        ("tcp:1502:", "is no address"),
        ("tcp:1502", "'1502' names no host; write HOST:PORT, for example 127.0.0.1:1502"),
        ("tap:1503=127.0.0.1:1502", "'1503' names no host"),
        ("tcp:[1]:1502", "'[1]:1502' names no host; write HOST:PORT, for example 127.0.0.1:1502"),
        ("tcp::1502", "is no address"),
        ("tcp:::1", "is no address"),
        ("tcp:[::1", "is no address"),
        ("tcp:[]:502", "is no address"),
        ("tcp://10.0.0.9:502", "is no address"),
        ("tcp:10.0.0.9:65536", "is above 65535"),
        ("tcp:10.0.0.9:-1", "is no address"),
        ("tcp:10.0.0.9:٥٠٢", "is no address"),
        ("tcp:10.0.0.9:" + "9" * 5000, "is no address"),
    ],
)
def test_an_impossible_link_says_what_would_be_right(text: str, advice: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_link(text)
    assert advice in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["foo", "usb:/dev/ttyUSB0", "tcp:"])
def test_the_error_for_a_text_that_is_no_link_names_the_links_of_the_command(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_link(text, HEARD)
    assert str(caught.value) == f"link {text!r}: write {HEARD}"


def test_only_a_link_with_one_port_can_send() -> None:
    one, two = parse_link("rtu:/dev/a@9600"), parse_link("rtu:/dev/a,/dev/b@9600")
    assert isinstance(one, SerialLink)
    assert isinstance(two, SerialLink)
    one.demand_one_port()
    with pytest.raises(UsageError, match="to answer, name one, for example rtu:/dev/a@9600-8E1"):
        two.demand_one_port()


def test_an_auto_link_keeps_all_its_ports_when_its_settings_are_found() -> None:
    link = AutoLink(("/dev/a", "/dev/b"))
    assert link.name == "a+b"
    assert str(link) == "rtu:/dev/a,/dev/b@auto"
    assert link.settled(E8, ascii=True) == SerialLink("/dev/a", E8, True, "/dev/b")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("net:eth0,", "name an interface"),
        ("net:eth0,eth0", "different ones"),
        ("net:" + ",".join(f"e{number}" for number in range(17)), "up to 16"),
        ("net:any,eth0", "any is all interfaces"),
        ("net:eth0,any", "any is all interfaces"),
    ],
)
def test_a_link_takes_a_limited_number_of_different_interfaces(text: str, says: str) -> None:
    with pytest.raises(UsageError, match=f"^link '{text}': .*{says}"):
        parse_link(text)


def test_a_link_of_several_interfaces_has_one_name_without_a_slash() -> None:
    link = parse_link("net:eth0,eth1")
    assert (link.name, str(link)) == ("eth0+eth1", "net:eth0,eth1")


@pytest.mark.parametrize(
    ("listen", "target", "sides"),
    [
        (None, None, ()),
        (ListenTls("a.pem"), None, ("master",)),
        (None, TargetTls(None), ("slave",)),
        (ListenTls("a.pem"), TargetTls("ca.pem"), ("master", "slave")),
    ],
)
def test_a_tap_names_the_sides_with_tls(
    listen: ListenTls | None, target: TargetTls | None, sides: tuple[str, ...]
) -> None:
    tap = TapLink(
        Endpoint("127.0.0.1", 1802), Endpoint("plc", 802), listen_tls=listen, target_tls=target
    )
    assert tap.tls_sides == sides
    assert str(tap) == "tap:127.0.0.1:1802=plc:802"
