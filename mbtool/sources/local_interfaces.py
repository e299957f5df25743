"""Lists the network interfaces of this machine, and what prevents capturing from each."""

# On Linux all facts come from /sys/class/net, and the kernel says whether capturing is permitted.
# Other systems give only the names.
#
#     NAME/flags      bit 1H is IFF_UP
#     NAME/carrier    1 if the cable is connected at both ends; unreadable while the interface is
#                     down
#     NAME/type       ARPHRD_ of linux/if_arp.h
#     NAME/uevent     DEVTYPE= names the kind of an interface that is not plain Ethernet
#     NAME/device     leads to the hardware

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

from mbtool.core.local_ports import LocalInterface, PortTrouble
from mbtool.ports.local_ports import read_number, read_text
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
"""Names for the user of hardware types other than Ethernet (ARPHRD_ of linux/if_arp.h)."""
_DEVICE_TYPES = {"wlan": "Wi-Fi", "vlan": "VLAN", "gadget": "USB gadget", "wwan": "mobile"}
"""Names for the user of the kinds of interfaces that the file uevent gives as DEVTYPE=."""


def local_interfaces(root: Path = Path("/")) -> list[LocalInterface]:
    """Return all interfaces, in the order of their names.

    `root` is the folder that contains /sys; only Linux uses it.
    """
    trouble = capture_trouble()
    if sys.platform != "linux":
        return interfaces_by_name(trouble)
    folder = root / "sys/class/net"
    try:
        names = sorted(os.listdir(folder))
    except OSError:
        return []
    # Only the folders are interfaces; drivers put files here, too, such as bonding_masters.
    return [_interface(folder / name, trouble) for name in names if (folder / name).is_dir()]


def interfaces_by_name(trouble: PortTrouble | None) -> list[LocalInterface]:
    """Return all interfaces by name only, which works on any system.

    `trouble` is the reason why this process cannot capture at all; None if it can.
    """
    troubles = () if trouble is None else (trouble,)
    return [LocalInterface(name=name, troubles=troubles) for _, name in socket.if_nameindex()]


def _interface(path: Path, trouble: PortTrouble | None) -> LocalInterface:
    hardware = read_number(path / "type")
    is_up = bool((read_number(path / "flags") or 0) & _IFF_UP)
    carrier = read_number(path / "carrier") if is_up else None
    unreadable = None if hardware is None else hardware_trouble(hardware)
    return LocalInterface(
        name=path.name,
        description=_description(path, hardware),
        is_up=is_up,
        has_carrier=None if carrier is None else carrier == 1,
        troubles=tuple(one for one in (unreadable, trouble) if one is not None),
    )


def _description(path: Path, hardware: int | None) -> str:
    for line in read_text(path / "uevent").splitlines():
        key, _, value = line.partition("=")
        if key == "DEVTYPE":
            return _DEVICE_TYPES.get(value, value)
    if hardware == _ETHERNET:
        return "Ethernet" if (path / "device").exists() else "virtual Ethernet"
    return "" if hardware is None else _KINDS.get(hardware, f"hardware type {hardware}")
