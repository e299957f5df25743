"""Sick and healthy networks with Modbus/TCP."""

# Connections are simulated packet by packet, without congestion control: each request has its
# segment, each response acknowledges it, and the master acknowledges the response 40 ms later if it
# has sent nothing else. Checksums are 0, as with checksum offload.

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import partial
from random import Random
from typing import TYPE_CHECKING

from tests.adversary.illnesses.case import (
    ALONE,
    BESIDES,
    DEAD,
    MEDIUM,
    MILD,
    REFUSING,
    SEVERE,
    SEVERITIES,
    SLOW,
    WITH,
    Case,
    Recording,
)
from tests.adversary.illnesses.files import EXACT, POLLED, write_pcap
from tests.adversary.illnesses.wire import MS, SECOND

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

SECONDS = 180
FIN, SYN, RST, PUSH, ACK = 1, 2, 4, 8, 16
DEAD_UNIT, SLOW_UNIT, REFUSED = 77, 78, 900
ACK_NS = 40 * MS
SHARE = {MILD: 0.05, MEDIUM: 0.25, SEVERE: 0.8}


@dataclass(frozen=True, slots=True)
class Host:
    """A host with its number: the last byte of its MAC and IP address."""

    number: int

    @property
    def mac(self) -> bytes:
        return bytes([2, 0, 0, 0, 0, self.number])

    @property
    def ip(self) -> bytes:
        return bytes([10, 0, 0, self.number])


@dataclass(slots=True)
class Packet:
    """A packet that was captured."""

    at_ns: int
    data: bytes
    source: int


@dataclass(slots=True)
class Network:
    """All that the tap sees."""

    random: Random
    packets: list[Packet] = field(default_factory=list)
    ports: int = 49200

    def send(self, at_ns: int, source: Host, target: Host, tcp: bytes) -> None:
        ip = struct.pack(
            ">BBHHHBBH", 0x45, 0, 20 + len(tcp), len(self.packets) & 0xFFFF, 0x4000, 64, 6, 0
        )
        data = target.mac + source.mac + b"\x08\0" + ip + source.ip + target.ip + tcp
        self.packets.append(Packet(at_ns, data.ljust(60, b"\0"), source.number))


@dataclass(slots=True)
class Tcp:
    """One connection; index 0 is the master's end, 1 the slave's."""

    network: Network
    hosts: tuple[Host, Host]
    ports: list[int] = field(default_factory=lambda: [0, 502])
    numbers: list[int] = field(default_factory=lambda: [0, 0])
    acknowledged: list[int] = field(default_factory=lambda: [0, 0])
    ids: int = 0

    def open(self, at_ns: int) -> None:
        self.network.ports += 1
        self.ports[0] = self.network.ports
        self.numbers = [self.network.random.randrange(1 << 31) for _ in range(2)]
        self._segment(at_ns, 0, SYN)
        self.numbers[0] += 1
        self._segment(at_ns + 200_000, 1, SYN | ACK)
        self.numbers[1] += 1
        self._segment(at_ns + 250_000, 0, ACK)

    def close(self, at_ns: int, end: int = 0) -> None:
        self._segment(at_ns, end, FIN | ACK)
        self.numbers[end] += 1
        self._segment(at_ns + 200_000, 1 - end, FIN | ACK)
        self.numbers[1 - end] += 1
        self._segment(at_ns + 250_000, end, ACK)

    def reset(self, at_ns: int, end: int) -> None:
        self._segment(at_ns, end, RST | ACK)

    def data(self, at_ns: int, end: int, payload: bytes) -> None:
        self._segment(at_ns, end, PUSH | ACK, payload)
        self.numbers[end] += len(payload)

    def again(self, at_ns: int, end: int, payload: bytes) -> None:
        """A retransmission of what was sent last."""
        self.numbers[end] -= len(payload)
        self.data(at_ns, end, payload)

    def lost(self, end: int, payload: bytes) -> None:
        """Send what is lost before the tap."""
        self.numbers[end] += len(payload)

    def acknowledge(self, at_ns: int, end: int) -> None:
        if self.acknowledged[end] != self.numbers[1 - end]:
            self._segment(at_ns, end, ACK)

    def next_id(self) -> int:
        self.ids = self.ids + 1 & 0xFFFF
        return self.ids

    def _segment(self, at_ns: int, end: int, flags: int, payload: bytes = b"") -> None:
        self.acknowledged[end] = self.numbers[1 - end] if flags & ACK else 0
        head = struct.pack(
            ">HHIIBBHHH",
            self.ports[end],
            self.ports[1 - end],
            self.numbers[end] & 0xFFFFFFFF,
            self.acknowledged[end] & 0xFFFFFFFF,
            5 << 4,
            flags,
            8192,
            0,
            0,
        )
        self.network.send(at_ns, self.hosts[end], self.hosts[1 - end], head + payload)


