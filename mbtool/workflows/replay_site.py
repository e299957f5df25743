"""Replays several slaves of a recording at once, each on a link of its own."""

# With the option --on, given once or several times, the user says which slaves answer where:
#
#     LINK                           all slaves of the recording, on one link
#     192.168.1.101=tcp:...:1502     the slaves of an address; WHO is as for --device: an address,
#                                    a port, a unit. Or it is the name of a serial line
#     all=tcp:127.0.0.0/24:1502      each slave that no other WHO names, on an address of its own
#
# If the link is a network (/24), a slave gets the address that ends with the same numbers as its
# own (127.0.0.101 for 192.168.1.101) if that is free, else the lowest free one. The slaves of one
# recorded serial line share a link, as they did when they were recorded.
#
# Each link has its own RecordedSlave and thread. The clocks of all start together, with the first
# request to any of them, and --start and --end count from the first request of the whole recording.
#
# Limits: MAX_LINKS links, as each takes a thread and a socket.

from __future__ import annotations

import ipaddress
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mbtool.core import Endpoint, InputError, LinkSpec, TcpLink, UsageError, parse_link
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.link_spec import ANSWERED
from mbtool.devices import NamedTransaction, Who, parse_who
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers
from mbtool.slave.shells import OnExchange, slave_link
from mbtool.slave.shells.opening import ShellGroup
from mbtool.workflows.replay_slave import PlayedSlave, SlaveOptions, SlaveRun
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.recorded import demand_one_slave_each, read_recorded, where_none

MAX_LINKS = 256
ALL = "all"
_SCHEME = re.compile(r"(?:rtu|ascii|rtutap|asciitap|net|tap|(?:rtu\+)?(?:tcp|udp)):")
_NETWORK = re.compile(
    r"(?P<scheme>(?:rtu\+)?(?:tcp|udp)):\[?(?P<network>[0-9a-fA-F.:]+/\d{1,3})\]?(?::(?P<port>\d{1,5}))?"
)
_MOST_NAMED = 6
"""A text has at most this many names."""

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Address = ipaddress.IPv4Address | ipaddress.IPv6Address


@dataclass(frozen=True, slots=True)
class SiteRule:
    """The value of one option --on, `WHO=LINK` or `LINK`: which slaves answer on which link."""

    who: str | None
    """The text WHO, which names slaves of the recording (`192.168.1.101`, `all`); None if the user
    gave only a link."""
    link_text: str
    link: LinkSpec | None
    """The link on which the slaves answer; None if it is a network, in which each slave gets an
    address of its own."""
    network: Network | None = None
    port: int = MODBUS_PORT
    rtu: bool = False
    is_udp: bool = False

    @classmethod
    def parse(cls, text: str) -> SiteRule:
        """Parse one value of --on. Raises UsageError if it is not of a known form, or if no slave
        can answer on its link.
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
            raise UsageError(f"--on {text}: {port} is no port")
        scheme = match["scheme"]
        is_rtu, is_udp = scheme.startswith("rtu+"), scheme.endswith("udp")
        return cls(who, link_text, None, network, port, is_rtu, is_udp)


class SitePlayer(NamedTuple):
    """The slaves of the recording that answer on one link, ready to be played."""

    name: str
    """The recorded address of the slaves, or the name of their serial line; if all slaves of the
    recording answer on one link, the name of that link."""
    run: SlaveRun
    link: LinkSpec


class SiteRun:
    """Reads a recording, and divides its slaves among the links on which they will answer."""

    def __init__(
        self,
        path: str,
        on: Sequence[str],
        options: SlaveOptions,
        on_remark: Callable[[str], None] = lambda _: None,
        watch: Watch = unwatched,
    ) -> None:
        """Read the recording; `on` has the values of the options --on.

        `on_remark` gets lines for the user. Raises UsageError for a wrong --on, for a WHO that fits
        no slave of the recording, and for several slaves with the same unit on one link. Raises
        InputError if the file cannot be read or has no request to answer.
        """
        rules = [SiteRule.parse(text) for text in on]
        _demand_who(on, rules)
        is_whole = rules[0].who is None
        recorded = read_recorded(path, options, on_remark, watch, may_repeat_units=not is_whole)
        asked = [one for one in recorded.transactions if one.request_raw is not None]
        origin_ns = None if is_whole else min((one.start_ns for one in asked), default=None)
        parts = (
            _undivided_part(rules[0]) if is_whole else _parts_by_rule(path, rules, asked, on_remark)
        )
        self.players: list[SitePlayer] = []
        for part in parts:
            chosen = recorded.transactions
            if not is_whole:
                chosen = [one for one in recorded.transactions if part.holds(one)]
                demand_one_slave_each(path, chosen)
            own = recorded._replace(transactions=chosen)
            try:
                run = SlaveRun(path, options, on_remark, recorded=own, origin_ns=origin_ns)
            except InputError as error:  # This slave gets no request between --start and --end.
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

        Only masters in `allowed` may connect. `on_exchange` gets each player, and returns a
        function that is called with each request and its response there, or None for no calls.
        """
        return PlayedSite(
            [
                (one, one.run.create_slave(one.link, allowed=allowed, on_exchange=on_exchange(one)))
                for one in self.players
            ]
        )


