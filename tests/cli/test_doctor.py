"""mbtool doctor: what it prints, and its exit codes."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.core.local_ports import LocalSerialPort, PortTrouble
from mbtool.ports import local_ports

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

TIMER = PortTrouble(
    "its timer is 16 ms, so frames come in blocks of that length, glued", "echo 1 | tee"
)


@pytest.fixture(autouse=True)
def ports(monkeypatch: pytest.MonkeyPatch) -> list[LocalSerialPort]:
    """The ports that this machine seems to have."""
    found: list[LocalSerialPort] = []
    monkeypatch.setattr(local_ports, "local_ports", lambda: found)
    return found


def test_without_a_fault_it_says_so(mbtool: CommandLine) -> None:
    told = mbtool("doctor")
    assert told.code == exit_codes.DONE
    assert told.lines[0].startswith("ok  Python ")
    assert any("serial ports" in line and "none here" in line for line in told.lines)
    assert told.err.startswith("nothing is broken; ")


def test_a_fault_stands_with_its_command_and_ends_with_1(
    mbtool: CommandLine, ports: list[LocalSerialPort]
) -> None:
    ports.append(LocalSerialPort(device="/dev/ttyUSB0", usb_id="0403:6001", troubles=(TIMER,)))
    told = mbtool("doctor")
    assert told.code == exit_codes.NO
    at = next(n for n, line in enumerate(told.lines) if line.startswith("!!  port ttyUSB0"))
    assert "echo 1 | tee" in [line.strip() for line in told.lines[at : at + 3]]
    assert told.err.startswith("1 thing broken (!!); ")


def test_the_same_as_json(mbtool: CommandLine, ports: list[LocalSerialPort]) -> None:
    ports.append(LocalSerialPort(device="/dev/ttyUSB0", usb_id="0403:6001", troubles=(TIMER,)))
    told = mbtool("doctor", "--json")
    document = json.loads(told.out)
    assert (told.code, told.err, document["broken"]) == (exit_codes.NO, "", 1)
    (port,) = [one for one in document["checks"] if one["name"].startswith("port")]
    assert (port["state"], port["remedy"]) == ("broken", "echo 1 | tee")
