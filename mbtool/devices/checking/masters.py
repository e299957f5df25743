"""The rules about hosts that are not the usual masters of a slave (SEC-101, SEC-205)."""

# SEC-101  a second master writes to a slave. Of two hosts that send requests to one slave, the
#          first master is the host that began earlier. The other host is the second master in two
#          cases: it began when the first had already sent requests for at least the time of the
#          rule's limit (security_limits.py); or both write, less than that time apart. If both
#          began at about the same time and only one writes, the capture does not show who is the
#          usual master, and there is no finding. There is none either if the capture begins within
#          the connection of the second host, because that host may have been there first.
# SEC-205  a host reads the identification of a slave (2B/0E, 11H, or 42H, the model code of the FA3
#          modules), and sent nothing in the first minutes of the capture: the time of the rule's
#          limit. The usual masters of a plant do send something then; one that restarts later is
#          still known.
#
# Hosts are identified by IP address, without port. So nothing is found on serial lines, or between
# masters that share an address.
#
# Memory: for each slave, the MAX_MASTERS hosts that sent last (sliding_window.py); MAX_HOSTS
# hosts of the first minutes (if the number is reached, there is no SEC-205), and as many later
# ones.

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from mbtool.devices.checking.finding import Finding, packets_of, transaction_finding
from mbtool.devices.checking.security_cases import Packets, host_of, is_identification
from mbtool.devices.checking.security_limits import SecurityLimit, SecurityLimits
from mbtool.devices.checking.sliding_window import LruDict, SlidingWindow
from mbtool.devices.checking.transactions import request_text
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.identification import ENCAPSULATED

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.checking.security_cases import SecurityCases
    from mbtool.devices.named_transaction import NamedTransaction

MAX_MASTERS = 16
MAX_HOSTS = 4096

_EVER_NS = 1 << 63


class Write(NamedTuple):
    """A request that writes."""

    start_ns: int
    packets: Packets
    transaction: Callable[[], NamedTransaction]
    """Makes its transaction."""


@dataclass(slots=True)
class _Master:
    """A host that sends requests to a slave."""

    host: str
    first_ns: int
    last_ns: int
    predecessor: str | None
    """IP address of a host that was already a master of the slave when this host began.

    That host had sent requests for at least the time of the limit of SEC-101, and had not stopped.
    None if there was no such host."""
    window: SlidingWindow
    """Counts this host's writes as the second master of the slave (SEC-101)."""
    uncounted: deque[tuple[int, Packets]]
    """The times (ns) and the packets of this host's last writes that were not added to `window`,
    because no other host was known to be the first master."""
    last_write: Write | None = None


