"""Finds a serial port again after it was unplugged, under whatever name it comes back."""

# A USB adapter that is unplugged while it is open comes back as /dev/ttyUSB1, not ttyUSB0. On Linux
# its serial number tells it from others; an adapter with several ports has a USB interface for
# each. A path that is a symbolic link (/dev/serial/by-id/...) is looked up again. A port that is
# neither, or an adapter without a serial number, is expected under its path.
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
    """What tells the adapter behind a port from all others."""

    usb_id: str
    serial_number: str
    interface: str
    """The number of the USB interface; an adapter with several ports has several."""


def identity_of(path: str, root: Path = _ROOT) -> PortIdentity | None:
    """The identity of the adapter behind a port; None if it has none, or is named by a link.

    `root` is the folder that holds /sys.
    """
    if sys.platform != "linux" or os.path.islink(path):
        return None
    return _identity(root / "sys/class/tty" / os.path.basename(path))


def find_port(path: str, identity: PortIdentity | None, root: Path = _ROOT) -> str | None:
    """The path of a port that was named `path` when it was opened; None if it is not there.

    `root` is the folder that holds /sys and /dev.
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
