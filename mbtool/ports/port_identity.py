"""Finds a serial port again after it was unplugged, under whatever name it comes back."""

# A USB adapter that is unplugged while its port is open comes back as /dev/ttyUSB1, not ttyUSB0. On
# Linux its serial number identifies it; an adapter with several ports has a USB interface for each.
# A path that is a symbolic link (/dev/serial/by-id/...) is resolved again. Any other port, and an
# adapter without a serial number, is expected under its old path.
#
#     /sys/class/tty/NAME/device      leads to the hardware
#     .../idVendor, idProduct, serial of the USB device above it
#     .../bInterfaceNumber            of the USB interface above it

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from mbtool.ports.system_files import read_line

_ROOT = Path("/")


@dataclass(frozen=True, slots=True)
class PortIdentity:
    """The facts that tell the USB adapter behind a port from all other adapters."""

    usb_id: str
    serial_number: str
    interface: str
    """The number of the port's USB interface in the adapter, such as "00"; each port of an adapter
    has its own."""


def identity_of(path: str, root: Path = _ROOT) -> PortIdentity | None:
    """Return the identity of the USB adapter behind a port.

    Returns None if `path` is a symbolic link, if the port has no USB adapter with a serial number,
    and on other systems than Linux.

    `root` is the folder that contains /sys.
    """
    if sys.platform != "linux" or os.path.islink(path):
        return None
    return _identity(root / "sys/class/tty" / os.path.basename(path))


def find_port(path: str, identity: PortIdentity | None, root: Path = _ROOT) -> str | None:
    """Find the present path of the port that had the path `path` before; None if it is not there.

    If `identity` is None, the port is expected under its old path. `root` is the folder that
    contains /sys and /dev.
    """
    if identity is None:
        return path if os.path.exists(path) else None
    folder = root / "sys/class/tty"
    try:
        names = sorted(os.listdir(folder))
    except OSError:
        return None
    for name in names:
        device = root / "dev" / name
        if _identity(folder / name) == identity and device.exists():
            return str(device)
    return None


def _identity(tty: Path) -> PortIdentity | None:
    hardware = Path(os.path.realpath(tty / "device"))
    interface = ""
    for device in (hardware, *hardware.parents):
        interface = interface or read_line(device / "bInterfaceNumber")
        vendor = read_line(device / "idVendor")
        if vendor:
            serial = read_line(device / "serial")
            usb_id = f"{vendor}:{read_line(device / 'idProduct')}"
            return PortIdentity(usb_id, serial, interface) if serial else None
    return None