@dataclass(slots=True)
class Poll:
    """One request of a master: unit, address, quantity, and the usual latency of its answers."""

    unit: int
    address: int
    quantity: int
    latency_ms: float

    def request(self, number: int) -> bytes:
        pdu = struct.pack(">BHH", 3, self.address, self.quantity)
        return struct.pack(">HHHB", number, 0, len(pdu) + 1, self.unit) + pdu

    def response(self, number: int, random: Random) -> bytes:
        pdu = bytes([3, 2 * self.quantity])
        pdu += b"".join(random.choice((b"\0\x17", b"\x12\x34")) for _ in range(self.quantity))
        if self.address == REFUSED:
            pdu = bytes([0x83, 2])
        return struct.pack(">HHHB", number, 0, len(pdu) + 1, self.unit) + pdu

    def failure(self, number: int) -> bytes:
        return struct.pack(">HHHBBB", number, 0, 3, self.unit, 0x83, 0x0B)


class Site:
    """A master with its slaves, or a gateway with units behind it, before it becomes sick."""

    def __init__(self, seed: int, beside: str) -> None:
        self.random = random = Random(seed)
        self.network = Network(random)
        self.master, self.slave = Host(1), Host(9)
        self.beside = beside
        self.period_ms = random.choice((500, 1000))
        self.timeout_ms = random.choice((1000, 1500))
        self.units = random.sample(range(1, 60), 3)
        self.polls = [
            Poll(
                unit, random.choice((0, 100, 400)), random.randint(2, 30), random.choice((3, 8, 20))
            )
            for unit in self.units
        ]
        if beside == DEAD:
            self.polls.append(Poll(DEAD_UNIT, 0, 4, 0))
        if beside == REFUSING:
            self.polls.append(Poll(self.units[0], REFUSED, 4, 5))
        if beside == SLOW:
            self.polls.append(Poll(SLOW_UNIT, 0, 4, 260))
        self.sick = {DEAD_UNIT, SLOW_UNIT}
        self.tcp = Tcp(self.network, (self.master, self.slave))
        self.tcp.open(0)

    def ask(self, tcp: Tcp, at_ns: int, poll: Poll, latency_ms: float | None = None) -> int:
        """Send a request and its response; return when the master goes on."""
        number = tcp.next_id()
        tcp.data(at_ns, 0, poll.request(number))
        if poll.unit == DEAD_UNIT:
            tcp.acknowledge(at_ns + ACK_NS, 1)
            return at_ns + round(self.timeout_ms * MS)
        usual = poll.latency_ms * self.random.uniform(0.8, 1.3)
        come_ns = at_ns + round((usual if latency_ms is None else latency_ms) * MS)
        if come_ns - at_ns > ACK_NS:
            tcp.acknowledge(at_ns + ACK_NS, 1)
        tcp.data(come_ns, 1, poll.response(number, self.random))
        return come_ns + 2 * MS

    def cycles(
        self, seconds: float = SECONDS, begin_ms: float = 300, period_ms: float | None = None
    ) -> Iterator[int]:
        """Yield when each cycle should begin; a cycle that takes long delays those behind it."""
        period_ns = round((period_ms or self.period_ms) * MS)
        at_ns = round(begin_ms * MS)
        while at_ns < seconds * SECOND:
            yield at_ns
            at_ns += period_ns

    def poll_all(self, seconds: float = SECONDS, begin_ms: float = 300) -> None:
        """Poll as a healthy site."""
        free_ns = 0
        for cycle_ns in self.cycles(seconds, begin_ms):
            now_ns = max(cycle_ns, free_ns)
            for poll in self.polls:
                now_ns = self.ask(self.tcp, now_ns, poll)
            self.tcp.acknowledge(now_ns + ACK_NS, 0)
            free_ns = now_ns + ACK_NS


