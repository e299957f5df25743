"""Finds NET-TWO-MACS and NET-ROLE: hosts with two MAC addresses, slaves that send requests."""

# NET-TWO-MACS  A host has two MAC addresses, each seen MIN_MAC_USES times (in packets from the host
# or to
#               it), and talks with a host of its own network (equal first three numbers of the IPv4
#               address). So another machine answers in its place (ARP spoofing), or two devices
#               have one IP address. Hosts of other networks are left out: they have the MAC address
#               of a router, or several if the capture was made on both sides of it. Left out are
#               also the shared addresses of router pairs (VRRP, HSRP), and a device that was
#               replaced: its second address comes only after the last packet with the first one,
#               and no third host has it.
# NET-ROLE      A host that answered as a slave sends requests itself, and the first one comes
#               LATER_NS or more after its first answer. Data concentrators do both from the
#               beginning.
#
# Memory: MAX_HOSTS hosts, with at most MAX_MACS addresses each.

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

from mbtool.core.moments import host_of
from mbtool.modbus import Outcome
from mbtool.troubles.sense import Sense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Sureness, Trouble

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.statistics_report import LinkReport

MAX_HOSTS = 4096
"""Addresses are kept for at most this many hosts; further hosts are ignored."""
MAX_MACS = 4
"""At most this many MAC addresses are kept for each host."""
MIN_MAC_USES = 3
"""A MAC address of a host counts for NET-TWO-MACS only if it was seen in at least this many
transactions."""
LATER_NS = 30_000_000_000
"""NET-ROLE is reported if a host sent its first request at least this long (ns) after its first
answer."""
_ANSWERED = frozenset((Outcome.OK, Outcome.EXCEPTION, Outcome.LATE))
_SHARED = ("00:00:5e:00:01:", "00:00:5e:00:02:", "00:00:0c:07:ac:", "00:00:0c:9f:f")
"""The beginnings of the MAC addresses that routers share (VRRP, HSRP); they prove no second
host."""
_IN_A_NETWORK = re.compile(r"(\d+\.\d+\.\d+)\.\d+")


@dataclass(slots=True)
class _Mac:
    count: int
    first_ns: int
    last_ns: int


@dataclass(slots=True)
class _SeenHost:
    macs: dict[str, _Mac] = field(default_factory=dict)
    is_local: bool = False
    """True if the host talked with a host of its own network."""
    link: str = ""
    slave_ns: int | None = None
    """The time (UTC ns) of the host's first answer as a slave."""
    master_ns: int | None = None
    """The time (UTC ns) of the host's first request."""
    requests: int = 0
    asked: str = ""
    """The slave to which the host sent its first request."""
    cases: list[Evidence] = field(default_factory=list)
    mac_cases: list[Evidence] = field(default_factory=list)


class Hosts(Sense):
    """Finds NET-TWO-MACS and NET-ROLE."""

    def __init__(self) -> None:
        self._hosts: dict[str, _SeenHost] = {}

    def transaction(self, one: NamedTransaction) -> None:
        if not one.transport.is_serial:
            self._note(one, 1, one.start_ns, one.start_ns)

    def run(self, run: QuietRun) -> None:
        for form in run.forms:
            place = form.places[0]
            at_ns, packets = run.rows.request_ns[place], run.packets(place)
            first = Evidence(ts_ns=at_ns, file=run.file, packets=packets)
            self._note(form.like, len(form.places), form.begin_ns, form.end_ns, first)

    def _note(
        self,
        one: NamedTransaction,
        count: int,
        begin_ns: int,
        end_ns: int,
        evidence: Evidence | None = None,
    ) -> None:
        master, slave = host_of(one.source), host_of(one.destination)
        is_local = _network(master) is not None and _network(master) == _network(slave)
        ends = [(master, one.source_mac, True), (slave, one.destination_mac, False)]
        if one.response_mac is not None:
            ends.append((slave, one.response_mac, False))
        for name, mac, is_master in ends:
            host = self._hosts.get(name)
            if host is None:
                if not name or len(self._hosts) >= MAX_HOSTS:
                    continue
                host = self._hosts[name] = _SeenHost()
            host.is_local |= is_local
            if mac is not None:
                _note_mac(host, mac, one, count, begin_ns, end_ns)
            if is_master and one.request_ns is not None:
                host.master_ns = min(begin_ns, host.master_ns or begin_ns)
                host.requests += count
                host.asked = host.asked or one.link
                if len(host.cases) < MAX_EVIDENCE:
                    host.cases.append(evidence or Evidence.of(one))
            elif not is_master and one.outcome in _ANSWERED:
                host.slave_ns = min(begin_ns, host.slave_ns or begin_ns)
                host.link = host.link or one.link

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        owners: dict[str, set[str]] = {}
        for name, host in self._hosts.items():
            for mac in host.macs:
                owners.setdefault(mac, set()).add(name)
        known = {link.name for link in links if link.is_whole}
        for name, host in self._hosts.items():
            link = host.link if host.link in known else host.asked
            if link not in known:
                continue
            macs = {mac: one for mac, one in host.macs.items() if one.count >= MIN_MAC_USES}
            if len(macs) > 1 and host.is_local and not _was_replaced(macs, owners):
                often = sorted(macs, key=lambda mac: -macs[mac].count)
                yield Trouble(
                    code="NET-TWO-MACS", link=link, master=name, count=macs[often[1]].count,
                    of=sum(one.count for one in macs.values()),
                    figures={"macs": " and ".join(often)}, sureness=Sureness.LIKELY,
                    evidence=tuple(host.mac_cases),
                )  # fmt: skip
            if host.slave_ns is None or host.master_ns is None:
                continue
            if host.master_ns - host.slave_ns >= LATER_NS:
                yield Trouble(
                    code="NET-ROLE", link=link, master=name, count=host.requests,
                    since_ns=host.master_ns, figures={"asked": host.asked},
                    evidence=tuple(host.cases),
                )  # fmt: skip


def _note_mac(
    host: _SeenHost, mac: str, one: NamedTransaction, count: int, begin_ns: int, end_ns: int
) -> None:
    if mac.startswith(_SHARED):
        return
    known = host.macs.get(mac)
    if known is None:
        if len(host.macs) < MAX_MACS:
            host.macs[mac] = _Mac(count, begin_ns, end_ns)
            host.mac_cases.append(Evidence.of(one, f"with the MAC address {mac}"))
        return
    known.count += count
    known.first_ns, known.last_ns = min(known.first_ns, begin_ns), max(known.last_ns, end_ns)


def _was_replaced(macs: dict[str, _Mac], owners: dict[str, set[str]]) -> bool:
    """True if one address came after the other one, and no other host has it."""
    in_order = sorted(macs.items(), key=lambda item: item[1].first_ns)
    follow = all(
        before.last_ns <= after.first_ns for (_, before), (_, after) in itertools.pairwise(in_order)
    )
    return follow and len(owners[in_order[-1][0]]) == 1


@lru_cache(maxsize=MAX_HOSTS)
def _network(host: str) -> str | None:
    match = _IN_A_NETWORK.fullmatch(host)
    return None if match is None else match[1]
