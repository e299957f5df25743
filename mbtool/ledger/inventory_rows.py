"""The rows of an inventory; the inventory's JSON document has the same fields."""

# Times are UTC nanoseconds. The host of a slave is its IP address, or the name of the serial line
# that it is on.

from __future__ import annotations

from datetime import UTC, datetime
from enum import StrEnum

import msgspec

from mbtool.core.limits import MODBUS_PORT
from mbtool.ledger.inventory_ranges import AddressRange, joined_ranges

INVENTORY_FORMAT = "mbtool-inventory-1"


class Role(StrEnum):
    """The part that a unit or host plays on the network or the serial line."""

    SLAVE = "slave"
    GATEWAY = "gateway"
    """A slave at a host where several units answer: the host is a gateway to them."""
    SILENT = "silent"
    """A unit that was asked and never answered, or that a gateway could not reach."""
    UNHEARD = "unheard"
    """A unit that was asked, and whose responses, if it gave any, the capture could not contain. An
    example is a capture of only the master's packets."""
    BROADCAST = "broadcast"
    """Unit 0 of a serial line: it addresses all slaves at once, and no slave responds."""
    MASTER = "master"


class FunctionUse(msgspec.Struct, kw_only=True):
    """The use of one function code by one master at one unit: the requests and the addresses in
    them.
    """

    function: int
    name: str
    master: str | None = None
    """The master's host; None on a serial line."""
    writes: bool = False
    """True if the requests write the addresses, False if they read them."""
    requests: int = 0
    ranges: list[AddressRange] = []
    """The addresses that were in at least one request not answered with an exception; the request
    may also have got no response at all."""
    refused: list[AddressRange] = []
    """The addresses in requests that were answered with an exception, without those in `ranges`."""
    references: list[str] = []
    """Each of `ranges` in the notation of the unit's profile; "" for a range without such a
    notation. The list is empty if the unit has no profile."""
    refused_references: list[str] = []
    """Each of `refused` in the notation of the unit's profile, as in `references`."""
    unsupported: int = 0
    """The number of requests that were answered with exception code 01, illegal function."""
    left_out: int = 0
    """The number of address ranges that were not kept, because `ranges` or `refused` already had
    MAX_RANGES ranges (inventory_ranges.py)."""

    @property
    def all_ranges(self) -> list[AddressRange]:
        return joined_ranges((self.ranges, self.refused))


class IdentityText(msgspec.Struct, frozen=True, kw_only=True):
    """A text with which a slave identifies itself, such as a vendor's name."""

    function: int
    """The function code of the response that contained the text: 2BH (device identification), 11H
    (report server id), or a vendor's own function that returns a model code."""
    name: str
    text: str


class ProfileFit(msgspec.Struct, kw_only=True):
    """The device profile that fits a slave's responses, or the reason why no profile fits."""

    profile: str | None = None
    """The name of the profile that fits; None if none fits."""
    score: int = 0
    """A measure, from 0 to 100, of how well the profile explains the slave's responses. If no
    profile fits, this is the score of the one that fits best."""
    nearest: str | None = None
    """If no profile fits: the name of the profile that fits best, None if several fit equally
    well."""
    why: str = ""
    why_names_nearest: bool = False
    """True if `why` says the name of the profile that fits best."""
    evidence: list[str] = []
    against: list[str] = []


class SlaveRow(msgspec.Struct, kw_only=True):
    """A row of the inventory: all that the captures show about one unit of one host, or of one
    serial line.
    """

    host: str
    port: int | None = None
    """The TCP port; None on a serial line."""
    unit: int
    role: Role = Role.SLAVE
    transports: list[str] = []
    device: str | None = None
    """The name of the profile that the user, or the log that was read, assigned to the unit; None
    without such an assignment."""
    macs: list[str] = []
    makers: list[str] = []
    identity: list[IdentityText] = []
    fit: ProfileFit | None = None
    """The profile that fits the unit, or the reason why none fits. None if the unit was not
    compared with profiles, because it never answered or a memory limit was reached."""
    uses: list[FunctionUse] = []
    transactions: int = 0
    answered: int = 0
    unanswered: int = 0
    """The number of requests that got no response, or only a gateway's exception response."""
    unreached: int = 0
    """The number of requests in `unanswered` that a gateway answered with an exception, because it
    could not reach the unit."""
    exceptions: dict[int, int] = {}
    """The number of exception responses, by exception code. Exceptions of a gateway are among
    them."""
    first_ns: int = 0
    last_ns: int = 0
    answered_ns: int = 0
    """The time of the unit's last response that is no exception, in UTC ns; 0 if there is none."""

    @property
    def place(self) -> tuple[str, int | None]:
        return self.host, self.port

    @property
    def where(self) -> str:
        """The host, followed by the port unless that is 502, as messages show it."""
        return shown_host(self.host, self.port)

    def masters(self, *, writing: bool = False) -> list[str]:
        """The hosts of the masters that sent requests to the unit, each once; with `writing`, only
        of those that sent write requests.
        """
        uses = (one for one in self.uses if one.writes or not writing)
        return list(dict.fromkeys(one.master for one in uses if one.master is not None))


class MasterRow(msgspec.Struct, kw_only=True):
    """A row of the inventory: all that the captures show about a host that sends requests."""

    host: str
    macs: list[str] = []
    makers: list[str] = []
    requests: int = 0
    slaves: int = 0
    """The number of units to which this master sent requests."""
    written: int = 0
    """The number of units to which this master sent write requests."""
    first_ns: int = 0
    last_ns: int = 0


class InventoryDocument(msgspec.Struct, kw_only=True):
    """The inventory of one or more captures: all slaves and masters in them."""

    format: str
    """The name and version of the document format; mbtool writes INVENTORY_FORMAT."""
    files: list[str] = []
    transactions: int = 0
    slaves: list[SlaveRow] = []
    masters: list[MasterRow] = []
    left_out: dict[str, int] = {}
    """The numbers of things that the inventory lacks because a memory limit was reached. The keys
    are texts such as "requests were not compared with profiles"."""


def shown_host(host: str, port: int | None) -> str:
    """Return a host as messages show it: followed by its port, unless that is 502 or None."""
    if port in (None, MODBUS_PORT):
        return host
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def iso_time(ns: int) -> str:
    """Format a time (UTC ns) as ISO 8601 with microseconds. Returns an empty text for a time
    outside the years 1 to 9999.
    """
    try:
        moment = datetime.fromtimestamp(ns // 1_000_000_000, UTC)
    except (OverflowError, ValueError, OSError):
        return ""
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{ns % 1_000_000_000 // 1000:06d}Z"