def late(site: Site, severity: str) -> None:
    """One unit sometimes answers when the master has given up and asks the next unit."""
    share = 1.0 if severity == SEVERE else SHARE[severity]
    sick = site.polls[1]
    site.sick.add(sick.unit)
    free_ns = 0
    for cycle_ns in site.cycles():
        now_ns = max(cycle_ns, free_ns)
        due: tuple[int, bytes] | None = None
        for poll in site.polls:
            if poll is sick and site.random.random() < share:
                number = site.tcp.next_id()
                site.tcp.data(now_ns, 0, poll.request(number))
                site.tcp.acknowledge(now_ns + ACK_NS, 1)
                late_ns = round(site.timeout_ms * site.random.uniform(1.05, 1.12) * MS)
                due = now_ns + late_ns, poll.response(number, site.random)
                now_ns += round(site.timeout_ms * MS)
                continue
            if due is not None:
                # The next request is on its way; the late response comes before its own.
                number = site.tcp.next_id()
                site.tcp.data(now_ns, 0, poll.request(number))
                due_ns = max(due[0], now_ns + MS)
                site.tcp.data(due_ns, 1, due[1])
                due = None
                if poll.unit == DEAD_UNIT:
                    now_ns += round(site.timeout_ms * MS)
                    continue
                come_ns = due_ns + round(poll.latency_ms * MS)
                site.tcp.data(come_ns, 1, poll.response(number, site.random))
                now_ns = come_ns + 2 * MS
                continue
            now_ns = site.ask(site.tcp, now_ns, poll)
        site.tcp.acknowledge(now_ns + ACK_NS, 0)
        free_ns = now_ns + ACK_NS


def blocked(site: Site, severity: str) -> None:
    """A unit behind the gateway is silent: the gateway waits for it, and all others with it.

    Two masters ask the units of the gateway, each over its own connection.
    """
    wait_ms = {MILD: 350, MEDIUM: 800, SEVERE: 1200}[severity]
    silent = Poll(66, 0, 4, 0)
    site.sick.add(66)
    site.timeout_ms = 3000
    _behind_gateway(site, [silent, *site.polls[:1]], site.polls, wait_ms)


def two_at_gateway(site: Site, severity: str) -> None:
    """Two masters share the line of a gateway: it is busy, so that each waits for the other."""
    busy = {MILD: 90, MEDIUM: 120, SEVERE: 200}[severity]
    for poll in site.polls:
        if poll.unit not in (DEAD_UNIT, SLOW_UNIT):
            poll.latency_ms = busy * site.random.uniform(0.7, 1.2)
    others = [Poll(unit, 2000, 10, busy) for unit in site.units]
    _behind_gateway(site, others, site.polls, 300)


def _behind_gateway(site: Site, others: list[Poll], mine: list[Poll], wait_ms: float) -> None:
    """Two masters ask over one gateway, which asks one unit at a time, in order."""
    second = Tcp(site.network, (Host(2), site.slave))
    second.open(50 * MS)
    lanes = [(site.tcp, mine, 0), (second, others, 0)]
    next_ns = [300 * MS, 317 * MS]
    places, began = [0, 0], [300 * MS, 317 * MS]
    free_ns = 0
    while min(next_ns) < SECONDS * SECOND:
        lane = next_ns.index(min(next_ns))
        tcp, polls, _ = lanes[lane]
        at_ns, poll = next_ns[lane], polls[places[lane]]
        number = tcp.next_id()
        tcp.data(at_ns, 0, poll.request(number))
        begin_ns = max(at_ns, free_ns)
        if poll.unit in (66, DEAD_UNIT):
            come_ns, answer = begin_ns + round(wait_ms * MS), poll.failure(number)
        else:
            taken = round(poll.latency_ms * site.random.uniform(0.9, 1.1) * MS)
            come_ns, answer = begin_ns + taken, poll.response(number, site.random)
        free_ns = come_ns + 3 * MS
        tcp.data(come_ns, 1, answer)
        places[lane] = (places[lane] + 1) % len(polls)
        next_ns[lane] = come_ns + 3 * MS
        if places[lane] == 0:
            began[lane] += round(site.period_ms * MS)
            next_ns[lane] = began[lane] = max(began[lane], next_ns[lane])


def lost(site: Site, severity: str) -> None:
    """The slave resets the connection now and then; the master is back some seconds later."""
    every_s = {MILD: 45.0, MEDIUM: 20.0, SEVERE: 8.0}[severity]
    pause_s = {MILD: 5.0, MEDIUM: 8.0, SEVERE: 4.0}[severity]
    reset_ns, free_ns = round(every_s * SECOND), 0
    for cycle_ns in site.cycles():
        if cycle_ns < free_ns:
            continue
        now_ns = cycle_ns
        for poll in site.polls:
            if now_ns >= reset_ns and poll.unit != DEAD_UNIT:
                site.tcp.data(now_ns, 0, poll.request(site.tcp.next_id()))
                site.tcp.reset(now_ns + 3 * MS, 1)
                now_ns += round(pause_s * SECOND)
                site.tcp = Tcp(site.network, (site.master, site.slave))
                site.tcp.open(now_ns)
                reset_ns = now_ns + round(every_s * site.random.uniform(0.7, 1.3) * SECOND)
                now_ns += MS
                break
            now_ns = site.ask(site.tcp, now_ns, poll)
        site.tcp.acknowledge(now_ns + ACK_NS, 0)
        free_ns = now_ns + ACK_NS


