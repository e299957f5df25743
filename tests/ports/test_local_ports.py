"""The serial ports of machines made of files, and of this one."""

from __future__ import annotations

import grp
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from mbtool.core import parse_link
from mbtool.core.local_ports import Holder, LocalSerialPort, PortTrouble
from mbtool.ports.local_ports import local_ports, ports_by_pyserial
from tests.sources.machine import Machine

if TYPE_CHECKING:
    from pathlib import Path

if sys.platform != "linux":
    pytest.skip("what there is below /sys is Linux's", allow_module_level=True)

FTDI = {
    "idVendor": "0403",
    "idProduct": "6001",
    "manufacturer": "FTDI",
    "product": "FT232R USB UART",
    "serial": "A50285BI",
}
CH340 = {"idVendor": "1a86", "idProduct": "7523", "product": "USB Serial"}
BY_ID = "usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0"
BY_PATH = "pci-0000:00:14.0-usb-0:2:1.0-port0"


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def only(machine: Machine) -> LocalSerialPort:
    (port,) = local_ports(machine.root)
    return port


def test_an_ftdi_adapter_is_told_in_full(machine: Machine) -> None:
    machine.usb_adapter("ttyUSB0", driver="ftdi_sio", usb=FTDI, latency_timer=16)
    machine.stable_name("by-id", BY_ID, "ttyUSB0")
    machine.stable_name("by-path", BY_PATH, "ttyUSB0")
    port = only(machine)
    assert port == LocalSerialPort(
        device="/dev/ttyUSB0",
        stable=f"/dev/serial/by-id/{BY_ID}",
        description="FTDI FT232R USB UART",
        usb_id="0403:6001",
        serial_number="A50285BI",
        driver="ftdi_sio",
        latency_timer_ms=16,
        low_latency=False,
        low_latency_support=True,
        troubles=port.troubles,
    )
    assert port.troubles == (
        PortTrouble(
            "FTDI latency timer 16 ms: frames arrive glued; mbtool sets it to 1 ms when it opens "
            "the port, for other programs set it yourself",
            "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer",
        ),
    )


def test_a_latency_timer_of_one_millisecond_is_no_trouble(machine: Machine) -> None:
    machine.usb_adapter("ttyUSB0", driver="ftdi_sio", usb=FTDI, latency_timer=1)
    assert only(machine).low_latency
    assert only(machine).troubles == ()


def test_an_adapter_without_serial_number_is_named_by_its_socket(machine: Machine) -> None:
    # Both have one name by id, which leads to the one that came last.
    for number in range(2):
        machine.usb_adapter(f"ttyUSB{number}", driver="ch341-uart", usb=CH340)
        machine.stable_name("by-path", BY_PATH.replace("0:2", f"0:{number}"), f"ttyUSB{number}")
    machine.stable_name("by-id", "usb-1a86_USB_Serial-if00-port0", "ttyUSB1")
    first, second = local_ports(machine.root)
    assert first.stable == f"/dev/serial/by-path/{BY_PATH.replace('0:2', '0:0')}"
    assert second.stable == "/dev/serial/by-id/usb-1a86_USB_Serial-if00-port0"
    assert (first.description, first.serial_number) == ("USB Serial", None)
    assert (first.low_latency, first.low_latency_support) == (False, False)
    assert first.troubles == ()


def test_a_name_with_a_comma_cannot_stand_in_a_link(machine: Machine) -> None:
    machine.usb_adapter("ttyUSB0", driver="cp210x", usb=CH340)
    machine.stable_name("by-id", "usb-Maker,_Inc", "ttyUSB0")
    assert str(parse_link(only(machine).link)) == "rtu:/dev/ttyUSB0@19200-8E1"


def test_an_adapter_of_an_unknown_driver_is_not_guessed_about(machine: Machine) -> None:
    machine.usb_adapter("ttyACM0", driver="maker_acm", usb={"idVendor": "1", "idProduct": "2"})
    port = only(machine)
    assert (port.driver, port.description) == ("maker_acm", "USB serial adapter")
    assert (port.low_latency, port.low_latency_support) == (None, None)


def test_cdc_acm_has_its_driver_at_the_interface(machine: Machine) -> None:
    machine.usb_adapter("ttyACM0", driver="cdc_acm", usb={**CH340, "manufacturer": "WAGO"})
    assert (only(machine).driver, only(machine).description) == ("cdc_acm", "WAGO USB Serial")


def test_a_uart_is_named_by_the_driver_of_its_hardware(machine: Machine) -> None:
    machine.uart("ttyS0", type=4, flags="0x10000040", rx_trig_bytes=8)
    port = only(machine)
    assert (port.driver, port.description) == ("serial", "port on the pnp bus")
    assert (port.fifo_bytes, port.low_latency, port.low_latency_support) == (8, False, True)
    assert [trouble.remedy for trouble in port.troubles] == [
        "echo 1 | sudo tee /sys/class/tty/ttyS0/rx_trig_bytes"
    ]


