"""Makes the inventory: a row for each slave and each master, from the figures of the account."""

# The row of a slave stands for one unit at one host and port, or one unit of a serial line. Beyond
# its limits, the account (account.py) counts units together: these have no row, and `left_out` is
# their number.

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.devices.references import write_reference
from mbtool.ledger.account import OTHER_UNITS, Account
from mbtool.ledger.inventory_ranges import AddressRange, AddressRanges, without
from mbtool.ledger.inventory_rows import (
    INVENTORY_FORMAT,
    FunctionUse,
    IdentityText,
    InventoryDocument,
    MasterRow,
    ProfileFit,
    Role,
    SlaveRow,
)
from mbtool.ledger.observation import UNANSWERED
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.unit_account import MasterAccount, UnitAccount, UnitKey, UseAccount
from mbtool.modbus.functions import (
    FUNCTIONS,
    GATEWAY_EXCEPTIONS,
    READ_WRITE_REGISTERS,
    ExceptionCode,
)

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.devices.observed_slave import ObservedSlave

_WHOLE_DEVICE = frozenset((0, 255))
"""Unit ids that address the host itself, and not a unit behind it (MODBUS Messaging on TCP/IP
V1.0b, 4.4.2)."""


@dataclass(slots=True)
class _Use:
    """The use of one function by one master, with the counts of its polls."""

    use: UseAccount
    tally: RequestTally


@dataclass(slots=True)
class _Slave:
    """A unit, with all uses of its functions, and the sum of their counts."""

    unit: UnitAccount
    uses: list[_Use] = field(default_factory=list)
    tally: RequestTally = field(default_factory=RequestTally)

    @property
    def place(self) -> tuple[str, int | None]:
        """The host and the port of the slave; a serial line has its name and no port."""
        destination = self.unit.destination
        if destination is None:
            return self.unit.key.link, None
        host, _, port = destination.rpartition(":")
        return _bare(host) or destination, int(port) if port.isdecimal() else None

    @property
    def unreached(self) -> int:
        """The number of requests that a gateway answered with an exception, because it could not
        reach the unit.
        """
        return sum(self.tally.exceptions.get(code, 0) for code in GATEWAY_EXCEPTIONS)

    @property
    def answered(self) -> int:
        """The number of responses of the unit itself, exception responses included."""
        silent = sum(map(self.tally.count, UNANSWERED))
        return self.tally.transactions - silent - self.unreached

    @property
    def is_on_line(self) -> bool:
        return self.unit.destination is None


def inventory(
    account: Account,
    files: Sequence[str] = (),
    identify: Callable[[ObservedSlave], ProfileFit] | None = None,
    maker: Callable[[str], str | None] = lambda _: None,
    profiles: Mapping[str, Profile] | None = None,
) -> InventoryDocument:
    """Return the inventory as a document whose rows are sorted by host and unit.

    `account` has observed the units. `files` are the names of the captures. `identify` compares a
    slave with profiles; if it is None, no slave is compared. `maker` returns the name of the
    manufacturer for a MAC address, None if unknown. `profiles` has the profiles by name, for the
    addresses of units that the user or a log has named.
    """
    slaves, left_out = _slaves(account)
    gateways = _gateways(slaves)
    rows = []
    for slave in slaves:
        row = _slave_row(slave, slave.place in gateways, maker, profiles or {})
        observed = slave.unit.observed
        if identify is not None and observed is not None:
            row.fit = identify(observed)
        rows.append(row)
    left_out["transactions are of masters without a row"] = sum(
        use.tally.transactions
        for slave in slaves
        for use in slave.uses
        if use.use.master is None and use.use.key.master
    )
    if account.observation is not None:
        left_out["requests were not compared with profiles"] = account.observation.left_out
    left_out["ranges were not kept"] = sum(use.left_out for row in rows for use in row.uses)
    return InventoryDocument(
        format=INVENTORY_FORMAT,
        files=list(files),
        transactions=account.transactions,
        slaves=sorted(rows, key=lambda row: (*_host_key(row.host), row.port or 0, row.unit)),
        masters=sorted(_master_rows(account, slaves, maker), key=lambda row: _host_key(row.host)),
        left_out=dict(+left_out),
    )


def _slaves(account: Account) -> tuple[list[_Slave], Counter[str]]:
    """Return all units with their counts, and the number of transactions of those without a row."""
    left_out: Counter[str] = Counter()
    polls: dict[UseAccount, list[RequestTally]] = {}
    for poll in account.polls.values():
        polls.setdefault(poll.use, []).append(poll.tally)
    slaves: dict[UnitKey, _Slave] = {key: _Slave(unit) for key, unit in account.units.items()}
    for use in account.uses.values():
        tally = merged([use.tally, *polls.get(use, ())])
        if use.key.unit == OTHER_UNITS and use.unit.key not in slaves:
            left_out["transactions are of slaves or functions without a row"] += tally.transactions
            continue
        slave = slaves[use.unit.key]
        slave.uses.append(_Use(use, tally))
    for slave in slaves.values():
        slave.tally = merged([one.tally for one in slave.uses])
    return list(slaves.values()), left_out


