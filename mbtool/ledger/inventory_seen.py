"""The data that the inventory collects about slaves, functions and masters while it reads."""

# Memory: each object has at most MAX_MACS MAC addresses. The caller limits the numbers of
# SeenSlave, SeenMaster and SeenUse.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from mbtool.devices.observed_slave import ObservedSlave
from mbtool.ledger.inventory_ranges import AddressRanges
from mbtool.modbus.functions import ExceptionCode
from mbtool.modbus.transaction import Outcome

MAX_MACS = 4

_GATEWAY_EXCEPTIONS = frozenset(
    (ExceptionCode.GATEWAY_PATH_UNAVAILABLE, ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND)
)
"""Codes of exception responses that a gateway sends when the unit behind it does not answer."""
UNANSWERED = frozenset((Outcome.NO_ANSWER, Outcome.NOT_CAPTURED, Outcome.BROADCAST))
"""Outcomes of transactions in which no response of the slave was seen."""


@dataclass(slots=True)
class Seen:
    """The times (UTC ns) at which a unit or a master was first and last seen, and its MAC
    addresses.
    """

    first_ns: int
    last_ns: int = 0
    macs: list[str] = field(default_factory=list)

    def note(self, start_ns: int, end_ns: int, mac: str | None) -> None:
        if start_ns < self.first_ns:
            self.first_ns = start_ns
        if end_ns > self.last_ns:
            self.last_ns = end_ns
        if mac is not None and mac not in self.macs and len(self.macs) < MAX_MACS:
            self.macs.append(mac)


@dataclass(slots=True)
class SeenUse:
    """The requests of one master to one slave with one function code."""

    function: int
    name: str
    master: str | None
    writes: bool
    requests: int = 0
    unsupported: int = 0
    asked: AddressRanges = field(default_factory=AddressRanges)
    """The addresses that were in at least one request not answered with an exception."""
    refused: AddressRanges = field(default_factory=AddressRanges)


@dataclass(slots=True)
class SeenSlave:
    """A unit at a TCP port of a host, or on a serial line, with all that was seen of it."""

    host: str
    port: int | None
    unit: int
    is_on_line: bool
    seen: Seen
    observed: ObservedSlave | None
    transports: set[str] = field(default_factory=set)
    device: str | None = None
    identity: dict[tuple[int, str], list[str]] = field(default_factory=dict)
    uses: dict[tuple[int, str | None, bool], SeenUse] = field(default_factory=dict)
    outcomes: Counter[Outcome] = field(default_factory=Counter)
    exceptions: Counter[int] = field(default_factory=Counter)
    answered_ns: int = 0

    @property
    def unreached(self) -> int:
        """The number of requests that a gateway answered with an exception, because it could not
        reach the unit.
        """
        return sum(self.exceptions[code] for code in _GATEWAY_EXCEPTIONS)

    @property
    def answered(self) -> int:
        """The number of responses of the unit itself, exception responses included."""
        silent = sum(self.outcomes[one] for one in UNANSWERED)
        return self.outcomes.total() - silent - self.unreached

    @property
    def is_broadcast(self) -> bool:
        return self.is_on_line and self.unit == 0


@dataclass(slots=True)
class SeenMaster:
    """A host that sends requests: its times, its number of requests and the slaves it asked."""

    seen: Seen
    requests: int = 0
    slaves: set[int] = field(default_factory=set)
    """The slaves that this master sent requests to. Each is identified by the `id()` of its
    SeenSlave."""
    written: set[int] = field(default_factory=set)
