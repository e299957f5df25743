"""Checks if this machine has everything that mbtool needs, and names commands that repair it."""

# Nothing is opened, started or changed, except for a packet socket that is closed at once. A check
# ends with one of three states:
#
#     OK        the checked thing is there, or nothing needs it
#     MISSING   an extra, a permission or a setting is missing; the rest of mbtool works without it
#     BROKEN    mbtool, or a device connected to this machine, does not work until it is repaired

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from typing import TYPE_CHECKING

from mbtool.core import UsageError
from mbtool.core.extras import installer, requirements
from mbtool.workflows.extcap_install import scripts

if TYPE_CHECKING:
    from mbtool.core.local_ports import LocalSerialPort, PortTrouble

OLDEST_PYTHON = (3, 11)
SMALLEST_TERMINAL = (80, 24)
"""The size for which tables and the screen of `mbtool watch` are made, in columns and rows."""
_NEEDED = ("fastcrc", "mcap", "msgspec", "numpy", "serial", "rich", "scapy", "typer", "zstandard")
EXTRAS: Mapping[str, tuple[str, ...]] = {
    "watch": ("textual",),
    "columns": ("pyarrow",),
    "cluster": ("pyarrow", "dask", "distributed"),
    "plot": ("matplotlib",),
    "pytest": ("pytest",),
    "tls": ("cryptography",),
    "yaml": ("yaml",),
}
"""For each optional extra of the package, the modules that it installs."""
_FOR = {
    "watch": "mbtool watch",
    "columns": "Parquet and Arrow",
    "cluster": "decode --cluster",
    "plot": "pictures of mbtool plot",
    "pytest": "fixtures for tests",
    "tls": "role from TLS certificates",
    "yaml": "devices import --home-assistant",
}


USBMON = "/dev/usbmon0"


class CheckState(StrEnum):
    """The result of a check: OK, MISSING (mbtool works without it) or BROKEN (to be repaired)."""

    OK = "ok"
    MISSING = "missing"
    BROKEN = "broken"


@dataclass(frozen=True, slots=True)
class MachineCheck:
    """The result of checking one thing that mbtool needs."""

    name: str
    state: CheckState
    found: str
    """A line for the user that says what the check found."""
    remedy: str = ""
    """A command or an advice that repairs what is missing; mbtool never runs it. Empty if there is
    none."""


@dataclass(frozen=True, slots=True)
class Screen:
    """The facts known about the terminal to which standard output goes."""

    is_terminal: bool
    columns: int
    rows: int
    encoding: str


def machine_checks(
    ports: Iterable[LocalSerialPort], capture: PortTrouble | None, screen: Screen
) -> Iterator[MachineCheck]:
    """Run all checks, and yield the results in the order in which `mbtool doctor` shows them.

    `capture` is the reason why network interfaces cannot be captured, None if they can.
    """
    yield python_check(sys.version_info[:3])
    yield from _packages()
    here = list(ports)
    yield from port_checks(here)
    yield from _port_group()
    if sys.platform == "linux" and any(port.usb_id is not None for port in here):
        yield usb_capture_check()
    yield _priority()
    yield capture_check(capture)
    yield wireshark_check(os.environ)
    yield terminal_check(screen)


def python_check(version: tuple[int, int, int]) -> MachineCheck:
    text = f"{platform.python_implementation()} {'.'.join(map(str, version))}, {sys.executable}"
    if version[:2] >= OLDEST_PYTHON:
        return MachineCheck("Python", CheckState.OK, text)
    remedy = "install Python 3.11 or later, and mbtool into it"
    return MachineCheck("Python", CheckState.BROKEN, text, remedy)


def _packages() -> Iterator[MachineCheck]:
    missing = [name for name in _NEEDED if not _is_there(name)]
    if missing:
        found = f"{', '.join(missing)} cannot be imported"
        yield MachineCheck("packages", CheckState.BROKEN, found, installer("mbtool"))
    else:
        yield MachineCheck("packages", CheckState.OK, "all that mbtool needs")
    for extra, modules in EXTRAS.items():
        name = f"extra {extra}"
        if all(map(_is_there, modules)):
            yield MachineCheck(name, CheckState.OK, f"for {_FOR[extra]}")
        else:
            remedy = installer(*requirements(extra))
            yield MachineCheck(name, CheckState.MISSING, f"without it: no {_FOR[extra]}", remedy)


def _is_there(module: str) -> bool:
    return find_spec(module) is not None


