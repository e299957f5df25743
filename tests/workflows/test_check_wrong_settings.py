"""Serial lines heard with other settings than theirs: what a UART then delivers, byte by byte."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat
from mbtool.core.link_spec import parse_line
from mbtool.modbus import ascii_adu, rtu_adu
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.reading import ReadingOptions
from tests.uart import on_the_wire

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

FIND_THEM = "mbtool sniff rtu:PORT@auto finds them by listening"


def frames(*, is_ascii: bool, polls: int) -> Iterator[bytes]:
    make = ascii_adu if is_ascii else rtu_adu
    for number in range(polls):
        unit, value = 1 + number % 3, 37 * number
        yield make(unit, bytes.fromhex("03 0000 0004"))
        yield make(unit, bytes.fromhex("03 08") + value.to_bytes(2, "big") * 4)


def capture(sent: str, heard: str, folder: Path, *, polls: int, drops: bool = False) -> Path:
    """Byte times as the listener has them; `drops` if its driver drops damaged characters."""
    sent_as, heard_as = parse_line(sent), parse_line(heard)
    wire = on_the_wire(frames(is_ascii=sent_as.ascii, polls=polls), sent_as.format)
    width_ns = heard_as.format.character_ns
    rows = [
        f"{(one.end_ns - width_ns) / 1e9:.7f},{one.end_ns / 1e9:.7f},rx,{one.value:02X}"
        for one in wire.heard(heard_as.format)
        if not (drops and one.is_damaged)
    ]
    path = folder / "line.csv"
    path.write_text("\n".join(["t_start_s,t_end_s,line,byte_hex", *rows]) + "\n")
    return path


def found(path: Path, heard: str) -> list[tuple[str, str, str]]:
    run = CheckRun([str(path)], ReadingOptions(line=parse_line(heard)))
    findings = [placed.finding for placed in run.findings()]
    return [(one.code, one.severity, one.message) for one in findings]


@pytest.mark.parametrize("drops", [False, True])
@pytest.mark.parametrize(
    ("sent", "heard", "remedy"),
    [
        ("rtu@19200-8E1", "rtu@9600-8E1", FIND_THEM),
        ("rtu@9600-8N1", "rtu@19200-8N1", FIND_THEM),
        ("rtu@38400-8N1", "rtu@9600-8N1", FIND_THEM),
        ("rtu@2400-8E1", "rtu@9600-8E1", FIND_THEM),
        ("rtu@9600-8N1", "rtu@9600-8E1", FIND_THEM),
        ("ascii@9600-7E1", "rtu@9600-8E1", FIND_THEM),
        ("ascii@9600-7E1", "rtu@9600-8N1", "ascii:PORT@9600-7E1 fits these bytes"),
        ("ascii@9600-7O1", "rtu@9600-8N1", "ascii:PORT@9600-7O1 fits these bytes"),
        ("ascii@9600-8N1", "rtu@9600-8N1", "ascii:PORT@9600-8N1 fits these bytes"),
        ("rtu@9600-8E1", "ascii@9600-8E1", "rtu:PORT@9600-8E1 fits these bytes"),
        ("rtu@9600-8E1", "ascii@9600-7E1", FIND_THEM),
    ],
)
def test_a_line_heard_with_wrong_settings_is_an_error_with_a_remedy(
    sent: str, heard: str, remedy: str, drops: bool, tmp_path: Path
) -> None:
    if drops and heard == "ascii@9600-7E1":
        pytest.skip("every character of 8 bits is damaged for a listener of 7, so nothing is heard")
    path = capture(sent, heard, tmp_path, polls=60, drops=drops)
    unreadable = [one for one in found(path, heard) if one[0] == "RTU-204"]
    ((_, severity, message),) = unreadable
    assert severity == "error"
    assert message.startswith("of ")
    assert f"can be read with {heard}, so the settings are probably wrong; {remedy}" in message


@pytest.mark.parametrize(
    "line", ["rtu@19200-8E1", "rtu@9600-8N1", "rtu@9600-8N2", "ascii@9600-7E1", "ascii@9600-8N1"]
)
def test_a_line_heard_with_its_own_settings_has_no_finding(line: str, tmp_path: Path) -> None:
    assert found(capture(line, line, tmp_path, polls=10), line) == []


def test_a_few_bytes_are_too_few_to_say_anything(tmp_path: Path) -> None:
    path = capture("rtu@19200-8E1", "rtu@9600-8E1", tmp_path, polls=2)
    assert len(path.read_text().splitlines()) < 48
    assert found(path, "rtu@9600-8E1") == []


def test_a_line_of_which_a_third_can_be_read_is_damaged_and_not_unreadable(tmp_path: Path) -> None:
    good = [frame.hex() for frame in frames(is_ascii=False, polls=10)]
    noise = "5533" * (len("".join(good)) // 4 * 2)
    path = tmp_path / "line.hex"
    path.write_text(" ".join([*good[:10], noise, *good[10:]]))
    codes = {code for code, _, _ in found(path, "rtu@9600-8E1")}
    assert "RTU-202" in codes
    assert "RTU-204" not in codes
    path.write_text(" ".join([*good[:4], noise, noise]))
    assert "RTU-204" in {code for code, _, _ in found(path, "rtu@9600-8E1")}
    # Where requests are answered, the settings are right, whatever else is on the line.
    path.write_text(" ".join([*good[:10], noise, noise, *good[10:]]))
    assert "RTU-204" not in {code for code, _, _ in found(path, "rtu@9600-8E1")}


def test_the_uart_of_these_tests_hears_what_was_sent() -> None:
    sent = b"".join(frames(is_ascii=False, polls=5))
    for text in ("19200-8E1", "9600-8N1", "9600-8O1", "9600-8N2"):
        line = SerialFormat.parse(text)
        heard = list(on_the_wire([sent], line).heard(line))
        assert bytes(one.value for one in heard) == sent
        assert not any(one.is_damaged for one in heard)
