"""Lists the serial ports of this machine, with what may disturb a capture on each."""

# No port is opened, as opening can make an adapter raise DTR and RTS and send on the line. On Linux
# all facts come from /sys, /proc and /dev; on other systems from pyserial.
#
#     /sys/class/tty/NAME/device          leads to the hardware; pseudo-terminals have none
#                  .../type               0 if the driver expected a UART and found none
#                  .../flags              of a UART; bit 2000H is ASYNC_LOW_LATENCY
#                  .../rx_trig_bytes      of a 16550 UART: it hands over so many bytes at once, and
#                                         fewer only after a silence of four characters
#                  .../device/latency_timer   of ftdi_sio, in ms; 1 while low latency is on
#     /sys/class/tty/console/active       the ports that the kernel writes its messages to
#     /dev/serial/by-id, by-path          symbolic links by udev, named after the adapter, or after
#                                         the USB socket that the adapter is in

from __future__ import annotations

import os
import re
import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from mbtool.core.local_ports import Holder, LocalSerialPort, PortTrouble
from mbtool.ports.serial_port import who_may

# The code below reads the small files of /sys and /proc. A file that cannot be read is taken as
# empty.


def read_text(path: Path) -> str:
    """Return the whole text of a file; "" if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def read_line(path: Path) -> str:
    """The first line of a file, without white space around it; "" if it cannot be read."""
    return read_text(path).partition("\n")[0].strip()


def read_number(path: Path) -> int | None:
    """The number in the first line of a file, decimal or 0x...; None if there is none."""
    try:
        return int(read_line(path), 0)
    except ValueError:
        return None


_SERIAL_CORE = "serial-base"
"""The name of a bus in /sys. Since Linux 6.5 it has devices between a port and the port's hardware;
the search for the hardware's driver skips them."""
_ASYNC_LOW_LATENCY = 0x2000
_WITHOUT_LOW_LATENCY = {"cdc_acm", "ch341", "ch341-uart", "cp210x", "pl2303", "xr_serial"}
"""Linux drivers that ignore the low-latency flag."""

_SERVICES = {
    "agetty": "sudo systemctl stop serial-getty@{name}",
    "ModemManager": "sudo systemctl stop ModemManager",
    "gpsd": "sudo systemctl stop gpsd.socket gpsd",
}
"""Services that open serial ports, each with the command that stops it. If such a service is killed
instead, it starts again."""


def local_ports(root: Path = Path("/")) -> list[LocalSerialPort]:
    """Return all serial ports that have hardware, in the order of their names.

    `root` is the folder that contains /sys, /proc and /dev; only Linux uses it.
    """
    if sys.platform != "linux":
        return ports_by_pyserial()
    names = sorted(_names(root / "sys/class/tty"), key=_natural)
    holders, unseen = holders_of([f"/dev/{name}" for name in names], root)
    scan = _Scan(
        root, _stable_names(root), read_line(root / "sys/class/tty/console/active").split(), unseen
    )
    return [scan.port(name, tuple(holders[f"/dev/{name}"])) for name in names]


def ports_by_pyserial() -> list[LocalSerialPort]:
    """Return the serial ports as pyserial lists them, which works on any system."""
    return [
        LocalSerialPort(
            device=info.device,
            description="" if info.description in (None, "n/a") else info.description,
            usb_id=None if info.vid is None else f"{info.vid:04x}:{info.pid or 0:04x}",
            serial_number=info.serial_number or None,
        )
        for info in sorted(list_ports.comports(), key=lambda info: _natural(info.device))
    ]


