"""Collects the slaves and masters in a capture: each unit of each host, and each master."""

# A slave's row stands for one unit at one host and port, or one unit of a serial line. The first of
# several equal requests is evaluated in full; later ones are found in a table by their fields and
# only counted.
#
# Limits: MAX_SLAVES units and MAX_MASTERS masters; in all MAX_USES combinations of unit, master and
# function; MAX_REQUESTS different requests that are compared with profiles; MAX_TEXTS identity
# texts of one name for each unit; the MAC addresses of inventory_seen.py and the ranges of
# inventory_ranges.py. `left_out` counts what exceeds a limit. MAX_POLLS limits only the table of
# equal requests: further requests are evaluated in full each time.

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from mbtool.devices.identity import answer_word
from mbtool.devices.model import READ_AND_WRITE
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.devices.references import write_reference
from mbtool.ledger.inventory_ranges import AddressRange, without
from mbtool.ledger.inventory_rows import (
    INVENTORY_FORMAT,
    FunctionUse,
    IdentityText,
    InventoryDocument,
    MasterRow,
    Role,
    SlaveRow,
)
from mbtool.ledger.inventory_seen import UNANSWERED, Seen, SeenMaster, SeenSlave, SeenUse
from mbtool.modbus.functions import FUNCTIONS, ExceptionCode
from mbtool.modbus.identification import identities
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mbtool.devices import NamedTransaction, Profile
    from mbtool.ledger.answered_run import AnsweredRun
    from mbtool.ledger.inventory_rows import ProfileFit

MAX_SLAVES = 65_536
MAX_MASTERS = 65_536
MAX_USES = 262_144
MAX_REQUESTS = 131_072
MAX_POLLS = 131_072
MAX_TEXTS = 4

MODEL_CODE = "model code"
_WHOLE_DEVICE = frozenset((0, 255))
"""Unit ids that address the host itself, and not a unit behind it (MODBUS Messaging on TCP/IP
V1.0b, 4.4.2)."""

_Poll = tuple[SeenSlave, "SeenMaster | None", tuple[SeenUse, ...]]


