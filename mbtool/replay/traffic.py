"""Summarises the transactions of a capture, so that two captures can be compared."""

# For each slave of a capture:
#
#     requests   by function, addresses and quantities (not transaction ids, order, times or
#                values): their number, outcomes and latencies
#     registers  by table, address, and read or written: the values. Only reads with outcome ok and
#                acknowledged writes count; the masks of mask write (16H) are no values
#
#     connections   of a slave's address: how each began and ended (connections.py)
#
# A slave is a unit on a link. The same link may have another name in another capture, so if a unit
# number occurs on only one link, the number alone identifies the slave.
#
# Memory grows with the number of different requests and values, not with the length of a capture.
# Limits:
#
#     MAX_VALUES       values of a register; after that, only the least and greatest are updated
#     MAX_LATENCIES    latencies of a request; if there are more, an evenly spaced choice
#     MAX_REQUESTS     requests of a slave
#     MAX_REGISTERS    registers of a slave
#     MAX_SLAVES       slaves
#
# Requests, registers and slaves beyond their limit are left out; `compared` is then less than
# `count`.

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from mbtool.modbus import FUNCTIONS, Outcome, Table
from mbtool.modbus.functions import MASK_WRITE_REGISTER
from mbtool.replay.connections import ConnectionHistory, RecordedConnection

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, Span

MAX_VALUES = 256
MAX_LATENCIES = 1 << 15
MAX_REQUESTS = 1 << 16
MAX_REGISTERS = 1 << 18
MAX_SLAVES = 1 << 16
"""At most this many slaves are kept; further ones are left out. A slave that is asked for two
registers takes 2 KB, so all together 125 MB."""

NO_ANSWER = "no answer"


class SlaveKey(NamedTuple):
    """Identifies a slave of a capture. `link` is None if the unit number occurs on only one link,
    so that the number is enough.
    """

    unit: int
    link: str | None

    def __str__(self) -> str:
        return f"unit {self.unit}" + (f" on {self.link}" if self.link is not None else "")


class RequestKey(NamedTuple):
    """Identifies equal requests, whatever values they write. A field that the function
    lacks is -1.
    """

    function: int
    sub_function: int
    address: int
    quantity: int
    write_address: int
    write_quantity: int


class ValueKey(NamedTuple):
    """A register or bit of a slave. The values that were read of it and those that were written
    have different keys.
    """

    table: Table
    address: int
    is_written: bool

    def is_in(self, spans: Iterable[Span]) -> bool:
        """True if one of `spans` (ranges of addresses of a table) contains this register or bit."""
        return any(span.table is self.table and self.address in span for span in spans)


class Sample:
    """A sample of times in ns, such as latencies, that keeps fewer than MAX_LATENCIES of them.

    Whenever it is full, every second time is dropped. From then on only every second new one is
    kept; after the next time it is full, every fourth, and so on.
    """

    __slots__ = ("_skip", "_stride", "values")

    def __init__(self) -> None:
        self.values = array("q")
        self._stride = 1
        """The number of new times of which one is kept: 1, 2, 4, ..."""
        self._skip = 1
        """The number of the coming call of `add` whose time is kept: 1 means the next call."""

    def add(self, value: int) -> None:
        self._skip -= 1
        if self._skip:
            return
        self._skip = self._stride
        self.values.append(value)
        if len(self.values) >= MAX_LATENCIES:
            self.values = self.values[::2]
            self._stride *= 2


@dataclass(slots=True)
class RequestTraffic:
    """The number, outcomes and latencies of a request and its repetitions."""

    function_name: str
    reference: str
    """The addresses in the request, in the notation of the device; empty if it has none."""
    count: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    """The number of requests by outcome: `ok`, `exception 02`, `no answer`, `malformed`,
    `broadcast`, `unsolicited`."""
    latencies: Sample = field(default_factory=Sample)
    """The latencies of responses and exception responses, in ns."""


@dataclass(slots=True)
class ObservedValues:
    """The different values that a register or bit had in a capture."""

    values: dict[int, None] = field(default_factory=dict)
    """The different values, as keys of a dict that keeps the order in which they were first seen;
    at most MAX_VALUES."""
    is_all: bool = True
    """False if there were more than MAX_VALUES different values, so that `values` lacks some."""
    least: int = 0xFFFF
    greatest: int = 0

    def add(self, value: int) -> None:
        if value in self.values:
            return
        self.least, self.greatest = min(self.least, value), max(self.greatest, value)
        if len(self.values) < MAX_VALUES:
            self.values[value] = None
        else:
            self.is_all = False


