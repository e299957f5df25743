"""Plays several slaves of a recording at once, each on a link of its own."""

# The user says which slaves answer where, once or several times:
#
#     LINK                           all slaves of the recording, on one link
#     192.168.1.101=tcp:...:1502     the slaves of an address; WHO is as for --device: an address,
#                                    a port, a unit. Or it is the name of a serial line
#     all=tcp:127.0.0.0/24:1502      each slave that no other WHO names, on an address of its own
#
# In a network, a slave gets the address with its own last number (192.168.1.101 is 127.0.0.101) if
# that is free, else the lowest free one. Slaves on one serial line share a link: they had one.
#
# Each slave is played by its own RecordedSlave in a thread of its own. Their clocks start together,
# with the first request to any of them, and --start and --end count from the first request of the
# whole recording.
#
# Limits: MAX_LINKS links, as each takes a thread and a socket.

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Endpoint, InputError, LinkSpec, TcpLink, UsageError, parse_link
from mbtool.core.link_spec import ANSWERED, MODBUS_PORT
from mbtool.devices import parse_who
from mbtool.ports.allowed_peers import THIS_MACHINE, AllowedPeers
from mbtool.slave.shells import slave_link
from mbtool.slave.shells.shell_group import ShellGroup
from mbtool.workflows.replay_slave import PlayedSlave, SlaveRun
from mbtool.workflows.shared.read_all import unwatched
from mbtool.workflows.shared.recorded import demand_one_slave_each, read_recorded, where_none

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from mbtool.devices import NamedTransaction, Who
    from mbtool.slave.shells import OnExchange
    from mbtool.workflows.replay_slave import SlaveOptions
    from mbtool.workflows.shared.read_all import Watch

MAX_LINKS = 256
ALL = "all"
_SCHEME = re.compile(r"(?:rtu|ascii|rtutap|asciitap|net|tap|tcp|rtu\+tcp):")
_NETWORK = re.compile(
    r"(?P<scheme>tcp|rtu\+tcp):\[?(?P<network>[0-9a-fA-F.:]+/\d{1,3})\]?(?::(?P<port>\d{1,5}))?"
)
_FEW = 6

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Address = ipaddress.IPv4Address | ipaddress.IPv6Address


@dataclass(frozen=True, slots=True)
class SiteRule:
    """One --on: which slaves answer on which link."""

    who: str | None
    """The text of WHO; None if the user has given a link only."""
    link_text: str
    link: LinkSpec | None
    """None for a network, in which each slave gets an address of its own."""
    network: Network | None = None
    port: int = MODBUS_PORT
    rtu: bool = False

    @classmethod
    def parse(cls, text: str) -> SiteRule:
        """Read the text of --on. Raises UsageError for another form, and for other links than a
        slave can use.
        """
        who, equals, link_text = text.partition("=")
        if not equals or _SCHEME.match(text):
            return cls(None, text, slave_link(parse_link(text, ANSWERED)))
        match = _NETWORK.fullmatch(link_text)
        if match is None:
            return cls(who, link_text, slave_link(parse_link(link_text, ANSWERED)))
        port = int(match["port"] or MODBUS_PORT)
        try:
            network = ipaddress.ip_network(match["network"], strict=False)
        except ValueError as error:
            raise UsageError(f"--on {text}: {error}") from None
        if port > 65535:
            raise UsageError(f"--on {text}: {port} is no TCP port")
        return cls(who, link_text, None, network, port, match["scheme"] != "tcp")


class SitePlayer(NamedTuple):
    """A slave of the recording, or all slaves of an address or line, ready to answer on a link."""

    name: str
    """How the recording calls it: an address, or the name of a serial line; for all slaves of a
    recording the name of the link on which they answer."""
    run: SlaveRun
    link: LinkSpec


class SiteRun:
    """A recording, read and divided into the slaves that answer on different links."""

    def __init__(
        self,
        path: str,
        on: Sequence[str],
        options: SlaveOptions,
        on_remark: Callable[[str], None] = lambda _: None,
        watch: Watch = unwatched,
    ) -> None:
        """Read the recording.

        Raises UsageError for a wrong --on, for a WHO that is not in the recording, and for several
        slaves with one unit on one link; and the errors of SlaveRun.
        """
        rules = [SiteRule.parse(text) for text in on]
        _demand_who(on, rules)
        is_whole = rules[0].who is None
        recorded = read_recorded(path, options, on_remark, watch, may_repeat_units=not is_whole)
        asked = [one for one in recorded.transactions if one.request_raw is not None]
        origin_ns = None if is_whole else min((one.start_ns for one in asked), default=None)
        parts = _whole(rules[0]) if is_whole else _divided(path, rules, asked, on_remark)
        self.players: list[SitePlayer] = []
        for part in parts:
            chosen = recorded.transactions
            if not is_whole:
                chosen = [one for one in recorded.transactions if part.holds(one)]
                demand_one_slave_each(path, chosen)
            own = recorded._replace(transactions=chosen)
            try:
                run = SlaveRun(path, options, recorded=own, origin_ns=origin_ns)
            except InputError as error:  # No request to this slave is in the part to play.
                if len(parts) == 1:
                    raise
                on_remark(f"mbtool: {part.name}: not played: {error}")
                continue
            self.players.append(SitePlayer(part.name, run, part.link))
        if not self.players:
            raise InputError(
                f"{path}: no request to play an answer for{where_none(options.window)}"
            )

    def play(
        self,
        *,
        allowed: AllowedPeers = THIS_MACHINE,
        on_exchange: Callable[[SitePlayer], OnExchange | None] = lambda _: None,
    ) -> PlayedSite:
        """Return the slaves on their links, not yet started.

        `on_exchange` gives what gets each request and response of a slave.
        """
        return PlayedSite(
            [
                (one, one.run.on(one.link, allowed=allowed, on_exchange=on_exchange(one)))
                for one in self.players
            ]
        )


