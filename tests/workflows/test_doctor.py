"""What `doctor` says of machines that lack something."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core.local_ports import LocalSerialPort, PortTrouble
from mbtool.workflows import doctor
from mbtool.workflows.doctor import CheckState, Screen

if TYPE_CHECKING:
    from pathlib import Path

SCREEN = Screen(is_terminal=True, columns=80, rows=24, encoding="utf-8")


def checks(
    *ports: LocalSerialPort, capture: PortTrouble | None = None
) -> dict[str, doctor.MachineCheck]:
    return {one.name: one for one in doctor.machine_checks(ports, capture, SCREEN)}


def test_python_and_packages_are_found_here() -> None:
    found = checks()
    assert found["Python"].state is CheckState.OK
    assert sys.executable in found["Python"].found
    assert found["packages"].state is CheckState.OK


def test_an_old_python_is_broken() -> None:
    assert doctor.python_check((3, 10, 4)).state is CheckState.BROKEN


def test_a_missing_extra_comes_with_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "EXTRAS", {"watch": ("no_such_module",)})
    wanted = ["rich>=13", "textual<9,>=8.2; extra == 'watch'", "pyarrow; extra == 'columns'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda _: wanted)
    found = checks()["extra watch"]
    assert found.state is CheckState.MISSING
    assert found.remedy.endswith(" 'textual<9,>=8.2'")


def test_a_missing_package_is_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_NEEDED", ("msgspec", "no_such_module"))
    found = checks()["packages"]
    assert (found.state, found.found) == (CheckState.BROKEN, "no_such_module cannot be imported")


@pytest.mark.parametrize(
    ("usb_id", "state"), [("0403:6001", CheckState.BROKEN), (None, CheckState.MISSING)]
)
def test_an_obstacle_of_a_port_has_its_command(usb_id: str | None, state: CheckState) -> None:
    port = LocalSerialPort(
        device="/dev/ttyUSB0",
        usb_id=usb_id,
        troubles=(PortTrouble("its timer is 16 ms", "echo 1"),),
    )
    found = checks(port)["port ttyUSB0"]
    assert (found.state, found.found, found.remedy) == (state, "its timer is 16 ms", "echo 1")


@pytest.mark.skipif(sys.platform != "linux", reason="usbmon is of Linux")
def test_a_usb_port_says_how_its_traffic_can_be_captured(tmp_path: Path) -> None:
    adapter = LocalSerialPort(device="/dev/ttyUSB0", usb_id="0403:6001")
    assert "USB capture" in checks(adapter)
    assert "USB capture" not in checks(LocalSerialPort(device="/dev/ttyS0"))
    lacking = doctor.usb_capture_check(str(tmp_path / "usbmon0"))
    assert lacking.state is CheckState.MISSING
    assert lacking.remedy.startswith("sudo modprobe usbmon; sudo dumpcap ")
    (tmp_path / "usbmon0").touch()
    there = doctor.usb_capture_check(str(tmp_path / "usbmon0"))
    assert (there.state, there.remedy) == (CheckState.OK, "")


def test_a_port_without_an_obstacle_is_ready_as_its_link() -> None:
    found = checks(LocalSerialPort(device="/dev/ttyUSB0"))["port ttyUSB0"]
    assert found.found == "ready as rtu:/dev/ttyUSB0@19200-8E1"


def test_a_capture_that_is_not_permitted_has_its_command() -> None:
    found = checks(capture=PortTrouble("needs a capability", "sudo mbtool"))["capture"]
    assert (found.state, found.remedy) == (CheckState.MISSING, "sudo mbtool")
    assert checks()["capture"].state is CheckState.OK


@pytest.mark.skipif(sys.platform == "win32", reason="programs of Windows have other names")
def test_a_wireshark_that_does_not_list_serial_lines_has_its_command(tmp_path: Path) -> None:
    program = tmp_path / "wireshark"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    home = {"HOME": str(tmp_path)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(tmp_path))
        assert doctor.wireshark_check(home).remedy == "mbtool extcap --install"
        script = tmp_path / ".config" / "wireshark" / "extcap" / "mbtool-extcap"
        script.parent.mkdir(parents=True)
        script.write_text("")
        assert doctor.wireshark_check(home).state is CheckState.OK
        assert doctor.wireshark_check({}).state is CheckState.MISSING
        patch.setenv("PATH", os.devnull)
        assert doctor.wireshark_check(home).state is CheckState.OK


@pytest.mark.parametrize(
    ("screen", "state"),
    [
        (SCREEN, CheckState.OK),
        (Screen(True, 60, 24, "utf-8"), CheckState.MISSING),
        (Screen(True, 200, 10, "utf-8"), CheckState.MISSING),
        (Screen(True, 80, 24, "ascii"), CheckState.MISSING),
        (Screen(False, 20, 5, "ascii"), CheckState.OK),
    ],
)
def test_a_terminal_should_have_80_columns_24_rows_and_unicode(
    screen: Screen, state: CheckState
) -> None:
    assert doctor.terminal_check(screen).state is state