class SlaveTraffic:
    """The requests to one slave, and the values of its registers and bits."""

    def __init__(self) -> None:
        self.count = 0
        self.device: str | None = None
        """The name of the device's profile; None if it has none."""
        self.requests: dict[RequestKey, RequestTraffic] = {}
        self.registers: dict[ValueKey, ObservedValues] = {}
        self.left_out = 0
        """The number of transactions whose request, or some of whose registers, were left out
        because there were too many."""
        self.has_all_requests = True

    def add(self, transaction: NamedTransaction) -> None:
        self.count += 1
        self.device = transaction.device
        request = self._request(transaction)
        if request is not None and transaction.outcome is not Outcome.NOT_CAPTURED:
            request.count += 1
            request.outcomes[_outcome(transaction)] += 1
            if transaction.latency_ns is not None:
                request.latencies.add(transaction.latency_ns)
        has_all_values = self._add_values(transaction)
        self.left_out += request is None or not has_all_values

    def _request(self, transaction: NamedTransaction) -> RequestTraffic | None:
        key = _request_key(transaction)
        request = self.requests.get(key)
        if request is None:
            if len(self.requests) >= MAX_REQUESTS:
                self.has_all_requests = False
                return None
            request = RequestTraffic(transaction.function_name, transaction.reference or "")
            self.requests[key] = request
        return request

    def _add_values(self, transaction: NamedTransaction) -> bool:
        """Note the values of a transaction; return False if some were left out."""
        known = FUNCTIONS.get(transaction.function)
        if known is None or known.table is None or not transaction.took_effect:
            return True
        has_all = True
        table, address = known.table, transaction.address
        if known.writes and transaction.function != MASK_WRITE_REGISTER:
            where = address if transaction.write_address is None else transaction.write_address
            has_all = self._observe(table, where, transaction.request_values, is_written=True)
        if transaction.outcome in (Outcome.OK, Outcome.LATE) and (
            not known.writes or transaction.write_address is not None
        ):
            values = (transaction.response_values or [])[: transaction.quantity]
            has_all = self._observe(table, address, values, is_written=False) and has_all
        return has_all

    def _observe(
        self, table: Table, address: int | None, values: Sequence[int] | None, *, is_written: bool
    ) -> bool:
        """Note the values of neighbouring registers; return False if some were left out."""
        if address is None or not values:
            return True
        has_all = True
        for at, value in enumerate(values, start=address):
            key = ValueKey(table, at, is_written)
            observed = self.registers.get(key)
            if observed is None:
                if len(self.registers) >= MAX_REGISTERS:
                    has_all = False
                    continue
                observed = self.registers[key] = ObservedValues()
            observed.add(value)
        return has_all


class Traffic:
    """The traffic of each slave in one capture."""

    def __init__(self) -> None:
        self.count = 0
        self.history = ConnectionHistory()
        self._without_slave = 0
        """The number of transactions of slaves that were left out because there were too many."""
        self._slaves: dict[tuple[str, int], SlaveTraffic] = {}
        self._places: dict[str, str] = {}
        """By HOST:PORT of each slave, the name of its link."""

    @classmethod
    def of(cls, transactions: Iterable[NamedTransaction]) -> Traffic:
        traffic = cls()
        for one in transactions:
            traffic.add(one)
        return traffic

    def add(self, transaction: NamedTransaction) -> None:
        self.count += 1
        if transaction.destination is not None:
            self._places[transaction.destination] = transaction.link
        key = (transaction.link, transaction.unit)
        slave = self._slaves.get(key)
        if slave is None:
            if len(self._slaves) >= MAX_SLAVES:
                self._without_slave += 1
                return
            slave = self._slaves[key] = SlaveTraffic()
        slave.add(transaction)

    def connections(self) -> dict[str, list[RecordedConnection]]:
        """Return the connections to each slave, by the name of its link."""
        found: dict[str, list[RecordedConnection]] = {}
        for place, link in self._places.items():
            found.setdefault(link, []).extend(self.history.of_slaves({place}))
        return {link: ones for link, ones in found.items() if ones}

    @property
    def has_all_slaves(self) -> bool:
        return not self._without_slave

    @property
    def compared(self) -> int:
        """The number of transactions of which nothing was left out because there was too much."""
        left_out = sum(slave.left_out for slave in self._slaves.values())
        return self.count - self._without_slave - left_out

    def slaves(self, unique: frozenset[int]) -> dict[SlaveKey, SlaveTraffic]:
        """Return the traffic of each slave of the capture.

        A slave whose unit number is in `unique` is identified by that number alone, any other by
        number and link.
        """
        return {
            SlaveKey(unit, None if unit in unique else link): slave
            for (link, unit), slave in self._slaves.items()
        }

    def links_of_units(self) -> Counter[int]:
        """By unit number, the number of links on which it occurs."""
        return Counter(unit for _, unit in self._slaves)


def _request_key(transaction: NamedTransaction) -> RequestKey:
    def number(value: int | None) -> int:
        return -1 if value is None else value

    written = -1
    if transaction.write_address is not None:
        written = transaction.written_quantity
    return RequestKey(
        transaction.function,
        number(transaction.sub_function),
        number(transaction.address),
        number(transaction.quantity),
        number(transaction.write_address),
        written,
    )


def _outcome(transaction: NamedTransaction) -> str:
    if transaction.exception is not None:
        return f"exception {transaction.exception:02X}"
    if transaction.outcome is Outcome.NO_ANSWER:
        return NO_ANSWER
    return transaction.outcome.value
