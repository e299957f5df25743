"""What was seen of one slave: what it was asked, how it answered, and the values it gave."""

# For saying which device it is (matching.py) and for a profile from its traffic (drafting/).
# Equal requests are counted together.
#
# Limits, of each slave: MAX_ASKS different requests, of which the further ones are counted in
# `forgotten`; of the first MAX_SAMPLED requests MAX_ROWS answers are kept, spread over all of the
# time, since whenever there are more every second one is dropped, and half as many come in.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.devices.assignment import Who
from mbtool.devices.identity import answer_word
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.identification import identities
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.modbus.adu import Transport
    from mbtool.modbus.transaction import Transaction

MAX_ASKS = 8192
MAX_SAMPLED = 512
MAX_ROWS = 64
MAX_TEXTS = 64

_READ_WRITE = 0x17


@dataclass(frozen=True, slots=True)
class ObservedRequest:
    """A request, but for what it writes."""

    function: int
    table: Table | None
    address: int | None
    """None where the function has none, or a response came without its request."""
    quantity: int
    writes: bool

    @property
    def span(self) -> range:
        """Its addresses, without those beyond the last that there is."""
        first = self.address or 0
        return range(first, min(first + max(self.quantity, 1), 1 << 16))


@dataclass(slots=True)
class Replies:
    """How often a request was answered, and how."""

    ok: int = 0
    silent: int = 0
    """Not answered, or not in the form that an answer has."""
    exceptions: Counter[int] = field(default_factory=Counter)


@dataclass(slots=True)
class Samples:
    """The registers that came with one request: read from the slave, or written to it."""

    rows: list[tuple[int, ...]] = field(default_factory=list)
    count: int = 0
    changes: list[int] = field(default_factory=list)
    """How often each value differed from the one before it."""
    _last: tuple[int, ...] = ()
    _every: int = 1

    def add(self, values: Sequence[int]) -> None:
        row = tuple(values)
        if self._last and len(row) != len(self._last):
            return
        if not self._last:
            self.changes = [0] * len(row)
        elif row != self._last:
            for index, (before, now) in enumerate(zip(self._last, row, strict=True)):
                self.changes[index] += before != now
        self._last = row
        if self.count % self._every == 0:
            self.rows.append(row)
            if len(self.rows) > MAX_ROWS:
                del self.rows[1::2]
                self._every *= 2
        self.count += 1


class ObservedSlave:
    """What one slave was asked and answered."""

    def __init__(
        self, link: str, destination: str | None, unit: int, *, with_values: bool = False
    ) -> None:
        self.link = link
        self.destination = destination
        self.unit = unit
        self.transports: set[Transport] = set()
        self.asked: dict[ObservedRequest, Replies] = {}
        self.samples: dict[ObservedRequest, Samples] = {}
        self.identity: dict[str, str] = {}
        """What it says about itself, by the names of modbus/identification.py."""
        self.answer_words: set[tuple[int, int]] = set()
        """Functions whose whole answer was one word, with that word."""
        self.transactions = 0
        self.forgotten = 0
        self._with_values = with_values

    @property
    def who(self) -> Who:
        """As --device would name it, its port included."""
        return Who.of_slave(self.destination, self.unit)

    @property
    def answered(self) -> bool:
        return any(one.ok or one.exceptions for one in self.asked.values())

    def given(self) -> dict[Table, bytearray]:
        """Each table's addresses, those marked by 1 that were asked for and given, or taken."""
        given = {table: bytearray(1 << 16) for table in Table}
        for ask, replies in self.asked.items():
            if ask.table is not None and replies.ok:
                span = ask.span
                given[ask.table][span.start : span.stop] = b"\x01" * len(span)
        return given

    def note(self, transaction: Transaction) -> None:
        """Take one transaction of this slave."""
        self.transactions += 1
        self.transports.add(transaction.transport)
        if transaction.response_raw is not None and transaction.exception is None:
            self._note_identity(transaction)
        if not 0 < transaction.function < 0x80:
            return  # No function that a device could have.
        for ask, values in _asks(transaction):
            replies = self.asked.get(ask)
            if replies is None:
                if len(self.asked) >= MAX_ASKS:
                    self.forgotten += 1
                    continue
                replies = self.asked[ask] = Replies()
            if transaction.exception is not None:
                replies.exceptions[transaction.exception] += 1
            elif transaction.outcome in (Outcome.OK, Outcome.UNSOLICITED):
                replies.ok += 1
                if self._with_values and values:
                    self._sample(ask, values)
            else:
                replies.silent += 1

    def _sample(self, ask: ObservedRequest, values: Sequence[int]) -> None:
        if ask.table is None or ask.table.is_bits:
            return
        samples = self.samples.get(ask)
        if samples is None and len(self.samples) < MAX_SAMPLED:
            samples = self.samples[ask] = Samples()
        if samples is not None:
            samples.add(values[: len(ask.span)])

    def _note_identity(self, transaction: Transaction) -> None:
        for one in identities(transaction):
            if len(self.identity) < MAX_TEXTS:
                self.identity.setdefault(one.name, one.text)
        if transaction.function not in FUNCTIONS and len(self.answer_words) < MAX_TEXTS:
            word = answer_word(transaction)
            if word is not None:
                self.answer_words.add((transaction.function, word))


def _asks(transaction: Transaction) -> list[tuple[ObservedRequest, Sequence[int] | None]]:
    """What it asks for, each with the values that came along."""
    function = transaction.function
    known = FUNCTIONS.get(function)
    table = known.table if known is not None else None
    if known is None or table is None or transaction.address is None:
        return [
            (ObservedRequest(function, None, None, 1, known is not None and known.writes), None)
        ]
    quantity = 1 if transaction.quantity is None else transaction.quantity
    if function == _READ_WRITE and transaction.write_address is not None:
        written = transaction.request_values or []
        return [
            (
                ObservedRequest(function, table, transaction.address, quantity, False),
                transaction.response_values,
            ),
            (
                ObservedRequest(function, table, transaction.write_address, len(written), True),
                written,
            ),
        ]
    values = transaction.request_values if known.writes else transaction.response_values
    return [(ObservedRequest(function, table, transaction.address, quantity, known.writes), values)]