class PlayedSite:
    """The slaves of a recording on their links. Their clocks start together, at the first request
    on any link.
    """

    def __init__(self, played: Sequence[tuple[SitePlayer, PlayedSlave]]) -> None:
        self.played = played
        self.shells = ShellGroup([slave.shell for _, slave in played])
        self._has_begun = False
        for _, slave in played:
            slave.before_request = self._begin

    def _begin(self) -> None:
        """Start the clocks of all slaves. Each link's thread calls this before each request; only
        the first call of all has an effect.
        """
        if not self._has_begun:
            self._has_begun = True
            for _, slave in self.played:
                slave.begin()


class _SitePart(NamedTuple):
    """Slaves of the recording, and the link on which they answer."""

    name: str
    link: LinkSpec
    slaves: frozenset[tuple[str, int]] | None
    """The slaves as pairs: the recorded address (or the name of the serial line) and the unit. None
    for all slaves."""

    def holds(self, transaction: NamedTransaction) -> bool:
        key = _place(transaction), transaction.unit
        return self.slaves is None or key in self.slaves


def _place(transaction: NamedTransaction) -> str:
    """Return the place of a transaction's slave in the recording: its address and port, or the name
    of its serial line.
    """
    return transaction.destination or transaction.link


def _name(place: str) -> str:
    """A recorded place as the user writes it: an address without port 502, or the name of a serial
    line.
    """
    return place.removesuffix(f":{MODBUS_PORT}").strip("[]") if ":" in place else place


def _demand_who(on: Sequence[str], rules: Sequence[SiteRule]) -> None:
    """Raise UsageError if `on` has several values and one of them has no WHO. `rules` are the
    values parsed.
    """
    if len(rules) > 1:
        for text, rule in zip(on, rules, strict=True):
            if rule.who is None:
                raise UsageError(
                    f"--on {text}: with several --on, each says which slaves answer there: "
                    f"--on WHO={text}"
                )


def _undivided_part(rule: SiteRule) -> list[_SitePart]:
    assert rule.link is not None
    return [_SitePart(rule.link.name, rule.link, None)]


def _parts_by_rule(
    path: str,
    rules: Sequence[SiteRule],
    asked: Iterable[NamedTransaction],
    on_remark: Callable[[str], None],
) -> list[_SitePart]:
    """Divide the slaves that `asked` (the transactions with a request) shows among the links of the
    rules.

    If several rules fit a slave, the one with the most specific WHO counts. `path` is the recording
    in messages; `on_remark` gets a remark on slaves that no rule fits.
    """
    slaves = dict.fromkeys((_place(one), one.unit, one.destination) for one in asked)
    lines = {place for place, _, destination in slaves if destination is None}
    patterns = [None if rule.who in lines else parse_who(rule.who or "") for rule in rules]
    order = sorted(range(len(rules)), key=lambda index: -_specificity(patterns[index]))
    of_rule: dict[int, list[tuple[str, int]]] = {index: [] for index in order}
    fitting: set[int] = set()
    """The indices of the rules that fit a slave, also one that a more specific rule has."""
    left = []
    for place, unit, destination in slaves:
        fits = [
            index
            for index in order
            if _fits(rules[index].who, patterns[index], place, unit, destination)
        ]
        fitting.update(fits)
        if fits:
            of_rule[fits[0]].append((place, unit))
        else:
            left.append(place)
    if not slaves:
        raise UsageError(
            f"{path} has no transaction to play; for another port than {MODBUS_PORT} name it with "
            "--port, or --port any"
        )
    known = _listed([place for place, _, _ in slaves])
    for index, rule in enumerate(rules):
        if not of_rule[index]:
            why = "each slave that it fits has a closer --on"
            if index not in fitting:
                why = f"{path} has no such slave, but {known}"
            raise UsageError(f"--on {rule.who}={rule.link_text}: {why}")
    if left:
        on_remark(f"mbtool: not played: {_listed(left)}; --on all=LINK is for the rest")
    parts = []
    taken: set[Address] = set()
    for index, rule in enumerate(rules):
        parts += _parts(rule, of_rule[index], taken)
    if len(parts) > MAX_LINKS:
        raise UsageError(f"{path}: {len(parts)} slaves; at most {MAX_LINKS} links are played")
    return parts


def _fits(
    text: str | None, who: Who | None, place: str, unit: int, destination: str | None
) -> bool:
    """True if WHO, written as `text`, names a slave; `who` is None for the name of a line."""
    return text == place if who is None else who.fits_slave(destination, unit)


def _specificity(who: Who | None) -> int:
    return 8 if who is None else who.specificity


def _parts(
    rule: SiteRule, slaves: Sequence[tuple[str, int]], taken: set[Address]
) -> list[_SitePart]:
    """Put the slaves of a rule (pairs of recorded place and unit) on its link.

    If the link is a network, the slaves of each place get a free address of it, which is added to
    `taken`.
    """
    if rule.link is not None:
        return [_SitePart(rule.who or ALL, rule.link, frozenset(slaves))]
    assert rule.network is not None
    parts = []
    for place in sorted(dict.fromkeys(place for place, _ in slaves), key=_sort_key):
        address = _free_address(rule, _name(place), taken)
        taken.add(address)
        link = TcpLink(Endpoint(str(address), rule.port), rule.rtu, is_udp=rule.is_udp)
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
    """Return an address in the network of a rule that is not in `taken`, for a slave whose recorded
    address is `name`.

    It is the address that ends with the same numbers as `name`, or, if that is taken, the lowest
    free one. Raises UsageError if none is free.
    """
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
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"{', '.join(names[:_MOST_NAMED])}{more}"