def lossy_path(site: Site, severity: str) -> None:
    """Packets get lost on the way, before the tap or behind it, and are sent again."""
    share = {MILD: 0.02, MEDIUM: 0.06, SEVERE: 0.2}[severity]
    random, free_ns = site.random, 0
    for cycle_ns in site.cycles():
        now_ns = max(cycle_ns, free_ns)
        for poll in site.polls:
            if poll.unit in (DEAD_UNIT, SLOW_UNIT) or random.random() >= share:
                now_ns = site.ask(site.tcp, now_ns, poll)
                continue
            number = site.tcp.next_id()
            request, answer = poll.request(number), poll.response(number, random)
            wait_ns = random.choice((210, 220, 250, 640)) * MS
            if random.random() < 0.5:  # The request is lost behind the tap.
                site.tcp.data(now_ns, 0, request)
                now_ns += wait_ns
                site.tcp.again(now_ns, 0, request)
                now_ns += round(poll.latency_ms * MS)
                site.tcp.data(now_ns, 1, answer)
            else:  # The response is lost behind the tap.
                site.tcp.data(now_ns, 0, request)
                now_ns += round(poll.latency_ms * MS)
                site.tcp.data(now_ns, 1, answer)
                now_ns += wait_ns
                site.tcp.again(now_ns, 1, answer)
            now_ns += 2 * MS
        site.tcp.acknowledge(now_ns + ACK_NS, 0)
        free_ns = now_ns + ACK_NS


def delayed_ack(site: Site, severity: str) -> None:
    """A message comes in two segments, and the second waits for the acknowledgement of the first:
    some responses; in the severe case, the requests of a master.
    """
    delay_ns = {MILD: 40, MEDIUM: 200, SEVERE: 200}[severity] * MS
    free_ns = 0
    for cycle_ns in site.cycles():
        now_ns = max(cycle_ns, free_ns)
        for poll in site.polls:
            if poll is not site.polls[1]:
                now_ns = site.ask(site.tcp, now_ns, poll)
                continue
            number = site.tcp.next_id()
            request, answer = poll.request(number), poll.response(number, site.random)
            end, message = (0, request) if severity == SEVERE else (1, answer)
            if severity != SEVERE:
                site.tcp.data(now_ns, 0, request)
                now_ns += round(poll.latency_ms * MS)
            site.tcp.data(now_ns, end, message[:6])
            now_ns += delay_ns - round(site.random.uniform(0, 3) * MS)
            site.tcp.acknowledge(now_ns, 1 - end)
            now_ns += 100_000
            site.tcp.data(now_ns, end, message[6:])
            if severity == SEVERE:
                now_ns += round(poll.latency_ms * MS)
                site.tcp.data(now_ns, 1, answer)
            now_ns += 2 * MS
        site.tcp.acknowledge(now_ns + ACK_NS, 0)
        free_ns = now_ns + ACK_NS


def two_macs(site: Site, severity: str) -> None:
    """Somebody answers ARP for the slave, and passes packets on: each is seen with two MACs."""
    site.poll_all()
    begin, end = {MILD: (0.45, 0.55), MEDIUM: (0.3, 0.8), SEVERE: (0.0, 1.0)}[severity]
    attacker = Host(66).mac
    packets = []
    for one in site.network.packets:
        if begin <= one.at_ns / (SECONDS * SECOND) < end:
            packets.append(Packet(one.at_ns, attacker + one.data[6:], one.source))
            passed = one.data[:6] + attacker + one.data[12:]
            packets.append(Packet(one.at_ns + 300_000, passed, one.source))
        else:
            packets.append(one)
    site.network.packets = packets


def one_side(site: Site, severity: str) -> None:
    """The switch mirrors one direction only."""
    site.poll_all()
    heard = site.slave.number if severity == MEDIUM else site.master.number
    site.network.packets = [one for one in site.network.packets if one.source == heard]