class Inventory:
    """Collects the slaves and masters that occur in transactions. Transactions are added with `add`
    or `add_run`; `document` returns the result.
    """

    def __init__(self) -> None:
        self.transactions = 0
        self.left_out: Counter[str] = Counter()
        self._slaves: dict[tuple[str, int | None, int], SeenSlave] = {}
        self._masters: dict[str, SeenMaster] = {}
        self._polls: dict[tuple[object, ...], _Poll] = {}
        self._uses = 0
        self._requests = 0

    def add(self, transaction: NamedTransaction) -> None:
        """Count a transaction for its slave, master and functions."""
        self.transactions += 1
        poll = self._poll(transaction)
        if poll is not None:
            start_ns, response_ns = transaction.start_ns, transaction.response_ns
            _count(transaction, 1, start_ns, start_ns if response_ns is None else response_ns, poll)

    def add_run(self, run: AnsweredRun) -> None:
        """Add a batch of answered requests at once. The result is the same as if `add` was called
        for each.
        """
        if len(self._polls) + len(run.kinds) > MAX_POLLS:
            for one in run.transactions():
                self.add(one)
            return
        self.transactions += len(run)
        for kind in run.kinds:
            poll = self._poll(kind.like)
            if poll is not None:
                _count(kind.like, kind.count, kind.begin_ns, kind.end_ns, poll)
                continue
            for _ in range(kind.count - 1):  # `_poll` counts each transaction as left out.
                self._poll(kind.like)

    def _poll(self, transaction: NamedTransaction) -> _Poll | None:
        """Return the entries in which a transaction is counted: its slave, its master and its
        functions.

        None if its slave has no row, because there are MAX_SLAVES others.
        """
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
                return None
            # A request without an address may ask for the slave's identity, and its response may
            # contain a new text. So it is not put into the table of equal requests, and each
            # response is evaluated.
            is_identity = transaction.address is None
            if not is_identity and len(self._polls) < MAX_POLLS:
                self._polls[key] = poll
        return poll

    def document(
        self,
        files: Sequence[str] = (),
        identify: Callable[[ObservedSlave], ProfileFit] | None = None,
        maker: Callable[[str], str | None] = lambda _: None,
        profiles: Mapping[str, Profile] | None = None,
    ) -> InventoryDocument:
        """Return the inventory as a document whose rows are sorted by host and unit.

        `files` are the names of the captures. `identify` compares a slave with profiles; if it is
        None, no slave is compared. `maker` returns the name of the manufacturer for a MAC address,
        None if unknown. `profiles` has the profiles by name, for the addresses of units that the
        user or a log has named.
        """
        gateways = self._gateways()
        rows = []
        for slave in self._slaves.values():
            row = _slave_row(slave, (slave.host, slave.port) in gateways, maker, profiles or {})
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
        """Return the entries in which a transaction is counted (its slave, master and functions);
        make those that are new.

        None if its slave has no row, because there are MAX_SLAVES others. `master` is the master's
        host, None on a serial line.
        """
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

    def _slave(self, transaction: NamedTransaction) -> SeenSlave | None:
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
            slave = self._slaves[key] = SeenSlave(
                *key,
                is_on_line=transaction.transport.is_serial and destination is None,
                seen=Seen(transaction.start_ns),
                observed=None,
            )
        return slave

    def _master(self, transaction: NamedTransaction, host: str | None) -> SeenMaster | None:
        if host is None:
            return None
        master = self._masters.get(host)
        if master is None:
            if len(self._masters) >= MAX_MASTERS:
                self.left_out["transactions are of masters without a row"] += 1
                return None
            master = self._masters[host] = SeenMaster(Seen(transaction.start_ns))
        return master

    def _uses_of(
        self, slave: SeenSlave, transaction: NamedTransaction, master: str | None
    ) -> tuple[SeenUse, ...]:
        """Return the entries in which a transaction's function is counted: one, or two for function
        17H, which reads and writes. An entry beyond MAX_USES is left out. `master` is the master's
        host, None on a serial line.
        """
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
        self, slave: SeenSlave, transaction: NamedTransaction, master: str | None, *, writes: bool
    ) -> SeenUse | None:
        key = (transaction.function, master, writes)
        use = slave.uses.get(key)
        if use is None:
            if self._uses >= MAX_USES:
                self.left_out["transactions are of functions without a row"] += 1
                return None
            self._uses += 1
            name = transaction.function_name
            use = slave.uses[key] = SeenUse(transaction.function, name, master, writes)
        return use

    def _observe(self, slave: SeenSlave, transaction: NamedTransaction) -> None:
        """Keep a request and its response for the comparison of the slave with profiles."""
        if slave.observed is None:
            if transaction.outcome in UNANSWERED:
                return  # A slave is compared with profiles only once it has answered.
            link = "" if transaction.destination is not None else transaction.link
            slave.observed = ObservedSlave(link, transaction.destination, transaction.unit)
        if self._requests >= MAX_REQUESTS:
            self.left_out["requests were not compared with profiles"] += 1
            return
        before = len(slave.observed.requests)
        slave.observed.note(transaction)
        self._requests += len(slave.observed.requests) - before

    def _gateways(self) -> set[tuple[str, int | None]]:
        """The pairs of host and port at which two or more units have answered; unit ids 0 and 255
        are not counted, as they may address the host itself.
        """
        units = Counter(
            (one.host, one.port)
            for one in self._slaves.values()
            if one.answered and not one.is_on_line and one.unit not in _WHOLE_DEVICE
        )
        return {place for place, count in units.items() if count > 1}


def _count(
    transaction: NamedTransaction, number: int, start_ns: int, end_ns: int, poll: _Poll
) -> None:
    """Count `number` transactions equal to this one for their slave, master and functions, which
    are `poll`.

    The first of these transactions began at `start_ns`, the last one ended at `end_ns` (UTC ns).
    """
    slave, master, uses = poll
    slave.seen.note(start_ns, end_ns, transaction.destination_mac)
    slave.outcomes[transaction.outcome] += number
    if transaction.exception is not None:
        if transaction.outcome is Outcome.EXCEPTION:
            slave.exceptions[transaction.exception] += number
    elif transaction.response_ns is not None and end_ns > slave.answered_ns:
        slave.answered_ns = end_ns
    if transaction.request_ns is None:
        return  # The capture lacks the request.
    for use in uses:
        use.requests += number
        if transaction.exception == ExceptionCode.ILLEGAL_FUNCTION:
            use.unsupported += number
    if master is not None:
        master.requests += number
        master.seen.note(start_ns, end_ns, transaction.source_mac)


