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
    """What a row is on the network or the line."""

    SLAVE = "slave"
    GATEWAY = "gateway"
    """A slave at a host where several units answer."""
    SILENT = "silent"
    """It was asked, and never answered."""
    UNHEARD = "unheard"
    """It was asked, and the capture would not show its answers."""
    BROADCAST = "broadcast"
    """Unit 0 of a serial line: all slaves at once, of which none answers."""
    MASTER = "master"


class FunctionUse(msgspec.Struct, kw_only=True):
    """What one master asked of one unit by one function code."""

    function: int
    name: str
    master: str | None = None
    """The master's host; None on a serial line."""
    writes: bool = False
    """True if the addresses are written, False if they are read."""
    requests: int = 0
    ranges: list[AddressRange] = []
    """The addresses asked for, without those of `refused`."""
    refused: list[AddressRange] = []
    """The addresses that were only answered with an exception."""
    unsupported: int = 0
    """How many of the requests were answered with exception 01, illegal function."""
    left_out: int = 0
    """How many further ranges there are, beyond the limit of inventory_ranges.py."""

    @property
    def all_ranges(self) -> list[AddressRange]:
        return joined((self.ranges, self.refused))


class IdentityText(msgspec.Struct, frozen=True, kw_only=True):
    """A text that a slave gives of itself."""

    function: int
    """2BH, 11H, or the function of the vendor that reports a model code."""
    name: str
    text: str


class ProfileFit(msgspec.Struct, kw_only=True):
    """The device profile that explains a slave, or why none does."""

    profile: str | None = None
    """The profile that fits; None if none fits."""
    score: int = 0
    """How sure that is, 0 to 100, of the profile that fits or else of the nearest."""
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
    """The profile that the user or the log names for it."""
    macs: list[str] = []
    makers: list[str] = []
    identity: list[IdentityText] = []
    fit: ProfileFit | None = None
    """None if it was not looked at: it never answered, or there are too many slaves."""
    uses: list[FunctionUse] = []
    transactions: int = 0
    answered: int = 0
    unanswered: int = 0
    """How many requests had no answer, or only a gateway's that the unit did not respond."""
    exceptions: dict[int, int] = {}
    """How many exception responses there were, by exception code."""
    first_ns: int = 0
    last_ns: int = 0
    answered_ns: int = 0
    """The time of its last answer; 0 if it never answered."""

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
    """A host that asks."""

    host: str
    macs: list[str] = []
    makers: list[str] = []
    requests: int = 0
    slaves: int = 0
    """How many units it asked."""
    written: int = 0
    """How many units it wrote to."""
    first_ns: int = 0
    last_ns: int = 0


class InventoryDocument(msgspec.Struct, kw_only=True):
    """Everything that captures tell of the hosts in them."""

    format: str
    """INVENTORY_FORMAT, in what this program writes."""
    files: list[str] = []
    transactions: int = 0
    slaves: list[SlaveRow] = []
    masters: list[MasterRow] = []
    left_out: dict[str, int] = {}
    """How many things of which kind were not kept, because there were too many."""


def shown_host(host: str, port: int | None) -> str:
    """A host as messages show it: with its port, unless that is 502."""
    if port in (None, MODBUS_PORT):
        return host
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def iso_time(ns: int) -> str:
    """A time in UTC, as ISO 8601 has it, to the microsecond; empty for a time before year 1."""
    try:
        moment = datetime.fromtimestamp(ns // 1_000_000_000, UTC)
    except (OverflowError, ValueError, OSError):
        return ""
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{ns % 1_000_000_000 // 1000:06d}Z"
