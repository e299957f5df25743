"""Ports and interfaces as text, at several widths."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import pytest
from rich.console import Console

from mbtool.core.local_ports import Holder, LocalInterface, LocalSerialPort, PortTrouble
from mbtool.views.links import print_interfaces, print_ports

if TYPE_CHECKING:
    from collections.abc import Sequence

STABLE = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0"
TEE = "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
ADAPTER = LocalSerialPort(
    device="/dev/ttyUSB0",
    stable=STABLE,
    description="FTDI FT232R USB UART",
    usb_id="0403:6001",
    driver="ftdi_sio",
    latency_timer_ms=16,
    low_latency=False,
    low_latency_support=True,
    holders=(Holder(412, "picocom"), Holder(77, "cat")),
    troubles=(PortTrouble("FTDI latency timer 16 ms: frames arrive glued", TEE),),
)
UART = LocalSerialPort(device="/dev/ttyS0", fifo_bytes=1, low_latency=True, unseen_processes=3)
CH340 = LocalSerialPort(device="/dev/ttyUSB1", driver="ch341-uart", low_latency_support=False)
UNKNOWN = LocalSerialPort(device="COM3")
FORBIDDEN = PortTrouble("listening needs the capability cap_net_raw", "sudo setcap python")


def ports(*shown: LocalSerialPort, width: int = 100) -> list[str]:
    file = io.StringIO()
    print_ports(Console(file=file, width=width), shown)
    return [line.rstrip() for line in file.getvalue().splitlines()]


def interfaces(*shown: LocalInterface, width: int = 100) -> list[str]:
    file = io.StringIO()
    print_interfaces(Console(file=file, width=width), shown)
    return [line.rstrip() for line in file.getvalue().splitlines()]


def columns(lines: Sequence[str], row: int) -> list[str]:
    """The cells of a row, cut where the headings begin."""
    heads = ("port", "what it is", "driver", "timing", "low latency", "held by")
    starts = [lines[0].index(head) for head in heads]
    ends = [*starts[1:], None]
    return [lines[row][start:end].strip() for start, end in zip(starts, ends, strict=True)]


def test_a_port_is_a_row_then_its_link_its_troubles_and_what_mends_them() -> None:
    assert ports(ADAPTER, width=120) == [
        "port     what it is                        driver    timing       low latency  held by",
        "ttyUSB0  FTDI FT232R USB UART (0403:6001)  ftdi_sio  timer 16 ms  when opened"
        "  picocom (412), cat (77)",
        "",
        f"rtu:{STABLE}@19200-8E1",
        "  ! FTDI latency timer 16 ms: frames arrive glued",
        f"    {TEE}",
    ]


def test_what_is_not_known_is_a_dash() -> None:
    lines = ports(ADAPTER, UART, CH340, UNKNOWN, width=130)
    assert columns(lines, 2) == ["ttyS0", "-", "-", "FIFO 1 byte", "on", "nobody seen"]
    assert columns(lines, 3) == ["ttyUSB1", "-", "ch341-uart", "-", "no", "-"]
    assert columns(lines, 4) == ["COM3", "-", "-", "-", "-", "-"]
    assert "rtu:COM3@19200-8E1" in lines


@pytest.mark.parametrize("width", [20, 40, 60, 80, 100])
def test_links_and_commands_are_never_broken(width: int) -> None:
    wordy = PortTrouble("a long story of what is wrong " * 5, "sudo " + "very " * 30 + "long")
    lines = ports(ADAPTER, LocalSerialPort(device="/dev/ttyS1", troubles=(wordy,)), width=width)
    copied = [f"rtu:{STABLE}@19200-8E1", f"    {TEE}", f"    {wordy.remedy}"]
    assert [line for line in lines if line in copied] == copied
    others = [line for line in lines if line not in [*copied, "rtu:/dev/ttyS1@19200-8E1"]]
    assert max(map(len, others)) <= width


def test_an_interface_is_a_row_that_begins_with_its_link() -> None:
    assert interfaces(
        LocalInterface(name="eth0", description="Ethernet", is_up=True, has_carrier=True),
        LocalInterface(name="eth1", description="Ethernet", is_up=True, has_carrier=False),
        LocalInterface(name="eth2", description="Ethernet", is_up=False),
        LocalInterface(name="en0"),
    ) == [
        "interface  what it is  state         capture",
        "net:eth0   Ethernet    up            permitted",
        "net:eth1   Ethernet    up, no cable  permitted",
        "net:eth2   Ethernet    down          permitted",
        "net:en0    -           -             permitted",
    ]


def test_what_all_interfaces_lack_is_said_once_and_what_one_lacks_with_its_name() -> None:
    can = PortTrouble("it carries no IP")
    lines = interfaces(
        LocalInterface(name="can0", troubles=(can, FORBIDDEN)),
        LocalInterface(name="eth0", troubles=(FORBIDDEN,)),
    )
    assert lines[3:] == [
        "  ! can0: it carries no IP",
        "  ! listening needs the capability cap_net_raw",
        "    sudo setcap python",
    ]
    assert all(line.split()[-1] == "no" for line in lines[1:3])


def test_markup_and_control_characters_from_adapters_have_no_effect() -> None:
    adapter = LocalSerialPort(device="/dev/ttyUSB0", description="[red]a\x1b[2Jb[/red]")
    assert "[red]a?[2Jb[/red]" in ports(adapter)[1]
