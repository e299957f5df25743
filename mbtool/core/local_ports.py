"""The serial ports and network interfaces of this machine, and obstacles to opening them."""

# These classes only hold facts that the packages mbtool.ports and mbtool.sources find out. A fact
# that cannot be found out is None.

from __future__ import annotations

from dataclasses import dataclass

from mbtool.core.link_spec import InterfaceLink, SerialLink
from mbtool.core.serial_format import SerialFormat


@dataclass(frozen=True, slots=True)
class PortTrouble:
    """An obstacle to opening a serial port or a network interface."""

    problem: str
    remedy: str = ""
    """A command that solves the problem, for the user; "" if there is none. This program never runs
    it itself."""

    def __str__(self) -> str:
        return f"{self.problem}: {self.remedy}" if self.remedy else self.problem


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a port open."""

    pid: int
    command: str

    def __str__(self) -> str:
        return f"{self.command} ({self.pid})"


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalSerialPort:
    """A serial port of this machine that has hardware, so no pseudo-terminal."""

    device: str
    """The name by which the port is opened, for example /dev/ttyUSB0."""
    stable: str | None = None
    """Another path of the port, which stays the same when its adapter is plugged in elsewhere or in
    another order; None if there is none."""
    description: str = ""
    usb_id: str | None = None
    """The ids of the USB adapter's vendor and product, for example 0403:6001; None without one."""
    serial_number: str | None = None
    driver: str | None = None
    latency_timer_ms: int | None = None
    """The FTDI latency timer: the longest time in ms that the adapter waits for more bytes before
    it delivers those it has; None for an adapter without such a timer."""
    fifo_bytes: int | None = None
    """The number of bytes that the port's UART collects before the driver gets them; None for a
    port without such a setting, such as a USB adapter."""
    low_latency: bool | None = None
    """True if the driver delivers each byte at once, False if it collects bytes; None if
    unknown."""
    low_latency_support: bool | None = None
    holders: tuple[Holder, ...] = ()
    unseen_processes: int = 0
    """The number of processes that this user may not inspect; one of them may have the port
    open."""
    troubles: tuple[PortTrouble, ...] = ()

    @property
    def name(self) -> str:
        return SerialLink(self.device, SerialFormat()).name

    @property
    def link(self) -> str:
        """The LINK that a user can write for this port, with the default line settings."""
        return str(SerialLink(self.stable or self.device, SerialFormat()))


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalInterface:
    """A network interface of this machine."""

    name: str
    description: str = ""
    is_up: bool | None = None
    has_carrier: bool | None = None
    """True if the cable is connected at both ends; None while the interface is down."""
    troubles: tuple[PortTrouble, ...] = ()
    """Problems that prevent a capture from starting, even if the interface is up."""

    @property
    def link(self) -> str:
        return str(InterfaceLink((self.name,)))

    @property
    def may_capture(self) -> bool:
        return not self.troubles