class PlayedSite:
    """The slaves of a recording on their links, with one clock for all."""

    def __init__(self, played: Sequence[tuple[SitePlayer, PlayedSlave]]) -> None:
        self.played = played
        self.shells = ShellGroup([slave.shell for _, slave in played])
        self._has_begun = False
        for _, slave in played:
            slave.before_request = self._begin

    def _begin(self) -> None:
        """Start all clocks at the first request. Called in the threads of all shells."""
        if not self._has_begun:
            self._has_begun = True
            for _, slave in self.played:
                slave.begin()


class _SitePart(NamedTuple):
    """The slaves that answer on one link."""

    name: str
    link: LinkSpec
    slaves: frozenset[tuple[str, int]] | None
    """The places and units of the slaves; None for all."""

    def holds(self, transaction: NamedTransaction) -> bool:
        key = _place(transaction), transaction.unit
        return self.slaves is None or key in self.slaves


def _place(transaction: NamedTransaction) -> str:
    """Where a slave was: its address and port, or the name of its serial line."""
    return transaction.destination or transaction.link


def _name(place: str) -> str:
    """A place as a user would write it: without the usual port."""
    return place.removesuffix(f":{MODBUS_PORT}").strip("[]") if ":" in place else place


def _demand_who(on: Sequence[str], rules: Sequence[SiteRule]) -> None:
    """Raise UsageError if one of several --on does not say which slaves it is for."""
    if len(rules) > 1:
        for text, rule in zip(on, rules, strict=True):
            if rule.who is None:
                raise UsageError(
                    f"--on {text}: with several --on, each says which slaves answer there: "
                    f"--on WHO={text}"
                )


def _whole(rule: SiteRule) -> list[_SitePart]:
    assert rule.link is not None
    return [_SitePart(rule.link.name, rule.link, None)]


def _divided(
    path: str,
    rules: Sequence[SiteRule],
    asked: Iterable[NamedTransaction],
    on_remark: Callable[[str], None],
) -> list[_SitePart]:
    """The slaves of a recording, divided by the rules; the most specific WHO counts."""
    slaves = dict.fromkeys((_place(one), one.unit, one.destination) for one in asked)
    lines = {place for place, _, destination in slaves if destination is None}
    patterns = [None if rule.who in lines else parse_who(rule.who or "") for rule in rules]
    order = sorted(range(len(rules)), key=lambda index: -_specificity(patterns[index]))
    of_rule: dict[int, list[tuple[str, int]]] = {index: [] for index in order}
    left = []
    for place, unit, destination in slaves:
        for index in order:
            who = patterns[index]
            fits = rules[index].who == place if who is None else who.fits_slave(destination, unit)
            if fits:
                of_rule[index].append((place, unit))
                break
        else:
            left.append(place)
    if left:
        on_remark(f"mbtool: not played: {_listed(left)}; --on all=LINK is for the rest")
    parts = []
    taken: set[Address] = set()
    for index, rule in enumerate(rules):
        if not of_rule[index]:
            known = _listed([place for place, _, _ in slaves]) or "none"
            raise UsageError(f"--on {rule.who}={rule.link_text}: {path} has no such slave: {known}")
        parts += _parts(rule, of_rule[index], taken)
    if len(parts) > MAX_LINKS:
        raise UsageError(f"{path}: {len(parts)} slaves; at most {MAX_LINKS} links are played")
    return parts


def _specificity(who: Who | None) -> int:
    return 8 if who is None else who.specificity


def _parts(
    rule: SiteRule, slaves: Sequence[tuple[str, int]], taken: set[Address]
) -> list[_SitePart]:
    """One part for a link; for a network, one for each place, on an address of its own."""
    if rule.link is not None:
        return [_SitePart(rule.who or ALL, rule.link, frozenset(slaves))]
    assert rule.network is not None
    parts = []
    for place in sorted(dict.fromkeys(place for place, _ in slaves), key=_sort_key):
        address = _free_address(rule, _name(place), taken)
        taken.add(address)
        link = TcpLink(Endpoint(str(address), rule.port), rule.rtu)
        here = frozenset(slave for slave in slaves if slave[0] == place)
        parts.append(_SitePart(_name(place), link, here))
    return parts


def _sort_key(place: str) -> tuple[int, int, str]:
    address = _address(_name(place))
    return (0, int(address), place) if address is not None else (1, 0, place)


def _address(name: str) -> Address | None:
    host = name if name.count(":") != 1 else name.partition(":")[0]
    try:
        return ipaddress.ip_address(host.partition("]")[0])
    except ValueError:
        return None


def _free_address(rule: SiteRule, name: str, taken: set[Address]) -> Address:
    """The address of the network that ends as the slave's own does; if taken, the lowest free."""
    network = rule.network
    assert network is not None
    own = _address(name)
    if own is not None and own.version == network.version:
        same = network[int(own) & int(network.hostmask)]
        edges = (network.network_address, network.broadcast_address)
        if same not in taken and (same not in edges or network.num_addresses <= 2):
            return same
    for address in network.hosts():
        if address not in taken:
            return address
    raise UsageError(f"--on {rule.who}={rule.link_text}: has too few addresses for the slaves")


def _listed(places: Iterable[str]) -> str:
    names = list(dict.fromkeys(_name(place) for place in places))
    more = f" and {len(names) - _FEW} more" if len(names) > _FEW else ""
    return f"{', '.join(names[:_FEW])}{more}"
