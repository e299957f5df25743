"""What one capture says, put together so that two of them can be compared."""

# For each slave of a capture:
#
#     asked      by function, addresses and quantities (not ids, order, time or values): how often,
#                how it ended, and the latencies
#     registers  by table, address and whether it was read or written: the values it had. Reads
#                count where they were answered well, writes where they were acknowledged; masks
#                (16H) are no values
#
# A slave is a unit on a link. Links are called otherwise in every capture, so where a unit is on
# one link only, its number is enough to find it in another capture.
#
# Memory grows with what is different, not with the length of a capture: of each register at most
# MAX_VALUES values are kept, and then how many more there were, its least and its greatest; of the
# latencies of one poll MAX_LATENCIES, evenly chosen; and MAX_ASKED requests and MAX_REGISTERS
# registers of a slave, beyond which `is_whole` is False.

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from mbtool.modbus import FUNCTIONS, Outcome, Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.devices import NamedTransaction

MAX_VALUES = 256
MAX_LATENCIES = 1 << 15
MAX_ASKED = 1 << 16
MAX_REGISTERS = 1 << 18
MAX_SLAVES = 1 << 12

NO_ANSWER = "no answer"

_MASK_WRITE = 0x16


class SlaveKey(NamedTuple):
    """A slave; without a link where its unit is on one link only."""

    unit: int
    link: str | None

    def __str__(self) -> str:
        return f"unit {self.unit}" + (f" on {self.link}" if self.link is not None else "")


class RequestKey(NamedTuple):
    """What a request asks for, its values apart; -1 where a function has no such field."""

    function: int
    sub_function: int
    address: int
    quantity: int
    write_address: int
    write_quantity: int


class ValueKey(NamedTuple):
    """A register or bit, as it is read or as it is written."""

    table: Table
    address: int
    is_written: bool


class Sample:
    """Latencies, at most MAX_LATENCIES: when they are too many, every other one goes."""

    __slots__ = ("_left", "_stride", "values")

    def __init__(self) -> None:
        self.values = array("q")
        self._stride = 1
        self._left = 1

    def add(self, value: int) -> None:
        self._left -= 1
        if self._left:
            return
        self._left = self._stride
        self.values.append(value)
        if len(self.values) >= MAX_LATENCIES:
            self.values = self.values[::2]
            self._stride *= 2


@dataclass(slots=True)
class Asked:
    """What became of one request and its repetitions."""

    function_name: str
    reference: str
    """What it addresses, in the notation of its device."""
    count: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    """`ok`, `exception 02`, `no answer`, `malformed`, `broadcast`, `unsolicited`: how often."""
    latencies: Sample = field(default_factory=Sample)
    """Of answers, in nanoseconds; of exceptions too."""


@dataclass(slots=True)
class Held:
    """The values that a register or bit had."""

    values: dict[int, None] = field(default_factory=dict)
    """In the order in which they were first seen."""
    is_all: bool = True
    """Whether `values` has all of them."""
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
    """What one slave was asked and said."""

    def __init__(self) -> None:
        self.count = 0
        self.device: str | None = None
        """The name of its profile, if it has one."""
        self.asked: dict[RequestKey, Asked] = {}
        self.registers: dict[ValueKey, Held] = {}
        self.is_whole = True
        """Whether no bound left anything out."""

    def add(self, transaction: NamedTransaction) -> None:
        self.count += 1
        self.device = transaction.device
        asked = self._asked(transaction)
        if asked is not None:
            asked.count += 1
            asked.outcomes[_outcome(transaction)] += 1
            if transaction.latency_ns is not None:
                asked.latencies.add(transaction.latency_ns)
        self._add_values(transaction)

    def _asked(self, transaction: NamedTransaction) -> Asked | None:
        ask = _ask(transaction)
        asked = self.asked.get(ask)
        if asked is None:
            if len(self.asked) >= MAX_ASKED:
                self.is_whole = False
                return None
            asked = Asked(transaction.function_name, transaction.reference or "")
            self.asked[ask] = asked
        return asked

    def _add_values(self, transaction: NamedTransaction) -> None:
        known = FUNCTIONS.get(transaction.function)
        if known is None or known.table is None or not transaction.took_effect:
            return
        table, address = known.table, transaction.address
        if known.writes and transaction.function != _MASK_WRITE:
            where = address if transaction.write_address is None else transaction.write_address
            self._hold(table, where, transaction.request_values, is_written=True)
        if transaction.outcome is Outcome.OK and (
            not known.writes or transaction.write_address is not None
        ):
            values = (transaction.response_values or [])[: transaction.quantity]
            self._hold(table, address, values, is_written=False)

    def _hold(
        self, table: Table, address: int | None, values: Sequence[int] | None, *, is_written: bool
    ) -> None:
        if address is None or not values:
            return
        for at, value in enumerate(values, start=address):
            held = self.registers.get(ValueKey(table, at, is_written))
            if held is None:
                if len(self.registers) >= MAX_REGISTERS:
                    self.is_whole = False
                    return
                held = self.registers[ValueKey(table, at, is_written)] = Held()
            held.add(value)


class Traffic:
    """The slaves of one capture."""

    def __init__(self) -> None:
        self.count = 0
        self._left_out = False
        self._slaves: dict[tuple[str, int], SlaveTraffic] = {}

    @classmethod
    def of(cls, transactions: Iterable[NamedTransaction]) -> Traffic:
        traffic = cls()
        for one in transactions:
            traffic.add(one)
        return traffic

    def add(self, transaction: NamedTransaction) -> None:
        self.count += 1
        key = (transaction.link, transaction.unit)
        slave = self._slaves.get(key)
        if slave is None:
            if len(self._slaves) >= MAX_SLAVES:
                self._left_out = True
                return
            slave = self._slaves[key] = SlaveTraffic()
        slave.add(transaction)

    @property
    def is_whole(self) -> bool:
        """Whether no bound left anything out."""
        return not self._left_out and all(slave.is_whole for slave in self._slaves.values())

    def slaves(self, alone: frozenset[int]) -> dict[SlaveKey, SlaveTraffic]:
        """By unit, where that is among `alone`, else by unit and link."""
        return {
            SlaveKey(unit, None if unit in alone else link): slave
            for (link, unit), slave in self._slaves.items()
        }

    def links_of_units(self) -> Counter[int]:
        """On how many links each unit is."""
        return Counter(unit for _, unit in self._slaves)


def _ask(transaction: NamedTransaction) -> RequestKey:
    def number(value: int | None) -> int:
        return -1 if value is None else value

    written = -1
    if transaction.write_address is not None:
        written = len(transaction.request_values or ())
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
