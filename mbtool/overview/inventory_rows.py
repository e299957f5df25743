"""The rows of an inventory, which are also what its JSON document holds."""

# Times are UTC nanoseconds. A host is an IP address; on a serial line, where nobody has an address,
# it is the name of the line.

from __future__ import annotations

from datetime import UTC, datetime
from enum import StrEnum

import msgspec

from mbtool.overview.inventory_ranges import AddressRange, joined

INVENTORY_FORMAT = "mbtool-inventory-1"
MODBUS_PORT = 502


class Role(StrEnum):
    """The role of a unit or host on the network or the line."""

    SLAVE = "slave"
    GATEWAY = "gateway"
    """A slave at a host where several units answer."""
    SILENT = "silent"
    """A unit that was asked and never answered."""
    UNHEARD = "unheard"
    """A unit that was asked, but whose answers the capture could not show."""
    BROADCAST = "broadcast"
    """Unit 0 of a serial line: all slaves at once, of which none answers."""
    MASTER = "master"


class FunctionUse(msgspec.Struct, kw_only=True):
    """The requests of one master to one unit with one function code."""

    function: int
    name: str
    master: str | None = None
    """The master's host; None on a serial line."""
    writes: bool = False
    """True if the addresses are written, False if they are read."""
    requests: int = 0
    ranges: list[AddressRange] = []
    """The requested addresses, without those in `refused`."""
    refused: list[AddressRange] = []
    """The addresses that were only answered with an exception."""
    unsupported: int = 0
    """The number of requests that were answered with exception 01, illegal function."""
    left_out: int = 0
    """The number of further ranges, beyond the limit of inventory_ranges.py."""

    @property
    def all_ranges(self) -> list[AddressRange]:
        return joined((self.ranges, self.refused))


class IdentityText(msgspec.Struct, frozen=True, kw_only=True):
    """A text by which a slave identifies itself."""

    function: int
    """The function that gave the text: 2BH, 11H, or a vendor's function for a model code."""
    name: str
    text: str


class ProfileFit(msgspec.Struct, kw_only=True):
    """The device profile that explains a slave, or why none does."""

    profile: str | None = None
    """The profile that fits; None if none fits."""
    score: int = 0
    """How well the profile that fits, or else the nearest one, explains the slave: 0 to 100."""
    nearest: str | None = None
    """The profile that comes nearest, if none fits."""
    why: str = ""
    evidence: list[str] = []
    against: list[str] = []


class SlaveRow(msgspec.Struct, kw_only=True):
    """One unit of one host."""

    host: str
    port: int | None = None
    """The TCP port; None on a serial line."""
    unit: int
    role: Role = Role.SLAVE
    transports: list[str] = []
    device: str | None = None
    """The profile that the user or the log names for the unit."""
    macs: list[str] = []
    makers: list[str] = []
    identity: list[IdentityText] = []
    fit: ProfileFit | None = None
    """None if the unit was not compared with profiles: it never answered, or a limit was
    reached."""
    uses: list[FunctionUse] = []
    transactions: int = 0
    answered: int = 0
    unanswered: int = 0
    """The number of requests without any answer, or with only an exception of a gateway."""
    exceptions: dict[int, int] = {}
    """The number of exception responses, by exception code."""
    first_ns: int = 0
    last_ns: int = 0
    answered_ns: int = 0
    """The time of the unit's last answer, in UTC ns; 0 if it never answered."""

    @property
    def place(self) -> tuple[str, int | None]:
        return self.host, self.port

    @property
    def where(self) -> str:
        """The host, with the port unless that is 502."""
        return shown_host(self.host, self.port)

    def masters(self, *, writing: bool = False) -> list[str]:
        """The hosts that asked, or only those that wrote, each once."""
        uses = (one for one in self.uses if one.writes or not writing)
        return list(dict.fromkeys(one.master for one in uses if one.master is not None))


class MasterRow(msgspec.Struct, kw_only=True):
    """A host that sends requests."""

    host: str
    macs: list[str] = []
    makers: list[str] = []
    requests: int = 0
    slaves: int = 0
    """The number of units that it sent requests to."""
    written: int = 0
    """The number of units that it wrote to."""
    first_ns: int = 0
    last_ns: int = 0


class InventoryDocument(msgspec.Struct, kw_only=True):
    """The hosts in one or more captures."""

    format: str
    """The version of the format; this program writes INVENTORY_FORMAT."""
    files: list[str] = []
    transactions: int = 0
    slaves: list[SlaveRow] = []
    masters: list[MasterRow] = []
    left_out: dict[str, int] = {}
    """By kind, the number of things that were not kept because there were too many."""


def shown_host(host: str, port: int | None) -> str:
    """A host as messages show it: with its port, unless that is 502."""
    if port in (None, MODBUS_PORT):
        return host
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def iso_time(ns: int) -> str:
    """A time in UTC ns as ISO 8601 with microseconds; empty outside years 1 to 9999."""
    try:
        moment = datetime.fromtimestamp(ns // 1_000_000_000, UTC)
    except (OverflowError, ValueError, OSError):
        return ""
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{ns % 1_000_000_000 // 1000:06d}Z"