def turned(site: Site, severity: str) -> None:
    """A host that has answered as a slave begins to ask another slave: it has been taken over."""
    begin_s = {MILD: 150, MEDIUM: 100, SEVERE: 60}[severity]
    victim = Host(20)
    known = Tcp(site.network, (site.master, victim))
    known.open(100 * MS)
    site.poll_all()
    for cycle_ns in site.cycles(begin_ms=600):
        site.ask(known, cycle_ns, Poll(1, 50, 4, 5))
    mine = Tcp(site.network, (site.slave, victim))
    mine.open(begin_s * SECOND)
    at_ns = begin_s * SECOND + MS
    while at_ns < SECONDS * SECOND:
        site.ask(mine, at_ns, Poll(1, site.random.randrange(50), 8, 5))
        at_ns += round({MILD: 2.0, MEDIUM: 1.0, SEVERE: 0.3}[severity] * SECOND)


ILLNESSES: tuple[tuple[str, Callable[[Site, str], None]], ...] = (
    ("NET-LATE", late),
    ("NET-BLOCKED", blocked),
    ("NET-SHARED", two_at_gateway),
    ("NET-LOST", lost),
    ("NET-LOSSY", lossy_path),
    ("NET-DELAYED-ACK", delayed_ack),
    ("NET-TWO-MACS", two_macs),
    ("NET-ONE-SIDE", one_side),
    ("NET-ROLE", turned),
)


def healthy(site: Site, _kind: str) -> None:
    site.poll_all()


def two_well(site: Site, _kind: str) -> None:
    """Two masters ask one server, which answers both at once."""
    second = Tcp(site.network, (Host(2), site.slave))
    second.open(50 * MS)
    site.poll_all()
    for cycle_ns in site.cycles(begin_ms=520):
        site.ask(second, cycle_ns, Poll(site.units[0], 50, 4, 5))


def pipelined(site: Site, _kind: str) -> None:
    """A master sends all its requests at once, and the slave answers them in order."""
    for cycle_ns in site.cycles():
        numbers = [site.tcp.next_id() for _ in site.polls]
        for place, (poll, number) in enumerate(zip(site.polls, numbers, strict=True)):
            site.tcp.data(cycle_ns + place * 50_000, 0, poll.request(number))
        at_ns = cycle_ns
        for poll, number in zip(site.polls, numbers, strict=True):
            at_ns += round(poll.latency_ms * MS)
            site.tcp.data(at_ns, 1, poll.response(number, site.random))
        site.tcp.acknowledge(at_ns + ACK_NS, 0)


def restarted(site: Site, _kind: str) -> None:
    """The master closes its connection after a minute, as for a restart, and opens another."""
    site.poll_all(seconds=SECONDS / 3)
    site.tcp.close(round(SECONDS / 3 * SECOND) + 500 * MS)
    site.tcp = Tcp(site.network, (site.master, site.slave))
    begin_ms = SECONDS / 3 * 1000 + 1500
    site.tcp.open(round(begin_ms * MS) - 2 * MS)
    site.poll_all(begin_ms=begin_ms)


HEALTHY = (healthy, two_well, pipelined, restarted)


def cases(first_seed: int) -> Iterator[Case]:
    seed = first_seed
    for code, make in ILLNESSES:
        for severity in SEVERITIES:
            for beside in BESIDES:
                if code == "NET-ONE-SIDE" and beside != ALONE:
                    continue
                for timing in (EXACT, POLLED):
                    seed += 1
                    yield Case(
                        illness=code,
                        severity=severity,
                        beside=beside,
                        timing=timing,
                        write=partial(_write, seed, make, severity, beside, timing),
                    )
    for make in HEALTHY:
        seed += 1
        yield Case(
            illness="",
            severity=make.__name__,
            beside=ALONE,
            timing=EXACT,
            write=partial(_write, seed, make, "", ALONE, EXACT),
        )


def _also(make: Callable[[Site, str], None], beside: str) -> frozenset[str]:
    """What is true beside the illness: a dead or slow unit behind a gateway also holds up its line,
    and the gateway refuses requests to the dead one.
    """
    if make in (blocked, two_at_gateway) and beside in (DEAD, SLOW):
        return frozenset((WITH[beside], "NET-BLOCKED", "UNIT-REFUSES"))
    return frozenset([WITH[beside]]) if WITH[beside] else frozenset()


def _write(
    seed: int,
    make: Callable[[Site, str], None],
    severity: str,
    beside: str,
    timing: str,
    path: Path,
) -> Recording:
    site = Site(seed, beside)
    make(site, severity)
    packets = sorted(
        (
            (one.at_ns if timing == EXACT else one.at_ns // MS * MS, one.data)
            for one in sorted(site.network.packets, key=lambda one: one.at_ns)
        ),
        key=lambda one: one[0],
    )
    path = path.with_suffix(".pcap")
    write_pcap(path, packets)
    return Recording(
        arguments=[str(path)],
        innocent=frozenset({poll.unit for poll in site.polls} - site.sick),
        also=_also(make, beside),
    )
