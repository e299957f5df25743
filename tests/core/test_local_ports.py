"""The texts of local ports, interfaces and troubles."""

from __future__ import annotations

from mbtool.core.link_spec import parse_link
from mbtool.core.local_ports import Holder, LocalInterface, LocalSerialPort, PortTrouble

BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"


def test_a_ports_link_is_its_stable_name_where_it_has_one() -> None:
    assert LocalSerialPort(device="/dev/ttyS0").link == "rtu:/dev/ttyS0@19200-8E1"
    port = LocalSerialPort(device="/dev/ttyUSB0", stable=BY_PATH)
    assert port.link == f"rtu:{BY_PATH}@19200-8E1"
    assert str(parse_link(port.link)) == port.link
    assert port.name == "ttyUSB0"


def test_an_interface_can_be_captured_unless_there_is_trouble() -> None:
    assert LocalInterface(name="eth0").link == "net:eth0"
    assert LocalInterface(name="eth0", is_up=False).may_capture
    assert not LocalInterface(name="eth0", troubles=(PortTrouble("forbidden"),)).may_capture


def test_trouble_is_one_line_with_its_remedy() -> None:
    assert str(PortTrouble("its group is dialout", "sudo usermod")) == (
        "its group is dialout: sudo usermod"
    )
    assert str(PortTrouble("only root may read it")) == "only root may read it"
    assert str(Holder(412, "agetty")) == "agetty (412)"
