"""A serial port that comes back is found by the adapter's serial number, whatever its name."""

from __future__ import annotations

import shutil
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.ports.local_ports import PortIdentity, find_port, identity_of
from tests.sources.machine import Machine

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /sys")

FTDI = {"idVendor": "0403", "idProduct": "6001", "serial": "A50285BI"}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def plug(machine: Machine, name: str, usb: dict[str, str]) -> str:
    """Plug an adapter in; return the path of its port."""
    machine.usb_adapter(name, driver="ftdi_sio", usb=usb)
    machine.write({"bInterfaceNumber": "00"}, below=f"sys/devices/usb1/1-{name}/1-{name}:1.0")
    return str(machine.root / "dev" / name)


def pull(machine: Machine, name: str) -> None:
    shutil.rmtree(machine.root / f"sys/class/tty/{name}")
    shutil.rmtree(machine.root / f"sys/devices/usb1/1-{name}")
    (machine.root / "dev" / name).unlink()


def test_an_adapter_is_found_under_another_name(machine: Machine) -> None:
    port = plug(machine, "ttyUSB0", FTDI)
    identity = identity_of(port, machine.root)
    assert identity == PortIdentity("0403:6001", "A50285BI", "00")
    pull(machine, "ttyUSB0")
    assert find_port(port, identity, machine.root) is None
    assert find_port(port, identity, machine.root) is None
    other = plug(machine, "ttyUSB1", FTDI)
    assert find_port(port, identity, machine.root) == other


def test_another_adapter_under_the_old_name_is_not_taken(machine: Machine) -> None:
    port = plug(machine, "ttyUSB0", FTDI)
    identity = identity_of(port, machine.root)
    pull(machine, "ttyUSB0")
    plug(machine, "ttyUSB0", {**FTDI, "serial": "OTHER"})
    assert find_port(port, identity, machine.root) is None


def test_an_adapter_without_a_serial_number_is_expected_under_its_path(machine: Machine) -> None:
    port = plug(machine, "ttyUSB0", {"idVendor": "1a86", "idProduct": "7523"})
    assert identity_of(port, machine.root) is None
    assert find_port(port, None, machine.root) == port
    pull(machine, "ttyUSB0")
    assert find_port(port, None, machine.root) is None


def test_a_port_named_by_a_link_is_looked_up_under_the_link(machine: Machine) -> None:
    port = plug(machine, "ttyUSB0", FTDI)
    by_id = machine.root / "dev/serial/by-id/usb-FTDI"
    by_id.parent.mkdir(parents=True)
    by_id.symlink_to(port)
    assert identity_of(str(by_id), machine.root) is None
    assert find_port(str(by_id), None, machine.root) == str(by_id)


def test_a_port_of_the_board_has_no_identity(machine: Machine) -> None:
    machine.uart("ttyS0")
    assert identity_of(str(machine.root / "dev/ttyS0"), machine.root) is None