def port_checks(ports: list[LocalSerialPort]) -> Iterator[MachineCheck]:
    """Yield a check for each port without trouble, and one for each trouble of the others.

    A trouble of a USB adapter counts as BROKEN, since an adapter is there to be used. One of a
    built-in port counts as MISSING, since such a port is often not connected to anything.
    """
    if not ports:
        found = "none here; mbtool line lays a virtual line"
        yield MachineCheck("serial ports", CheckState.OK, found)
    for port in ports:
        name = f"port {port.name}"
        if not port.troubles:
            yield MachineCheck(name, CheckState.OK, f"ready as {port.link}")
        state = CheckState.MISSING if port.usb_id is None else CheckState.BROKEN
        for trouble in port.troubles:
            yield MachineCheck(name, state, trouble.problem, trouble.remedy)


def _port_group() -> Iterator[MachineCheck]:
    """Yield the check whether the user may open serial ports, which on Debian means being in the
    group dialout. Yield nothing on systems without that group.
    """
    if sys.platform != "linux":
        return
    import grp

    try:
        group = grp.getgrnam("dialout")
    except KeyError:
        return
    if os.geteuid() == 0 or group.gr_gid in os.getgroups():
        yield MachineCheck("group dialout", CheckState.OK, "adapters may be opened")
        return
    remedy = "sudo usermod -aG dialout $USER, then log in again"
    found = "you are not in it, so most adapters do not open"
    yield MachineCheck("group dialout", CheckState.MISSING, found, remedy)


def usb_capture_check(device: str = USBMON) -> MachineCheck:
    """Check if the traffic of USB adapters can be captured, which hears a port that another program
    has open. `device` is the file of usbmon for all buses.
    """
    name, pipe = "USB capture", "dumpcap -i usbmon0 -w - | mbtool decode -"
    if os.access(device, os.R_OK):
        return MachineCheck(name, CheckState.OK, f"{pipe} hears a port that a program has open")
    if os.path.exists(device):
        found = f"{device} may not be read, so that a port that a program has open is not heard"
        return MachineCheck(name, CheckState.MISSING, found, f"sudo {pipe}")
    found = "usbmon is not loaded; it hears a port that another program has open"
    return MachineCheck(name, CheckState.MISSING, found, f"sudo modprobe usbmon; sudo {pipe}")


def _priority() -> MachineCheck:
    """Check if mbtool may get a real-time priority, which keeps the times of serial bytes exact on
    a busy machine.
    """
    name = "real-time priority"
    if sys.platform != "linux":
        return MachineCheck(name, CheckState.OK, "only used on Linux")
    import resource

    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if os.geteuid() == 0 or limit:
        return MachineCheck(name, CheckState.OK, "times of serial bytes stay exact under load")
    remedy = (
        "echo '@dialout - rtprio 1' | sudo tee /etc/security/limits.d/mbtool.conf, "
        "then log in again"
    )
    found = "not permitted; on a busy machine times of serial bytes are some ms late"
    return MachineCheck(name, CheckState.MISSING, found, remedy)


def capture_check(trouble: PortTrouble | None) -> MachineCheck:
    if trouble is None:
        return MachineCheck("capture", CheckState.OK, "net: links may be opened")
    return MachineCheck("capture", CheckState.MISSING, trouble.problem, trouble.remedy)


def wireshark_check(environment: Mapping[str, str]) -> MachineCheck:
    """Check if Wireshark, where it is installed, offers serial lines: it does if the scripts of
    `mbtool extcap --install` exist. `environment` has the environment variables, which say where
    they belong.
    """
    name = "Wireshark"
    program = shutil.which("wireshark") or shutil.which("tshark")
    if program is None:
        return MachineCheck(name, CheckState.OK, "not here; files for it can be made all the same")
    try:
        found = [path for path in scripts(environment) if path.exists()]
    except UsageError as error:
        return MachineCheck(name, CheckState.MISSING, str(error))
    if found:
        return MachineCheck(name, CheckState.OK, f"finds serial lines by {found[0]}")
    missing = f"{program} does not list serial lines"
    return MachineCheck(name, CheckState.MISSING, missing, "mbtool extcap --install")


def terminal_check(screen: Screen) -> MachineCheck:
    """Check if the terminal is large enough, and can show UTF-8."""
    name = "terminal"
    if not screen.is_terminal:
        return MachineCheck(name, CheckState.OK, "output goes to a pipe or file")
    size = f"{screen.columns}x{screen.rows}, {screen.encoding}"
    if "utf" not in screen.encoding.lower():
        found = f"{size}: characters that it lacks are shown as codes"
        return MachineCheck(name, CheckState.MISSING, found, "export LANG=C.UTF-8")
    if (screen.columns, screen.rows) < SMALLEST_TERMINAL or screen.rows < SMALLEST_TERMINAL[1]:
        found = f"{size}: tables and watch are made for 80x24 and more"
        return MachineCheck(name, CheckState.MISSING, found, "make the window larger")
    return MachineCheck(name, CheckState.OK, size)