def _gateways(slaves: Sequence[_Slave]) -> set[tuple[str, int | None]]:
    """The pairs of host and port at which two or more units have answered; unit ids 0 and 255 are
    not counted, as they may address the host itself.
    """
    units = Counter(
        one.place
        for one in slaves
        if one.answered and not one.is_on_line and one.unit.key.unit not in _WHOLE_DEVICE
    )
    return {place for place, count in units.items() if count > 1}


def _slave_row(
    slave: _Slave,
    is_gateway: bool,
    maker: Callable[[str], str | None],
    profiles: Mapping[str, Profile],
) -> SlaveRow:
    unit, tally = slave.unit, slave.tally
    profile = None if unit.device is None else profiles.get(unit.device)
    uses = [row for use in slave.uses for row in _use_rows(use, profile)]
    host, port = slave.place
    return SlaveRow(
        host=host,
        port=port,
        unit=unit.key.unit,
        role=_role(slave, is_gateway=is_gateway),
        transports=sorted(unit.transports),
        device=unit.device,
        macs=unit.macs,
        makers=_makers(unit.macs, maker),
        identity=[
            IdentityText(function=function, name=name, text=text)
            for (function, name), texts in unit.identity.items()
            for text in texts
        ],
        uses=sorted(uses, key=lambda row: (row.writes, row.function, row.master or "")),
        transactions=tally.transactions,
        answered=slave.answered,
        unanswered=tally.unanswered + slave.unreached,
        unreached=slave.unreached,
        exceptions=dict(sorted(tally.exceptions.items())),
        first_ns=unit.first_ns,
        last_ns=unit.last_ns,
        answered_ns=unit.ok_ns,
    )


def _role(slave: _Slave, *, is_gateway: bool) -> Role:
    if slave.is_on_line and not slave.unit.key.unit:
        return Role.BROADCAST
    if slave.answered:
        return Role.GATEWAY if is_gateway else Role.SLAVE
    if slave.tally.unanswered or slave.unreached:
        return Role.SILENT
    return Role.UNHEARD


def _use_rows(one: _Use, profile: Profile | None) -> Iterator[FunctionUse]:
    """Yield the row of a function, or two for function 17H, which reads and writes."""
    use, tally = one.use, one.tally
    function = use.key.function
    known = FUNCTIONS.get(function)
    is_write = known is not None and known.writes
    for writes in (False, True) if function == READ_WRITE_REGISTERS else (is_write,):
        asked = use.ranges.get((writes, False), AddressRanges())
        refused = use.ranges.get((writes, True), AddressRanges())
        only_refused = without(refused.pairs, asked.pairs)
        yield FunctionUse(
            function=function,
            name=use.name,
            master=use.key.master or None,
            writes=writes,
            requests=tally.requests,
            unsupported=tally.exceptions.get(ExceptionCode.ILLEGAL_FUNCTION, 0),
            ranges=asked.pairs,
            refused=only_refused,
            references=_references(function, asked.pairs, profile, writes=writes),
            refused_references=_references(function, only_refused, profile, writes=writes),
            left_out=asked.left_out + refused.left_out,
        )


def _references(
    function: int, ranges: Sequence[AddressRange], profile: Profile | None, *, writes: bool
) -> list[str]:
    """Write the addresses of a function in the notation of a profile, "" where it has none."""
    known = FUNCTIONS.get(function)
    if profile is None or known is None or known.table is None:
        return []
    texts = []
    for first, last in ranges:
        span = known.table, first, last - first + 1
        text = write_reference(profile, *span, writing=writes)
        texts.append("" if text == write_reference(None, *span) else text)
    return texts


def _master_rows(
    account: Account, slaves: Sequence[_Slave], maker: Callable[[str], str | None]
) -> list[MasterRow]:
    requests: Counter[MasterAccount] = Counter()
    asked: dict[MasterAccount, set[UnitKey]] = {}
    written: dict[MasterAccount, set[UnitKey]] = {}
    for slave in slaves:
        for one in slave.uses:
            master = one.use.master
            if master is None:
                continue
            requests[master] += one.tally.requests
            asked.setdefault(master, set()).add(slave.unit.key)
            known = FUNCTIONS.get(one.use.key.function)
            if known is not None and known.writes:
                written.setdefault(master, set()).add(slave.unit.key)
    return [
        MasterRow(
            host=host,
            macs=master.macs,
            makers=_makers(master.macs, maker),
            requests=requests[master],
            slaves=len(asked.get(master, ())),
            written=len(written.get(master, ())),
            first_ns=master.first_ns,
            last_ns=master.last_ns,
        )
        for host, master in account.masters.items()
    ]


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