@dataclass(frozen=True, slots=True)
class _Scan:
    """Facts about the whole machine, found once and used to describe each port."""

    root: Path
    stable: dict[str, str]
    consoles: list[str]
    unseen: int

    def port(self, name: str, holders: tuple[Holder, ...]) -> LocalSerialPort:
        tty = self.root / "sys/class/tty" / name
        hardware = Path(os.path.realpath(tty / "device"))
        usb = _usb_device(hardware)
        driver, bus = _driver(hardware)
        timer = read_number(tty / "device/latency_timer")
        fifo = read_number(tty / "rx_trig_bytes")
        low_latency, support = _low_latency(timer, read_number(tty / "flags"), driver)
        return LocalSerialPort(
            device=f"/dev/{name}",
            stable=self.stable.get(name),
            description=_product(usb) if usb else (f"port on the {bus} bus" if bus else ""),
            usb_id=f"{read_line(usb / 'idVendor')}:{read_line(usb / 'idProduct')}" if usb else None,
            serial_number=(read_line(usb / "serial") or None) if usb else None,
            driver=driver,
            latency_timer_ms=timer,
            fifo_bytes=fifo,
            low_latency=low_latency,
            low_latency_support=support,
            holders=holders,
            unseen_processes=self.unseen,
            troubles=(
                *_permission(self.root / "dev" / name, name),
                *(_held_trouble(holder, name) for holder in holders),
                *_console(name, self.consoles),
                *_latency_timer(timer, name),
                *_fifo(fifo, name),
            ),
        )


def _names(folder: Path) -> list[str]:
    try:
        names = os.listdir(folder)
    except OSError:
        return []
    return [
        name
        for name in names
        if (folder / name / "device").exists() and read_number(folder / name / "type") != 0
    ]


def _stable_names(root: Path) -> dict[str, str]:
    """Return the path of udev's symbolic link for each port, by the port's name (ttyUSB0).

    A link named after the adapter is preferred to one named after the USB socket. Two adapters of
    one type without serial numbers have the same name, so only one of them gets such a link.
    """
    found: dict[str, str] = {}
    for kind in ("by-path", "by-id"):
        folder = root / "dev/serial" / kind
        try:
            links = sorted(os.listdir(folder), reverse=True)
        except OSError:
            continue
        for link in links:
            if "," not in link:  # Not usable in a LINK, where a comma separates ports.
                target = os.path.basename(os.path.realpath(folder / link))
                found[target] = f"/dev/serial/{kind}/{link}"
    return found


def _driver(hardware: Path) -> tuple[str | None, str | None]:
    """Return the names of the driver and of the bus of a port's hardware.

    Both are None without a driver. `hardware` is the folder in /sys that describes the hardware.
    """
    for device in (hardware, *hardware.parents):
        bus = os.path.basename(os.path.realpath(device / "subsystem"))
        if (device / "driver").exists() and bus != _SERIAL_CORE:
            return os.path.basename(os.path.realpath(device / "driver")), bus
    return None, None


def _usb_device(hardware: Path) -> Path | None:
    for device in (hardware, *hardware.parents):
        if (device / "idVendor").exists():
            return device
    return None


def _product(usb: Path) -> str:
    maker, product = read_line(usb / "manufacturer"), read_line(usb / "product")
    if maker.lower() in product.lower():
        return product or "USB serial adapter"
    return f"{maker} {product}".rstrip()


def _low_latency(
    timer: int | None, flags: int | None, driver: str | None
) -> tuple[bool | None, bool | None]:
    """Return two values for a port: is low latency on, and can it be switched on? None is unknown.

    `timer` is the FTDI latency timer in ms, `flags` are the flags of a UART, and `driver` is the
    driver's name; each is None if the port has none or it is unknown.
    """
    if timer is not None:
        return timer <= 1, True
    if flags is not None:
        return bool(flags & _ASYNC_LOW_LATENCY), True
    return (False, False) if driver in _WITHOUT_LOW_LATENCY else (None, None)


def _permission(path: Path, name: str) -> list[PortTrouble]:
    try:
        os.stat(path)
    except FileNotFoundError:
        return [
            PortTrouble(
                f"the kernel has it, but there is no /dev/{name} here; is this a container?"
            )
        ]
    except OSError:
        pass  # os.access then says that there is no access.
    if os.access(path, os.R_OK | os.W_OK, effective_ids=os.access in os.supports_effective_ids):
        return []
    why = who_may(str(path))
    return [PortTrouble(f"permission denied; {why.problem}", why.remedy)]


