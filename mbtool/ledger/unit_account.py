"""The rows of the account (account.py) for units, uses of functions, and masters."""

# Memory: each row has at most MAX_MACS MAC addresses, MAX_TEXTS identity texts of one name, and the
# ranges of inventory_ranges.py. The account limits the numbers of rows.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.ledger.inventory_ranges import AddressRanges
from mbtool.ledger.request_tally import RequestTally
from mbtool.modbus import Outcome

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.devices.observed_slave import ObservedSlave
    from mbtool.ledger.time_bins import Row

MAX_MACS = 4
"""The most MAC addresses that are kept of a unit or a master."""
_NEVER_NS = -(1 << 64)
"""A time before all others."""


class UnitKey(NamedTuple):
    """Identifies a unit of a link."""

    link: str
    unit: int


class FailureSpan(NamedTuple):
    """The first and the last failed request of one kind to a unit; times in ns since 1970."""

    first_ns: int
    last_ns: int


class UnitAccount:
    """The counts of one unit of a link, and the times (UTC ns) when it was asked and failed.

    Its requests are counted with its polls, and by `use` (UseAccount). Times are UTC ns.
    """

    __slots__ = (
        "answered_ns",
        "bins",
        "destination",
        "device",
        "first_ns",
        "identity",
        "key",
        "last_ns",
        "macs",
        "missing",
        "observed",
        "ok_ns",
        "refused",
        "silent",
        "silent_since_ns",
        "transports",
    )

    def __init__(self, key: UnitKey, first: NamedTransaction, bins: Row) -> None:
        self.key = key
        self.bins = bins
        """The requests of the unit over time, by UnitSum."""
        self.destination = first.destination
        """The host and port of the slave; None on a serial line."""
        self.transports: set[str] = set()
        self.device: str | None = None
        """The name of the unit's profile; None if it has no profile."""
        self.macs: list[str] = []
        self.identity: dict[tuple[int, str], list[str]] = {}
        """The texts with which the unit identifies itself, by function code and name."""
        self.observed: ObservedSlave | None = None
        """The unit's requests and responses, to compare them with profiles; None if the unit never
        answered."""
        self.first_ns = self.last_ns = first.start_ns
        self.answered_ns = _NEVER_NS
        """The time (UTC ns) of the last response to a request; a time before all others without any
        response."""
        self.ok_ns = 0
        """The time of the last response that is no exception; 0 if there was none."""
        self.silent = 0
        """The number of requests since `silent_since_ns` that were not answered."""
        self.silent_since_ns = _NEVER_NS
        """The time (UTC ns) of the first unanswered request after an answered one. If it is later
        than `answered_ns`, the unit is still silent."""
        self.missing: FailureSpan | None = None
        """The requests without an answer, or whose answer had a wrong CRC or LRC."""
        self.refused: FailureSpan | None = None
        """The requests with an exception as response."""

    def note(self, one: NamedTransaction, begin_ns: int, end_ns: int) -> None:
        """Note a transaction, or several equal ones, of which the first one began at `begin_ns`,
        and the last one ended at `end_ns`. The caller counts them.
        """
        if begin_ns < self.first_ns:
            self.first_ns = begin_ns
        if end_ns > self.last_ns:
            self.last_ns = end_ns
        if end_ns > self.ok_ns and one.exception is None and one.response_ns is not None:
            self.ok_ns = end_ns
        if one.device is not None:
            self.device = one.device
        if one.destination_mac is not None:
            _note_mac(self.macs, one.destination_mac)
        if one.response_mac is not None:
            _note_mac(self.macs, one.response_mac)

    def note_failure(self, outcome: Outcome, at_ns: int) -> None:
        """Note that a request sent at `at_ns` had this outcome."""
        if outcome is Outcome.NO_ANSWER:
            self.missing = _extended_span(self.missing, at_ns)
            if at_ns > self.answered_ns:
                self._note_silence(at_ns)
        elif outcome is Outcome.EXCEPTION:
            self.refused = _extended_span(self.refused, at_ns)

    @property
    def is_silent(self) -> bool:
        """True if its last requests got no answer."""
        return self.silent_since_ns > self.answered_ns

    def _note_silence(self, at_ns: int) -> None:
        if self.silent_since_ns <= self.answered_ns:
            self.silent, self.silent_since_ns = 0, at_ns
        self.silent += 1


class UseKey(NamedTuple):
    """Identifies the use of one function of a unit by one master."""

    link: str
    unit: int
    function: int
    master: str
    """The master's host; empty on a serial line."""


class UseAccount:
    """The use of one function of a unit by one master: addresses, and counts without a poll."""

    __slots__ = ("key", "master", "name", "ranges", "repetitions", "tally", "tape_key", "unit")

    def __init__(
        self, key: UseKey, name: str, unit: UnitAccount, master: MasterAccount | None
    ) -> None:
        self.key = key
        self.tape_key = key.link, key.master
        """The key of the master's tape (RequestOrder)."""
        self.name = name
        self.unit = unit
        self.master = master
        """The master; None on a serial line, and if there are too many masters."""
        self.tally = RequestTally()
        """The counts of transactions that have no poll: responses without a request, and all
        transactions of polls that were given up because there were too many."""
        self.repetitions = 0
        """The number of retries, those of polls included: requests that directly follow an equal
        request without a response, and do not come at the usual period of the poll."""
        self.ranges: dict[tuple[bool, bool], AddressRanges] = {}
        """The addresses in requests. The key has True if they were written, and True if the
        response was an exception."""

    def widen(
        self, address: int | None, quantity: int | None, *, writes: bool, is_refused: bool
    ) -> None:
        """Add the addresses of a request, `quantity` (None for 1) from `address` on."""
        if address is None:
            return
        ranges = self.ranges.get((writes, is_refused))
        if ranges is None:
            ranges = self.ranges[writes, is_refused] = AddressRanges()
        ranges.add(address, address + max(1 if quantity is None else quantity, 1) - 1)


class MasterAccount:
    """The times (UTC ns) of the requests of one master, and its MAC addresses."""

    __slots__ = ("first_ns", "last_ns", "macs")

    def __init__(self, first_ns: int) -> None:
        self.first_ns = first_ns
        self.last_ns = 0
        self.macs: list[str] = []

    def note(self, one: NamedTransaction, begin_ns: int, end_ns: int) -> None:
        """Note a request, or several equal ones; as UnitAccount.note."""
        if begin_ns < self.first_ns:
            self.first_ns = begin_ns
        if end_ns > self.last_ns:
            self.last_ns = end_ns
        if one.source_mac is not None:
            _note_mac(self.macs, one.source_mac)


def _note_mac(macs: list[str], mac: str) -> None:
    if mac not in macs and len(macs) < MAX_MACS:
        macs.append(mac)


def _extended_span(span: FailureSpan | None, at_ns: int) -> FailureSpan:
    """Return the time of failures so that it has one at `at_ns`, too."""
    if span is None:
        return FailureSpan(at_ns, at_ns)
    return FailureSpan(min(span.first_ns, at_ns), max(span.last_ns, at_ns))
