"""The value of --link for a file."""

from __future__ import annotations

import pytest

from mbtool.core.errors import UsageError
from mbtool.core.link_spec import LineSettings, SerialLink, parse_line
from mbtool.core.serial_format import SerialFormat


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("rtu@19200-8E1", LineSettings(SerialFormat())),
        ("rtu@9600", LineSettings(SerialFormat(9600))),
        ("rtu", LineSettings(SerialFormat())),
        ("ascii@9600-7E1", LineSettings(SerialFormat(9600, 7), ascii=True)),
        ("ascii@9600-8N1", LineSettings(SerialFormat(9600, 8, "N"), ascii=True)),
        ("ascii", LineSettings(SerialFormat(9600, 7), ascii=True)),
    ],
)
def test_reads_the_settings_of_a_line(text: str, line: LineSettings) -> None:
    assert parse_line(text) == line
    assert parse_line(str(line)) == line


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "rtu@19200-8E1 or ascii@9600-7E1"),
        ("tcp@502", "rtu@19200-8E1 or ascii@9600-7E1"),
        ("rtu:/dev/ttyUSB0@19200-8E1", "of the line of a file without a port: rtu@19200-8E1"),
        ("rtu@fast", "write baud, data bits, parity and stop bits"),
        ("rtu@9600-7E1", "RTU needs 8 data bits, for example rtu@19200-8E1"),
    ],
)
def test_refuses_a_text_that_is_no_line(text: str, problem: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_line(text)
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_and_a_port_make_a_link() -> None:
    line = LineSettings(SerialFormat(9600, 7), ascii=True)
    assert line.link_at("bench") == SerialLink("bench", SerialFormat(9600, 7), ascii=True)