def test_a_uart_that_hands_over_each_byte_is_no_trouble(machine: Machine) -> None:
    machine.uart("ttyS0", type=4, flags="0x10002040", rx_trig_bytes=1)
    assert only(machine).low_latency
    assert only(machine).troubles == ()


def test_ports_without_hardware_are_left_out(machine: Machine) -> None:
    for number in range(32):
        machine.uart(f"ttyS{number}", type=0 if number > 1 else 4)
    machine.write({"tty0/active": "tty1", "ptmx/dev": "5:2"}, below="sys/class/tty")
    assert [port.name for port in local_ports(machine.root)] == ["ttyS0", "ttyS1"]


def test_ports_are_in_the_order_of_their_numbers(machine: Machine) -> None:
    for number in (10, 2, 1):
        machine.usb_adapter(f"ttyUSB{number}", driver="cp210x", usb=FTDI)
    machine.uart("ttyS3", type=4)
    assert [port.name for port in local_ports(machine.root)] == [
        "ttyS3",
        "ttyUSB1",
        "ttyUSB2",
        "ttyUSB10",
    ]


def test_the_kernels_console_is_told(machine: Machine) -> None:
    machine.uart("ttyS0", type=4)
    machine.uart("ttyS1", type=4)
    machine.write({"active": "tty0 ttyS1"}, below="sys/class/tty/console")
    first, second = local_ports(machine.root)
    assert first.troubles == ()
    assert "take console=ttyS1 off" in second.troubles[0].problem


@pytest.mark.parametrize(
    ("command", "mend"),
    [
        ("picocom", ""),
        ("agetty", "sudo systemctl stop serial-getty@ttyUSB0"),
        ("ModemManager", "sudo systemctl stop ModemManager"),
    ],
)
def test_who_holds_a_port_is_told_with_how_to_end_a_service(
    machine: Machine, command: str, mend: str
) -> None:
    machine.usb_adapter("ttyUSB0", driver="cp210x", usb=FTDI)
    machine.usb_adapter("ttyUSB1", driver="cp210x", usb=FTDI)
    machine.process(412, command, "/dev/ttyUSB0")
    held, free = local_ports(machine.root)
    assert held.holders == (Holder(412, command),)
    assert held.troubles[0].problem.startswith(f"held by {command} (412): ")
    assert held.troubles[0].remedy == mend
    assert (free.holders, free.troubles) == ((), ())


def test_a_missing_permission_names_the_group(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.usb_adapter("ttyUSB0", driver="cp210x", usb=FTDI)
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    monkeypatch.setattr(os, "supports_effective_ids", {os.access})
    monkeypatch.setattr(grp, "getgrgid", lambda _: grp.struct_group(("dialout", "x", 20, [])))
    assert only(machine).troubles == (
        PortTrouble(
            "permission denied; its group is dialout",
            "sudo usermod -aG dialout $USER, then log in again",
        ),
    )


def test_a_port_without_a_device_file_is_told(machine: Machine) -> None:
    machine.usb_adapter("ttyUSB0", driver="cp210x", usb=FTDI)
    (machine.root / "dev/ttyUSB0").unlink()
    (trouble,) = only(machine).troubles
    assert "there is no /dev/ttyUSB0 here" in trouble.problem


def test_words_of_an_adapter_that_are_no_text_do_no_harm(machine: Machine) -> None:
    machine.usb_adapter("ttyUSB0", driver="ftdi_sio", usb=CH340, latency_timer="soon")
    (machine.root / "sys/devices/usb1/1-ttyUSB0/product").write_bytes(b"\xff\xfe\n")
    port = only(machine)
    assert port.description == "\ufffd\ufffd"
    assert port.latency_timer_ms is None


def test_a_machine_without_ports_has_none(tmp_path: Path) -> None:
    assert local_ports(tmp_path) == []


def test_elsewhere_there_is_what_pyserial_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    usb, plain = ListPortInfo("COM10"), ListPortInfo("COM2")
    usb.vid, usb.pid, usb.serial_number = 0x0403, 0x6001, "A50285BI"
    usb.description = "USB Serial Port (COM10)"
    monkeypatch.setattr(list_ports, "comports", lambda: [usb, plain])
    monkeypatch.setattr(sys, "platform", "win32")
    assert local_ports() == ports_by_pyserial()
    assert local_ports() == [
        LocalSerialPort(device="COM2"),
        LocalSerialPort(
            device="COM10",
            description="USB Serial Port (COM10)",
            usb_id="0403:6001",
            serial_number="A50285BI",
        ),
    ]


def test_the_ports_of_this_machine_have_links_that_can_be_read() -> None:
    for port in local_ports():
        assert port.device.startswith("/dev/")
        assert str(parse_link(port.link)) == port.link


def test_no_device_is_opened() -> None:
    program = (
        "import sys\n"
        "def refuse(event, arguments):\n"
        "    if event == 'open' and str(arguments[0]).startswith('/dev/'):\n"
        "        sys.exit(f'{arguments[0]} was opened')\n"
        "from mbtool.ports.local_ports import local_ports\n"
        "sys.addaudithook(refuse)\n"
        "local_ports()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
