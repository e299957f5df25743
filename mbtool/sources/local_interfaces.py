"""The network interfaces of this machine, and whether a capture on them is permitted."""

# On Linux all is read from /sys/class/net, and what is permitted is asked of the kernel; elsewhere
# there are the names alone.
#
#     NAME/flags      1H is IFF_UP
#     NAME/carrier    1 with something at the other end of the cable; unreadable while it is down
#     NAME/type       ARPHRD_ of linux/if_arp.h
#     NAME/uevent     DEVTYPE= says what it is, of what is more than Ethernet
#     NAME/device     leads to the hardware

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

from mbtool.core.local_ports import LocalInterface, Trouble
from mbtool.sources.interface import capture_trouble, hardware_trouble

_IFF_UP = 1
_ETHERNET = 1
_KINDS = {
    280: "CAN",
    512: "PPP",
    768: "tunnel",
    769: "tunnel",
    772: "loopback",
    776: "tunnel",
    65534: "tunnel",
}
"""ARPHRD_ of linux/if_arp.h."""
_DEVICE_TYPES = {"wlan": "Wi-Fi", "vlan": "VLAN", "gadget": "USB gadget", "wwan": "mobile"}
"""The kernel's words that are not a reader's."""


def local_interfaces(root: Path = Path("/")) -> list[LocalInterface]:
    """All interfaces, in the order of their names.

    `root` is where the system's files are, for Linux alone.
    """
    trouble = capture_trouble()
    if sys.platform != "linux":
        return interfaces_by_name(trouble)
    folder = root / "sys/class/net"
    try:
        names = sorted(os.listdir(folder))
    except OSError:
        return []
    # A driver can put files of its own beside the interfaces: bonding_masters.
    return [_interface(folder / name, trouble) for name in names if (folder / name).is_dir()]


def interfaces_by_name(trouble: Trouble | None) -> list[LocalInterface]:
    """What any system tells."""
    troubles = () if trouble is None else (trouble,)
    return [LocalInterface(name=name, troubles=troubles) for _, name in socket.if_nameindex()]


def _interface(path: Path, trouble: Trouble | None) -> LocalInterface:
    hardware = _number(path / "type", 10)
    is_up = bool((_number(path / "flags", 16) or 0) & _IFF_UP)
    carrier = _number(path / "carrier", 10) if is_up else None
    unreadable = None if hardware is None else hardware_trouble(hardware)
    return LocalInterface(
        name=path.name,
        description=_description(path, hardware),
        is_up=is_up,
        has_carrier=None if carrier is None else carrier == 1,
        troubles=tuple(one for one in (unreadable, trouble) if one is not None),
    )


def _description(path: Path, hardware: int | None) -> str:
    for line in _text(path / "uevent").splitlines():
        key, _, value = line.partition("=")
        if key == "DEVTYPE":
            return _DEVICE_TYPES.get(value, value)
    if hardware == _ETHERNET:
        return "Ethernet" if (path / "device").exists() else "virtual Ethernet"
    return "" if hardware is None else _KINDS.get(hardware, f"hardware type {hardware}")


def _number(path: Path, base: int) -> int | None:
    try:
        return int(_text(path), base)
    except ValueError:
        return None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
