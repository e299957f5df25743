"""The interfaces of a machine made of files, and of this one."""

from __future__ import annotations

import socket
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core.local_ports import LocalInterface, PortTrouble
from mbtool.sources import local_interfaces as module
from mbtool.sources.interface import capture_trouble
from mbtool.sources.local_interfaces import interfaces_by_name, local_interfaces
from tests.sources.machine import Machine

if TYPE_CHECKING:
    from pathlib import Path

if sys.platform != "linux":
    pytest.skip("what there is below /sys is Linux's", allow_module_level=True)

FORBIDDEN = PortTrouble("listening needs the capability cap_net_raw", "sudo setcap")


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """A machine whose interfaces one may listen to."""
    monkeypatch.setattr(module, "capture_trouble", lambda: None)
    return Machine(tmp_path)


def add(machine: Machine, name: str, **files: object) -> None:
    machine.write(
        {"type": 1, "uevent": f"INTERFACE={name}", **files}, below=f"sys/class/net/{name}"
    )


def test_each_interface_is_told_by_what_it_is_and_how_it_is(machine: Machine) -> None:
    add(machine, "lo", type=772, flags="0x9", carrier=1)
    add(machine, "eth0", flags="0x1003", carrier=1)
    add(machine, "eth1", flags="0x1003", carrier=0)
    add(machine, "eth2", flags="0x1002", carrier=1)
    for number in range(3):
        machine.link(f"sys/class/net/eth{number}/device", "sys/devices/pci/card")
    add(machine, "veth0", flags="0x1003")
    add(machine, "wlan0", flags="0x1003", carrier=1, uevent="DEVTYPE=wlan\nINTERFACE=wlan0")
    add(machine, "br0", flags="0x1003", carrier=1, uevent="DEVTYPE=bridge")
    add(machine, "tun0", type=65534, flags="0x1001")
    machine.write({"bonding_masters": "bond0"}, below="sys/class/net")
    told = [
        (one.name, one.description, one.is_up, one.has_carrier)
        for one in local_interfaces(machine.root)
    ]
    assert told == [
        ("br0", "bridge", True, True),
        ("eth0", "Ethernet", True, True),
        ("eth1", "Ethernet", True, False),
        ("eth2", "Ethernet", False, None),
        ("lo", "loopback", True, True),
        ("tun0", "tunnel", True, None),
        ("veth0", "virtual Ethernet", True, None),
        ("wlan0", "Wi-Fi", True, True),
    ]
    assert all(one.may_capture for one in local_interfaces(machine.root))


def test_an_interface_that_cannot_be_read_says_so(machine: Machine) -> None:
    add(machine, "can0", type=280, flags="0x1")
    add(machine, "odd0", type=999, flags="0x1")
    can, odd = local_interfaces(machine.root)
    assert (can.description, odd.description) == ("CAN", "hardware type 999")
    assert not can.may_capture
    assert can.troubles[0].problem.startswith("its hardware type 280 is not one that can be read")


def test_a_missing_privilege_is_every_interfaces_trouble(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "capture_trouble", lambda: FORBIDDEN)
    add(machine, "eth0", flags="0x1003")
    add(machine, "eth1")
    assert [one.troubles for one in local_interfaces(machine.root)] == [(FORBIDDEN,)] * 2


def test_a_machine_without_interfaces_has_none(tmp_path: Path) -> None:
    assert local_interfaces(tmp_path) == []


def test_elsewhere_there_are_names_and_no_capture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo0"), (2, "en0")])
    trouble = capture_trouble()
    assert trouble is not None
    assert "needs Linux" in trouble.problem
    expected = [LocalInterface(name=name, troubles=(trouble,)) for name in ("lo0", "en0")]
    assert local_interfaces() == expected
    assert interfaces_by_name(None) == [LocalInterface(name="lo0"), LocalInterface(name="en0")]


def test_the_interfaces_of_this_machine_are_those_that_the_system_names() -> None:
    names = [one.name for one in local_interfaces()]
    assert names == sorted(name for _, name in socket.if_nameindex())
    assert all(
        one.may_capture == (capture_trouble() is None)
        for one in local_interfaces()
        if one.name == "lo"
    )
