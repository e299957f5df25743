"""Observes one slave: which requests it got, how it responded, and samples of register values."""

# The observations are used to find the profile that fits a slave (profile_match.py), to draft a
# profile (values/draft.py) and to find a value (values/finding.py). Requests that are equal except
# for written values are counted together.
#
# Limits for each slave: MAX_REQUESTS different requests; further different requests are only
# counted, in `forgotten`. Register values are sampled for the first MAX_SAMPLED different requests,
# at most MAX_ROWS rows each; a row has the values of one transaction. When there are more rows,
# every second row is dropped, and from then on only half as many transactions give a row. So the
# sample is spread over the whole time.

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from mbtool.devices.assignment import Who
from mbtool.devices.identity import answer_word
from mbtool.modbus.functions import EXCEPTION_BIT, FUNCTIONS, READ_WRITE_REGISTERS
from mbtool.modbus.identification import identities
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome, Transaction

if TYPE_CHECKING:
    from mbtool.modbus.adu import Transport

MAX_REQUESTS = 8192
MAX_SAMPLED = 512
MAX_ROWS = 120
MAX_TEXTS = 64


class ObservedRequest(NamedTuple):
    """A kind of request: all requests that are equal except for the values that they write.

    A request with function 17H is observed as two, a read and a write.
    """

    function: int
    table: Table | None
    address: int | None
    """The first address; None if the function has none, or if the capture lacks the request."""
    quantity: int
    writes: bool

    @property
    def span(self) -> range:
        """The addresses that the request reads or writes, without any beyond FFFFH."""
        first = self.address or 0
        return range(first, min(first + max(self.quantity, 1), 1 << 16))


@dataclass(slots=True)
class Replies:
    """Counts how the slave responded to one kind of request."""

    ok: int = 0
    silent: int = 0
    """Number of requests that got no response, or a malformed one."""
    exceptions: Counter[int] = field(default_factory=Counter)


@dataclass(slots=True)
class Samples:
    """Samples of the register values that one kind of request reads or writes."""

    rows: list[tuple[int, ...]] = field(default_factory=list)
    """One tuple for each sampled transaction: the values of its registers, in the order of their
    addresses."""
    times_ns: list[int] = field(default_factory=list)
    """The time of each row (UTC ns)."""
    count: int = 0
    """Number of transactions that had values, also of those that are not in `rows`."""
    changes: list[int] = field(default_factory=list)
    """For each register, the number of times that its value changed from one transaction to the
    next."""
    _last: tuple[int, ...] = ()
    _every: int = 1

    def add(self, values: Sequence[int], at_ns: int = 0) -> None:
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
            self.times_ns.append(at_ns)
            if len(self.rows) > MAX_ROWS:
                del self.rows[1::2], self.times_ns[1::2]
                self._every *= 2
        self.count += 1


OnRow = Callable[["ObservedSlave", ObservedRequest, int, "Sequence[int]"], None]
"""Gets the values of registers (the slave, the kind of request, the time in ns, the values)."""