def _held_trouble(holder: Holder, name: str) -> PortTrouble:
    return PortTrouble(
        f"held by {holder}: two readers of a port steal each other's bytes; end that program first",
        _SERVICES.get(holder.command, "").format(name=name),
    )


def _console(name: str, consoles: list[str]) -> list[PortTrouble]:
    if name not in consoles:
        return []
    return [
        PortTrouble(
            f"the kernel writes its messages to it; take console={name} off the kernel's command "
            "line and start the machine anew before a bus is connected"
        )
    ]


def _latency_timer(timer: int | None, name: str) -> list[PortTrouble]:
    if timer is None or timer <= 1:
        return []
    return [
        PortTrouble(
            f"FTDI latency timer {timer} ms: frames arrive glued; mbtool sets it to 1 ms when it "
            "opens the port, for other programs set it yourself",
            f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{name}/latency_timer",
        )
    ]


def _fifo(fifo: int | None, name: str) -> list[PortTrouble]:
    if fifo is None or fifo <= 1:
        return []
    return [
        PortTrouble(
            f"its FIFO hands over {fifo} bytes at once, and fewer only after 4 characters of "
            "silence: ends of frames are timed late",
            f"echo 1 | sudo tee /sys/class/tty/{name}/rx_trig_bytes",
        )
    ]


def _natural(name: str) -> list[tuple[str, int]]:
    """Return a key for sorting that puts ttyS2 before ttyS10."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D+)(\d*)", name)]


# The code below finds a serial port again after it was unplugged, under whatever name it comes
# back.
#
# A USB adapter that is unplugged while its port is open comes back as /dev/ttyUSB1, not ttyUSB0. On
# Linux its serial number identifies it; an adapter with several ports has a USB interface for each.
# A path that is a symbolic link (/dev/serial/by-id/...) is resolved again. Any other port, and an
# adapter without a serial number, is expected under its old path.
#
#     /sys/class/tty/NAME/device      leads to the hardware
#     .../idVendor, idProduct, serial of the USB device above it
#     .../bInterfaceNumber            of the USB interface above it

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


# The code below finds the processes that have a serial port open. Linux only.
#
# /proc/PID/fd has a link for each open file. Only folders below /proc are opened, never a port, as
# opening a port could change its control lines. Only root can look into the processes of other
# users; the processes that cannot be looked into are counted.


def holders_of(devices: Collection[str], root: Path) -> tuple[dict[str, list[Holder]], int]:
    """Return the processes that have each port open, and the number of processes that may not be
    inspected.

    `devices` are the paths of the ports, such as /dev/ttyUSB0; they become the keys of the returned
    dictionary. `root` is the folder that contains /proc.
    """
    found: dict[str, list[Holder]] = {device: [] for device in devices}
    unseen = 0
    for process in _processes(root / "proc"):
        try:
            held = set(_open_files(process)) & found.keys()
        except PermissionError:
            unseen += not _is_of_the_kernel(process)
            continue
        except OSError:  # The process has ended.
            continue
        for device in held:
            found[device].append(Holder(int(process.name), _command(process)))
    for holders in found.values():
        holders.sort(key=lambda holder: holder.pid)
    return found, unseen


def _processes(proc: Path) -> Iterator[Path]:
    try:
        names = os.listdir(proc)
    except OSError:
        return
    yield from (proc / name for name in names if name.isdecimal())


def _open_files(process: Path) -> Iterator[str]:
    folder = process / "fd"
    for name in os.listdir(folder):
        try:
            yield os.readlink(folder / name)
        except FileNotFoundError:  # The process has closed the file.
            continue


def _is_of_the_kernel(process: Path) -> bool:
    """True if a process is a kernel thread or has ended: neither has a command line."""
    try:
        return not (process / "cmdline").read_bytes()
    except PermissionError:
        return False
    except OSError:
        return True


def _command(process: Path) -> str:
    try:
        return (process / "comm").read_text(errors="replace").strip()
    except OSError:
        return "process"