def _widen(
    use: SeenUse | None, transaction: NamedTransaction, address: int | None, quantity: int | None
) -> None:
    """Add the addresses of a request, `quantity` (None for 1) from `address` on, to `use`, which is
    one function of one master at one slave.

    They go to the refused addresses if the response is an exception, else to the asked ones. Does
    nothing if `use` or `address` is None.
    """
    if use is None or address is None:
        return
    ranges = use.refused if transaction.exception is not None else use.asked
    ranges.add(address, address + max(1 if quantity is None else quantity, 1) - 1)


def _note_identity(slave: SeenSlave, transaction: NamedTransaction) -> None:
    """Keep the identity texts that a response contains: vendor, product, version, or a
    model code.
    """
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


def _slave_row(
    slave: SeenSlave,
    is_gateway: bool,
    maker: Callable[[str], str | None],
    profiles: Mapping[str, Profile],
) -> SlaveRow:
    profile = None if slave.device is None else profiles.get(slave.device)
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
        uses=[_use_row(use, profile) for _, use in sorted(slave.uses.items(), key=_use_order)],
        transactions=slave.outcomes.total(),
        answered=slave.answered,
        unanswered=slave.outcomes[Outcome.NO_ANSWER] + slave.unreached,
        unreached=slave.unreached,
        exceptions=dict(sorted(slave.exceptions.items())),
        first_ns=slave.seen.first_ns,
        last_ns=slave.seen.last_ns,
        answered_ns=slave.answered_ns,
    )


def _role(slave: SeenSlave, *, is_gateway: bool) -> Role:
    if slave.is_broadcast:
        return Role.BROADCAST
    if slave.answered:
        return Role.GATEWAY if is_gateway else Role.SLAVE
    if slave.outcomes[Outcome.NO_ANSWER] or slave.unreached:
        return Role.SILENT
    return Role.UNHEARD


def _use_order(item: tuple[tuple[int, str | None, bool], SeenUse]) -> tuple[bool, int, str]:
    function, master, writes = item[0]
    return writes, function, master or ""


def _use_row(use: SeenUse, profile: Profile | None) -> FunctionUse:
    asked = use.asked.pairs
    refused = without(use.refused.pairs, asked)
    return FunctionUse(
        function=use.function,
        name=use.name,
        master=use.master,
        writes=use.writes,
        requests=use.requests,
        unsupported=use.unsupported,
        ranges=asked,
        refused=refused,
        references=_references(use, asked, profile),
        refused_references=_references(use, refused, profile),
        left_out=use.asked.left_out + use.refused.left_out,
    )


def _references(use: SeenUse, ranges: Sequence[AddressRange], profile: Profile | None) -> list[str]:
    """Write the addresses of a function in the notation of a profile, "" where it has none."""
    known = FUNCTIONS.get(use.function)
    if profile is None or known is None or known.table is None:
        return []
    texts = []
    for first, last in ranges:
        span = known.table, first, last - first + 1
        text = write_reference(profile, *span, writing=use.writes)
        texts.append("" if text == write_reference(None, *span) else text)
    return texts


def _master_row(host: str, master: SeenMaster, maker: Callable[[str], str | None]) -> MasterRow:
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
    """Return a host without the brackets that enclose an IPv6 address: `::1` for `[::1]`; None for
    None.
    """
    if host is not None and host.startswith("[") and host.endswith("]"):
        return host[1:-1]
    return host


def _host_key(host: str) -> tuple[tuple[int, int | str], ...]:
    """Return a key to sort hosts by: IP addresses by number (10.0.0.9 before 10.0.0.10), names
    after them.
    """
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in host.split("."))