class ObservedSlave:
    """Collects the requests to one slave and its responses."""

    def __init__(
        self,
        link: str,
        destination: str | None,
        unit: int,
        *,
        with_values: bool = False,
        on_row: OnRow | None = None,
    ) -> None:
        """With `with_values`, the values of registers are sampled. `on_row` gets all of them."""
        self.link = link
        self.destination = destination
        self.unit = unit
        self.transports: set[Transport] = set()
        self.requests: dict[ObservedRequest, Replies] = {}
        self.samples: dict[ObservedRequest, Samples] = {}
        self.identity: dict[str, str] = {}
        """The texts that the slave reports about itself (functions 2B/0E, 11H). The keys are the
        names in modbus/identification.py, such as `vendor`."""
        self.answer_words: set[tuple[int, int]] = set()
        """The responses to vendors' own functions whose only data is a 16-bit word: function code
        and word."""
        self.transactions = 0
        self.forgotten = 0
        """Number of transactions whose requests are not in `requests`, because that already has
        MAX_REQUESTS others."""
        self._with_values = with_values
        self._on_row = on_row

    @property
    def who(self) -> Who:
        """The pattern for exactly this slave (host, port, unit), as for the option --device."""
        return Who.of_slave(self.destination, self.unit)

    @property
    def has_responded(self) -> bool:
        return any(replies.ok or replies.exceptions for replies in self.requests.values())

    def known_addresses(self) -> dict[Table, bytearray]:
        """For each table, one byte per address: 1 if a read or write of it succeeded, else 0."""
        known = {table: bytearray(1 << 16) for table in Table}
        for request, replies in self.requests.items():
            if request.table is not None and replies.ok:
                span = request.span
                known[request.table][span.start : span.stop] = b"\x01" * len(span)
        return known

    def note(self, transaction: Transaction) -> None:
        """Add one transaction of this slave."""
        self.transactions += 1
        self.transports.add(transaction.transport.over_tcp)
        if transaction.response_raw is not None and transaction.exception is None:
            self._note_identity(transaction)
        if not 0 < transaction.function < EXCEPTION_BIT:
            return  # No device has such a function.
        for request, values in _requests(transaction):
            replies = self._replies(request)
            if replies is None:
                continue
            if transaction.exception is not None:
                replies.exceptions[transaction.exception] += 1
            elif transaction.outcome in (Outcome.OK, Outcome.LATE, Outcome.UNSOLICITED):
                replies.ok += 1
                if self._with_values and values:
                    at_ns = transaction.response_ns or transaction.start_ns
                    self._sample(request, values, at_ns)
            elif transaction.outcome is not Outcome.NOT_CAPTURED:
                replies.silent += 1

    def note_usual(self, like: Transaction, address: int, quantity: int) -> bool:
        """Add an answered read or write: one like `like`, with these addresses. Its values are not
        sampled. Returns True if its request is a new one.
        """
        self.transactions += 1
        if like.transport not in self.transports:
            self.transports.add(like.transport.over_tcp)
        code, function = like.function, FUNCTIONS[like.function]
        before = len(self.requests)
        replies = self._replies(
            ObservedRequest(code, function.table, address, quantity, function.writes)
        )
        if replies is not None and like.exception is not None:
            replies.exceptions[like.exception] += 1
        elif replies is not None:
            replies.ok += 1
        return len(self.requests) > before

    def _replies(self, request: ObservedRequest) -> Replies | None:
        """Return the replies to a kind of request; None if there are too many kinds."""
        replies = self.requests.get(request)
        if replies is None:
            if len(self.requests) >= MAX_REQUESTS:
                self.forgotten += 1
                return None
            replies = self.requests[request] = Replies()
        return replies

    def _sample(self, request: ObservedRequest, values: Sequence[int], at_ns: int) -> None:
        if request.table is None or request.table.is_bits:
            return
        if self._on_row is not None:
            self._on_row(self, request, at_ns, values)
        samples = self.samples.get(request)
        if samples is None and len(self.samples) < MAX_SAMPLED:
            samples = self.samples[request] = Samples()
        if samples is not None:
            samples.add(values[: len(request.span)], at_ns)

    def _note_identity(self, transaction: Transaction) -> None:
        for one in identities(transaction):
            if len(self.identity) < MAX_TEXTS:
                self.identity.setdefault(one.name, one.text)
        if transaction.function not in FUNCTIONS and len(self.answer_words) < MAX_TEXTS:
            word = answer_word(transaction)
            if word is not None:
                self.answer_words.add((transaction.function, word))


def _requests(transaction: Transaction) -> list[tuple[ObservedRequest, Sequence[int] | None]]:
    """Return the kind of request of a transaction, with the values of the registers or bits that it
    reads or writes (None if it has none).

    For function 17H, return two: the read and the write.
    """
    function = transaction.function
    known = FUNCTIONS.get(function)
    table = known.table if known is not None else None
    if known is None or table is None or transaction.address is None:
        writes = known is not None and known.writes
        return [(ObservedRequest(function, None, None, 1, writes), None)]
    quantity = 1 if transaction.quantity is None else transaction.quantity
    if function == READ_WRITE_REGISTERS and transaction.write_address is not None:
        written = transaction.request_values or []
        read = ObservedRequest(function, table, transaction.address, quantity, False)
        write = ObservedRequest(function, table, transaction.write_address, len(written), True)
        return [(read, transaction.response_values), (write, written)]
    values = transaction.request_values if known.writes else transaction.response_values
    return [(ObservedRequest(function, table, transaction.address, quantity, known.writes), values)]
