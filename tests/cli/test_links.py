"""mbtool links, on this machine and on machines that have this and that."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.core.local_ports import Holder, LocalInterface, LocalSerialPort, PortTrouble

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

PORT = LocalSerialPort(
    device="/dev/ttyUSB0",
    driver="ftdi_sio",
    latency_timer_ms=16,
    low_latency=False,
    holders=(Holder(412, "picocom"),),
    unseen_processes=3,
    troubles=(PortTrouble("glued", "echo 1"), PortTrouble("held")),
)
INTERFACE = LocalInterface(name="eth0", is_up=False)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with one of each."""
    monkeypatch.setattr("mbtool.ports.local_ports.local_ports", lambda: [PORT])
    monkeypatch.setattr("mbtool.sources.local_interfaces.local_interfaces", lambda: [INTERFACE])


@pytest.mark.usefixtures("machine")
def test_root_is_not_told_to_use_sudo(mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbtool.cli.links._is_root", lambda: True)
    assert mbtool("links").err == "processes that could not be examined: 3\n"


@pytest.mark.usefixtures("machine")
def test_the_table_goes_to_standard_output_and_what_was_not_seen_beside_it(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.cli.links._is_root", lambda: False)
    told = mbtool("links")
    assert told.code == exit_codes.DONE
    assert (
        told.err == "processes that could not be examined: 3; sudo shows the ports that they hold\n"
    )
    assert [line.rstrip() for line in told.lines] == [
        "port     what it is  driver    timing       low latency  held by",
        "ttyUSB0  -           ftdi_sio  timer 16 ms  -            picocom (412)",
        "",
        "rtu:/dev/ttyUSB0@19200-8E1",
        "  ! glued",
        "    echo 1",
        "  ! held",
        "",
        "interface  what it is  state  capture",
        "net:eth0   -           down   permitted",
    ]


@pytest.mark.usefixtures("machine")
def test_json_lines_leave_out_what_is_not_known(mbtool: CommandLine) -> None:
    told = mbtool("links", "--format", "jsonl")
    assert told.code == exit_codes.DONE
    assert [json.loads(line) for line in told.lines] == [
        {
            "kind": "serial",
            "link": "rtu:/dev/ttyUSB0@19200-8E1",
            "device": "/dev/ttyUSB0",
            "driver": "ftdi_sio",
            "latency_timer_ms": 16,
            "low_latency": False,
            "holders": [{"pid": 412, "command": "picocom"}],
            "unseen_processes": 3,
            "troubles": [{"problem": "glued", "remedy": "echo 1"}, {"problem": "held"}],
        },
        {
            "kind": "interface",
            "link": "net:eth0",
            "name": "eth0",
            "is_up": False,
            "may_capture": True,
        },
    ]


@pytest.mark.parametrize("format_", ["table", "jsonl"])
def test_without_a_port_it_recommends_a_virtual_line(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, format_: str
) -> None:
    monkeypatch.setattr("mbtool.ports.local_ports.local_ports", list)
    monkeypatch.setattr("mbtool.sources.local_interfaces.local_interfaces", lambda: [INTERFACE])
    told = mbtool("links", "--format", format_)
    assert told.code == exit_codes.DONE
    assert told.err == (
        "no serial ports here; without hardware, mbtool line lays a virtual serial line\n"
    )
    assert "net:eth0" in told.out
    assert "rtu:" not in told.out


def test_the_name_of_an_interface_that_is_not_utf_8_is_printed(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.ports.local_ports.local_ports", list)
    odd = [LocalInterface(name="eth\udcff")]
    monkeypatch.setattr("mbtool.sources.local_interfaces.local_interfaces", lambda: odd)
    assert json.loads(mbtool("links", "--format", "jsonl").out)["name"] == "eth\udcff"
    assert "net:eth?" in mbtool("links").out


@pytest.mark.parametrize("format_", ["table", "jsonl"])
def test_the_links_of_this_machine_can_be_listed(mbtool: CommandLine, format_: str) -> None:
    told = mbtool("links", "--format", format_)
    assert told.code == exit_codes.DONE
    assert "net:lo" in told.out
