"""What there is to open on this machine: serial ports, interfaces, and what is in their way."""

# What a source finds out and a view shows. What cannot be found out is None, and never guessed.

from __future__ import annotations

from dataclasses import dataclass

from mbtool.core.link_spec import InterfaceLink, SerialLink
from mbtool.core.serial_format import SerialFormat


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something in the way of a link."""

    problem: str
    mend: str = ""
    """What to type against it, for the user to run or not; never run by this program."""

    def __str__(self) -> str:
        return f"{self.problem}: {self.mend}" if self.mend else self.problem


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a port open."""

    pid: int
    command: str

    def __str__(self) -> str:
        return f"{self.command} ({self.pid})"


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalSerialPort:
    """A serial port with hardware behind it."""

    device: str
    """As in /dev/ttyUSB0."""
    stable: str | None = None
    """A path that leads to this adapter, wherever it is plugged in or in whatever order."""
    description: str = ""
    usb_id: str | None = None
    """Vendor and product, as in 0403:6001."""
    serial_number: str | None = None
    driver: str | None = None
    latency_timer_ms: int | None = None
    """How long the adapter waits for more bytes before it hands over what it has."""
    fifo_bytes: int | None = None
    """How many bytes a UART gathers before it hands them over."""
    low_latency: bool | None = None
    """Whether the driver hands over bytes as they come."""
    low_latency_support: bool | None = None
    holders: tuple[Holder, ...] = ()
    unseen_processes: int = 0
    """How many processes could not be asked whether they hold the port."""
    troubles: tuple[Trouble, ...] = ()

    @property
    def name(self) -> str:
        return SerialLink(self.device, SerialFormat()).name

    @property
    def link(self) -> str:
        """The LINK to give, with the standard's line settings."""
        return str(SerialLink(self.stable or self.device, SerialFormat()))


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalInterface:
    """A network interface."""

    name: str
    description: str = ""
    is_up: bool | None = None
    has_carrier: bool | None = None
    """Whether something is at the other end of the cable; unknown of an interface that is down."""
    troubles: tuple[Trouble, ...] = ()
    """What keeps a capture from starting, whether or not the interface is up."""

    @property
    def link(self) -> str:
        return str(InterfaceLink((self.name,)))

    @property
    def may_capture(self) -> bool:
        return not self.troubles