class MasterRules:
    """Finds second masters that write (SEC-101), and new hosts that identify a slave (SEC-205).

    Reports them at the end of the capture.
    """

    def __init__(self, limits: SecurityLimits, cases: SecurityCases) -> None:
        self._cases = cases
        self._writes = limits.second_writer
        self._slaves: LruDict[str, dict[str, _Master]] = LruDict(dict)
        self._first_time_ns = limits.identification.window_ns
        self._began_ns: int | None = None
        self._known: set[str] = set()
        """IP addresses of the hosts that sent something in the first minutes of the capture: in
        the time window of rule SEC-205."""
        late = SecurityLimit(limits.identification.number, _EVER_NS)
        self._identifications = LruDict[str, SlidingWindow](lambda: SlidingWindow(late), MAX_HOSTS)
        """For each host (IP address) that is not in `_known`: counts its reads of an
        identification."""

    def note_sender(self, host: str, at_ns: int) -> None:
        """Note that a host (an IP address) sent something, or opened a connection, at the time
        `at_ns`.
        """
        if self._began_ns is None:
            self._began_ns = at_ns
        if at_ns - self._began_ns <= self._first_time_ns and len(self._known) < MAX_HOSTS:
            self._known.add(host)

    def transaction(self, transaction: NamedTransaction, host: str, slave: str) -> None:
        """Count the next request of `host` (an IP address) to `slave` (HOST:PORT)."""
        at_ns = transaction.start_ns
        self.note_sender(host, at_ns)
        masters = self._slaves[slave]
        master = masters.get(host)
        if master is None:
            master = self._new_master(masters, host, at_ns)
        elif at_ns > master.last_ns:
            master.last_ns = at_ns
        known = FUNCTIONS.get(transaction.function)
        if known is not None and known.writes:
            self._note_write(
                masters, master, Write(at_ns, packets_of(transaction), lambda: transaction)
            )
        elif is_identification(transaction):
            self._note_identification(transaction, host, slave)

    def takes(self, run: QuietRun) -> bool:
        """True if the method `run` may count these transactions together, not one by one.

        That is so if each host has already sent requests to each of its slaves.
        """
        if self._began_ns is None or len(self._known) + len(run.connections) > MAX_HOSTS:
            return False
        for one in run.connections:
            masters = self._slaves.get(one.destination)
            if masters is None or host_of(one.source) not in masters:
                return False
        return True

    def run(self, run: QuietRun, writes: Sequence[tuple[str, str, Write]]) -> None:
        """Count many reads and writes together, with the same result as `transaction` for each.

        `run` has their times, grouped by connection; `writes` has the writes in their order, each
        with its master's host and its slave.
        """
        for one in run.connections:
            host = host_of(one.source)
            self.note_sender(host, one.least_ns if one.opened_ns is None else one.opened_ns)
            if not one.units:
                continue
            master = self._slaves[one.destination][host]
            master.last_ns = max(master.last_ns, one.last_request_ns)
        for source, slave, write in writes:
            masters = self._slaves[slave]
            self._note_write(masters, masters[source], write)

    def joined(self, host: str, slave: str, at_ns: int) -> None:
        """Note that the capture begins within a connection of `host` to `slave` (HOST:PORT).

        So the host is one of the slave's masters since before the capture.
        """
        self.note_sender(host, at_ns)
        masters = self._slaves[slave]
        if host not in masters:
            self._new_master(masters, host, at_ns, was_there=True)

    def _new_master(
        self, masters: dict[str, _Master], host: str, at_ns: int, *, was_there: bool = False
    ) -> _Master:
        since_ns = at_ns - self._writes.window_ns
        hosts = (one.host for one in masters.values() if one.first_ns <= since_ns <= one.last_ns)
        predecessor = None if was_there else next(hosts, None)
        if len(masters) >= MAX_MASTERS:
            del masters[min(masters, key=lambda one: masters[one].last_ns)]
        masters[host] = _Master(
            host,
            at_ns,
            at_ns,
            predecessor,
            SlidingWindow(self._writes),
            deque(maxlen=self._writes.number),
        )
        return masters[host]

    def _note_write(self, masters: dict[str, _Master], master: _Master, write: Write) -> None:
        master.last_write = write
        master.uncounted.append((write.start_ns, write.packets))
        if master.predecessor is not None:
            self._count(master, master.predecessor)
        if len(masters) == 1:
            return
        for other in masters.values():
            if other is not master and self._is_near(other.last_write, write):
                first, second = sorted((master, other), key=lambda one: one.first_ns)
                self._count(second, first.host)

    def _is_near(self, write: Write | None, other: Write) -> bool:
        if write is None:
            return False
        return abs(write.start_ns - other.start_ns) <= self._writes.window_ns

    def _count(self, second: _Master, first: str) -> None:
        """Count the writes of the host `second` as those of a second master (SEC-101), except those
        that were counted earlier.

        `first` is the IP address of the first master, for the message.
        """
        counted = 0
        while second.uncounted:
            counted += second.window.add(*second.uncounted.popleft())
        last = second.last_write
        if counted and last is not None:

            def first_finding() -> Finding:
                write = last.transaction()
                text = (
                    f"{second.host} writes to {write.destination}, which {first} asked before: "
                    f"{request_text(write)}"
                )
                return transaction_finding("SEC-101", write, text, ts_ns=second.window.first_ns)

            packets = second.window.last_packets(counted)
            self._cases.add(second.host, "SEC-101", first_finding, counted, packets=packets)

    def _note_identification(self, transaction: NamedTransaction, host: str, slave: str) -> None:
        if host in self._known or len(self._known) >= MAX_HOSTS:
            return
        window = self._identifications[host]
        counted = window.add(transaction.start_ns, packets_of(transaction))
        if counted:
            text = (
                f"{host}, which was not heard in the first {self._first_time_ns / 1e9:g} s, reads "
                "{examples}"
            )
            finding = transaction_finding("SEC-205", transaction, text, ts_ns=window.first_ns)
            example = f"{_function(transaction)} of {slave}"
            finding, packets = replace(finding, reference=None), window.last_packets(counted)
            self._cases.add(host, finding.code, lambda: finding, counted, [example], packets)


def _function(transaction: NamedTransaction) -> str:
    """Return the function code as text, such as `11H`; for function 2B with the MEI type,
    `2B/0E`.
    """
    if transaction.function == ENCAPSULATED:
        return f"2B/{transaction.sub_function:02X}"
    return f"{transaction.function:02X}H"
