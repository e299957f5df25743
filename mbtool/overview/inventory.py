"""Collects who is in a capture: every unit of every host, and every master."""

# A row is one unit of one host and port; on a serial line, of the line. A repeated request is found
# in a table, so that it costs only a few counts.
#
# Limits: MAX_SLAVES units and MAX_MASTERS masters; MAX_USES pairs of a master and a function in
# all; MAX_REQUESTS different requests that are compared with profiles; MAX_TEXTS texts of each
# name, MAX_MACS addresses for each host; the ranges of inventory_ranges.py. Whatever is beyond a
# limit is counted in `left_out`. MAX_POLLS only limits the requests that are looked up quickly.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.devices.identity import answer_word
from mbtool.devices.model import READ_AND_WRITE
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.modbus.functions import FUNCTIONS, ExceptionCode
from mbtool.modbus.identification import identities
from mbtool.modbus.transaction import Outcome
from mbtool.overview.inventory_ranges import AddressRanges, without
from mbtool.overview.inventory_rows import (
    INVENTORY_FORMAT,
    FunctionUse,
    IdentityText,
    InventoryDocument,
    MasterRow,
    Role,
    SlaveRow,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import NamedTransaction
    from mbtool.overview.inventory_rows import ProfileFit

MAX_SLAVES = 65_536
MAX_MASTERS = 65_536
MAX_USES = 262_144
MAX_REQUESTS = 131_072
MAX_POLLS = 131_072
MAX_TEXTS = 4
MAX_MACS = 4

MODEL_CODE = "model code"
_WHOLE_DEVICE = frozenset((0, 255))
"""Unit ids that address the host itself (MODBUS Messaging on TCP/IP V1.0b, 4.4.2)."""
_GATEWAY_EXCEPTIONS = frozenset(
    (ExceptionCode.GATEWAY_PATH_UNAVAILABLE, ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND)
)
"""Exceptions that a gateway sends when the unit behind it does not answer."""
_UNANSWERED = frozenset((Outcome.NO_ANSWER, Outcome.NOT_CAPTURED, Outcome.BROADCAST))


@dataclass(slots=True)
class _Seen:
    """When something was seen, and at which MAC addresses."""

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
class _SeenUse:
    function: int
    name: str
    master: str | None
    writes: bool
    requests: int = 0
    unsupported: int = 0
    asked: AddressRanges = field(default_factory=AddressRanges)
    """The addresses of requests that were not refused."""
    refused: AddressRanges = field(default_factory=AddressRanges)


@dataclass(slots=True)
class _SeenSlave:
    host: str
    port: int | None
    unit: int
    is_on_line: bool
    seen: _Seen
    observed: ObservedSlave | None
    transports: set[str] = field(default_factory=set)
    device: str | None = None
    identity: dict[tuple[int, str], list[str]] = field(default_factory=dict)
    uses: dict[tuple[int, str | None, bool], _SeenUse] = field(default_factory=dict)
    outcomes: Counter[Outcome] = field(default_factory=Counter)
    exceptions: Counter[int] = field(default_factory=Counter)
    answered_ns: int = 0

    @property
    def unreached(self) -> int:
        """The number of requests that only a gateway answered."""
        return sum(self.exceptions[code] for code in _GATEWAY_EXCEPTIONS)

    @property
    def answered(self) -> int:
        """The number of requests that the unit itself answered."""
        silent = sum(self.outcomes[one] for one in _UNANSWERED)
        return self.outcomes.total() - silent - self.unreached

    @property
    def is_broadcast(self) -> bool:
        return self.is_on_line and self.unit == 0


@dataclass(slots=True)
class _SeenMaster:
    seen: _Seen
    requests: int = 0
    slaves: set[int] = field(default_factory=set)
    """The slaves that this master asked, by `id()`."""
    written: set[int] = field(default_factory=set)


_Poll = tuple[_SeenSlave, "_SeenMaster | None", tuple[_SeenUse, ...]]


class Inventory:
    """The hosts and units in the transactions that were added."""

    def __init__(self) -> None:
        self.transactions = 0
        self.left_out: Counter[str] = Counter()
        self._slaves: dict[tuple[str, int | None, int], _SeenSlave] = {}
        self._masters: dict[str, _SeenMaster] = {}
        self._polls: dict[tuple[object, ...], _Poll] = {}
        self._uses = 0
        self._requests = 0

    def add(self, transaction: NamedTransaction) -> None:
        """Add one transaction."""
        self.transactions += 1
        source = transaction.source
        master = None if source is None else source.rpartition(":")[0]
        key = (
            transaction.destination or transaction.link,
            master,
            transaction.unit,
            transaction.function,
            transaction.address,
            transaction.quantity,
            transaction.write_address,
            transaction.outcome,
            transaction.exception,
        )
        poll = self._polls.get(key)
        if poll is None:
            poll = self._begin(transaction, master)
            if poll is None:
                return
            # Each answer of an identification is looked at, since it may give another text.
            is_identity = transaction.address is None
            if not is_identity and len(self._polls) < MAX_POLLS:
                self._polls[key] = poll
        _count(transaction, *poll)

    def document(
        self,
        files: Sequence[str] = (),
        identify: Callable[[ObservedSlave], ProfileFit] | None = None,
        maker: Callable[[str], str | None] = lambda _: None,
    ) -> InventoryDocument:
        """Everything collected, sorted by host and unit.

        `identify` compares a slave with profiles; `maker` tells who made the hardware with a MAC
        address.
        """
        gateways = self._gateways()
        rows = []
        for slave in self._slaves.values():
            row = _slave_row(slave, (slave.host, slave.port) in gateways, maker)
            observed = slave.observed
            if identify is not None and observed is not None:
                row.fit = identify(observed)
            rows.append(row)
        left_out = Counter(self.left_out)
        left_out["ranges were not kept"] += sum(use.left_out for row in rows for use in row.uses)
        return InventoryDocument(
            format=INVENTORY_FORMAT,
            files=list(files),
            transactions=self.transactions,
            slaves=sorted(rows, key=lambda row: (*_host_key(row.host), row.port or 0, row.unit)),
            masters=sorted(
                (_master_row(host, one, maker) for host, one in self._masters.items()),
                key=lambda row: _host_key(row.host),
            ),
            left_out=dict(+left_out),
        )

    def _begin(self, transaction: NamedTransaction, master: str | None) -> _Poll | None:
        """Find or make the entries that a request belongs to; None if its slave has no room."""
        slave = self._slave(transaction)
        if slave is None:
            return None
        asker = self._master(transaction, _bare(master))
        uses = self._uses_of(slave, transaction, _bare(master))
        slave.transports.add(transaction.transport.value)
        slave.device = slave.device or transaction.device
        self._observe(slave, transaction)
        _note_identity(slave, transaction)
        if asker is not None:
            number = id(slave)
            asker.slaves.add(number)
            if any(use.writes for use in uses):
                asker.written.add(number)
        return slave, asker, uses

    def _slave(self, transaction: NamedTransaction) -> _SeenSlave | None:
        destination = transaction.destination
        if destination is None:
            host, port = transaction.link, None
        else:
            text, _, number = destination.rpartition(":")
            host, port = _bare(text) or destination, int(number) if number.isdecimal() else None
        key = (host, port, transaction.unit)
        slave = self._slaves.get(key)
        if slave is None:
            if len(self._slaves) >= MAX_SLAVES:
                self.left_out["transactions are of slaves without a row"] += 1
                return None
            slave = self._slaves[key] = _SeenSlave(
                *key,
                is_on_line=transaction.transport.is_serial and destination is None,
                seen=_Seen(transaction.start_ns),
                observed=None,
            )
        return slave

    def _master(self, transaction: NamedTransaction, host: str | None) -> _SeenMaster | None:
        if host is None:
            return None
        master = self._masters.get(host)
        if master is None:
            if len(self._masters) >= MAX_MASTERS:
                self.left_out["transactions are of masters without a row"] += 1
                return None
            master = self._masters[host] = _SeenMaster(_Seen(transaction.start_ns))
        return master

    def _uses_of(
        self, slave: _SeenSlave, transaction: NamedTransaction, master: str | None
    ) -> tuple[_SeenUse, ...]:
        """The entries of a transaction's function: one, or a read and a write for 17H."""
        function = transaction.function
        known = FUNCTIONS.get(function)
        if function == READ_AND_WRITE:
            read = self._use(slave, transaction, master, writes=False)
            written = self._use(slave, transaction, master, writes=True)
            _widen(read, transaction, transaction.address, transaction.quantity)
            _widen(written, transaction, transaction.write_address, transaction.written_quantity)
            return tuple(one for one in (read, written) if one is not None)
        use = self._use(slave, transaction, master, writes=known is not None and known.writes)
        _widen(use, transaction, transaction.address, transaction.quantity)
        return () if use is None else (use,)

    def _use(
        self, slave: _SeenSlave, transaction: NamedTransaction, master: str | None, *, writes: bool
    ) -> _SeenUse | None:
        key = (transaction.function, master, writes)
        use = slave.uses.get(key)
        if use is None:
            if self._uses >= MAX_USES:
                self.left_out["transactions are of functions without a row"] += 1
                return None
            self._uses += 1
            name = transaction.function_name
            use = slave.uses[key] = _SeenUse(transaction.function, name, master, writes)
        return use

    def _observe(self, slave: _SeenSlave, transaction: NamedTransaction) -> None:
        """Keep a request and its response, to be compared with profiles."""
        if slave.observed is None:
            if transaction.outcome in _UNANSWERED:
                return  # A slave that never answers is not compared.
            link = "" if transaction.destination is not None else transaction.link
            slave.observed = ObservedSlave(link, transaction.destination, transaction.unit)
        if self._requests >= MAX_REQUESTS:
            self.left_out["requests were not compared with profiles"] += 1
            return
        before = len(slave.observed.requests)
        slave.observed.note(transaction)
        self._requests += len(slave.observed.requests) - before

    def _gateways(self) -> set[tuple[str, int | None]]:
        """The hosts where two units or more answer."""
        units = Counter(
            (one.host, one.port)
            for one in self._slaves.values()
            if one.answered and not one.is_on_line and one.unit not in _WHOLE_DEVICE
        )
        return {place for place, count in units.items() if count > 1}


def _count(
    transaction: NamedTransaction,
    slave: _SeenSlave,
    master: _SeenMaster | None,
    uses: tuple[_SeenUse, ...],
) -> None:
    """Count a transaction in the entries that it belongs to."""
    request_ns, response_ns = transaction.request_ns, transaction.response_ns
    start_ns = request_ns if request_ns is not None else response_ns or 0
    end_ns = response_ns if response_ns is not None else start_ns
    slave.seen.note(start_ns, end_ns, transaction.destination_mac)
    slave.outcomes[transaction.outcome] += 1
    if transaction.exception is not None:
        slave.exceptions[transaction.exception] += 1
    elif response_ns is not None and response_ns > slave.answered_ns:
        slave.answered_ns = response_ns
    if request_ns is None:
        return  # The capture lacks the request.
    for use in uses:
        use.requests += 1
        if transaction.exception == ExceptionCode.ILLEGAL_FUNCTION:
            use.unsupported += 1
    if master is not None:
        master.requests += 1
        master.seen.note(start_ns, end_ns, transaction.source_mac)


def _widen(
    use: _SeenUse | None, transaction: NamedTransaction, address: int | None, quantity: int | None
) -> None:
    """Add the addresses of a request to those of its function."""
    if use is None or address is None:
        return
    ranges = use.refused if transaction.exception is not None else use.asked
    ranges.add(address, address + max(1 if quantity is None else quantity, 1) - 1)


def _note_identity(slave: _SeenSlave, transaction: NamedTransaction) -> None:
    """Keep the texts in a response by which the slave identifies itself."""
    if transaction.response_raw is None or transaction.exception is not None:
        return
    function = transaction.function
    texts = [(one.name, one.text) for one in identities(transaction)]
    if function not in FUNCTIONS:
        word = answer_word(transaction)
        texts = [] if word is None else [(MODEL_CODE, f"{word:04X}H")]
    for name, text in texts:
        known = slave.identity.setdefault((function, name), [])
        if text not in known and len(known) < MAX_TEXTS:
            known.append(text)


def _slave_row(slave: _SeenSlave, is_gateway: bool, maker: Callable[[str], str | None]) -> SlaveRow:
    return SlaveRow(
        host=slave.host,
        port=slave.port,
        unit=slave.unit,
        role=_role(slave, is_gateway=is_gateway),
        transports=sorted(slave.transports),
        device=slave.device,
        macs=slave.seen.macs,
        makers=_makers(slave.seen.macs, maker),
        identity=[
            IdentityText(function=function, name=name, text=text)
            for (function, name), texts in slave.identity.items()
            for text in texts
        ],
        uses=[_use_row(use) for _, use in sorted(slave.uses.items(), key=_use_order)],
        transactions=slave.outcomes.total(),
        answered=slave.answered,
        unanswered=slave.outcomes[Outcome.NO_ANSWER] + slave.unreached,
        exceptions=dict(sorted(slave.exceptions.items())),
        first_ns=slave.seen.first_ns,
        last_ns=slave.seen.last_ns,
        answered_ns=slave.answered_ns,
    )


def _role(slave: _SeenSlave, *, is_gateway: bool) -> Role:
    if slave.is_broadcast:
        return Role.BROADCAST
    if slave.answered:
        return Role.GATEWAY if is_gateway else Role.SLAVE
    if slave.outcomes[Outcome.NO_ANSWER] or slave.unreached:
        return Role.SILENT
    return Role.UNHEARD


def _use_order(item: tuple[tuple[int, str | None, bool], _SeenUse]) -> tuple[bool, int, str]:
    function, master, writes = item[0]
    return writes, function, master or ""


def _use_row(use: _SeenUse) -> FunctionUse:
    asked = use.asked.pairs
    return FunctionUse(
        function=use.function,
        name=use.name,
        master=use.master,
        writes=use.writes,
        requests=use.requests,
        unsupported=use.unsupported,
        ranges=asked,
        refused=without(use.refused.pairs, asked),
        left_out=use.asked.left_out + use.refused.left_out,
    )


def _master_row(host: str, master: _SeenMaster, maker: Callable[[str], str | None]) -> MasterRow:
    return MasterRow(
        host=host,
        macs=master.seen.macs,
        makers=_makers(master.seen.macs, maker),
        requests=master.requests,
        slaves=len(master.slaves),
        written=len(master.written),
        first_ns=master.seen.first_ns,
        last_ns=master.seen.last_ns,
    )


def _makers(macs: Sequence[str], maker: Callable[[str], str | None]) -> list[str]:
    return list(dict.fromkeys(name for mac in macs if (name := maker(mac)) is not None))


def _bare(host: str | None) -> str | None:
    """A host without the brackets that an IPv6 address has before its port."""
    if host is not None and host.startswith("[") and host.endswith("]"):
        return host[1:-1]
    return host


def _host_key(host: str) -> tuple[tuple[int, int | str], ...]:
    """A key that sorts hosts by their numbers (10.0.0.9 before 10.0.0.10), names last."""
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in host.split("."))
