"""All rules about attacks and scans, SEC-101 to SEC-205."""

# At the end of the capture, each rule gives one finding for each source, with the number of cases.
# A source is a host; on a serial line, where masters have no addresses, it is the line. The rules
# that distinguish hosts (SEC-101, SEC-201, SEC-205) apply to networks only.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from mbtool.core import CONNECTION_JOINED, EventKind, WireEvent
from mbtool.devices.checking.finding import Finding, packets_of, transaction_finding
from mbtool.devices.checking.masters import MasterRules, Write
from mbtool.devices.checking.scans import ScanRules
from mbtool.devices.checking.security_cases import SecurityCases, host_of, master_text, place_text
from mbtool.devices.checking.sliding_window import LruDict, SlidingWindow
from mbtool.devices.checking.transactions import request_text
from mbtool.modbus.functions import DIAGNOSTICS, FUNCTIONS
from mbtool.modbus.pdu import whole_pdu

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.checking.security_limits import SecurityLimit, SecurityLimits
    from mbtool.devices.model import Profile
    from mbtool.devices.named_transaction import NamedTransaction


class SecurityRules:
    """Finds attacks and scans (SEC-101 to SEC-205).

    The caller must leave out ambiguous transactions, which may have been misread.
    """

    def __init__(self, limits: SecurityLimits) -> None:
        self._cases = SecurityCases()
        self._masters = MasterRules(limits, self._cases)
        self._commands = CommandRules(limits, self._cases)
        self._scans = ScanRules(limits, self._cases)

    def transaction(self, transaction: NamedTransaction, profile: Profile | None) -> None:
        """Count the next transaction for all rules about attacks and scans.

        `profile` is the slave's; None if it has none.
        """
        if transaction.request_raw is None:
            return
        slave = transaction.destination
        if transaction.source is None or slave is None:
            source = slave = transaction.link
        else:
            source = host_of(transaction.source)
            self._masters.transaction(transaction, source, slave)
        self._commands.transaction(transaction, source, slave)
        self._scans.transaction(transaction, source, slave, profile)

    def takes(self, run: QuietRun) -> bool:
        """True if the method `run` may count these transactions together, not one by one.

        That is so if the rules about masters and those about scans both allow it.
        """
        return self._masters.takes(run) and self._scans.takes(run)

    def run(self, run: QuietRun) -> None:
        """Count many transactions together, with the same result as `transaction` for each."""
        rows = run.rows
        writes = []
        for place in run.writes:
            write = Write(rows.request_ns[place], run.packets(place), partial(run.like, place))
            _, source, slave = run.ends(place)
            writes.append((host_of(source), slave, write))
        self._masters.run(run, writes)
        self._commands.run(writes)
        self._scans.run(run)

    def event(self, event: WireEvent) -> None:
        """Note the opening of a TCP connection. Other events do not matter to these rules."""
        if event.kind is EventKind.OPENED:
            host = host_of(event.source)
            if event.message.startswith(CONNECTION_JOINED):
                self._masters.joined(host, event.destination, event.ts_ns)
            else:
                self._masters.note_sender(host, event.ts_ns)
            self._scans.opened(event)

    def close(self) -> Iterator[Finding]:
        """Give the findings, at the end of the capture."""
        self._scans.close()
        yield from self._cases.close()


# The rules about too many writes, and about commands that stop a device (SEC-102, SEC-103).
#
# SEC-102  a master writes to one slave, or on one line, more often than a plant needs
# SEC-103  a command that stops or restarts a device: diagnostics (08) with sub-function 1 or 4, and
#          function 5AH, by which Schneider's programming software talks to controllers
#
# Function 5AH has no public specification. After the function code comes a session key and then a
# command. Published analyses (Kaspersky ICS CERT, "The secrets of Schneider Electric's UMAS
# protocol") give the numbers of commands that read, or that keep or end a session; plants use these
# in normal operation. Every other command counts as one that stops the device: start and stop, the
# load of a program, and unknown commands.
#
# Memory: the times of recent cases (sliding_window.py). For SEC-102, each pair of a master and a
# slave that it writes to has its own times; for SEC-103, each master that sends such commands. At
# most MAX_WRITERS pairs and MAX_WRITERS masters are kept, those used last.

MAX_WRITERS = 256

_STOPPING_DIAGNOSTICS = {  # Application Protocol V1.1b3, 6.8.1
    0x01: "restart communications",
    0x04: "force listen only mode",
}
_UMAS = 0x5A
_UMAS_COMMAND = 2
"""The offset of the command in the PDU, in bytes. Before it come the function code and the session
key, one byte each."""
_UMAS_HARMLESS = frozenset((
    0x01, 0x02, 0x03, 0x04, 0x06, 0x0A,  # opens a session, reads the identity, echoes
    0x10, 0x11, 0x12,  # takes, releases and keeps the right to change the device
    0x20, 0x22, 0x23, 0x24, 0x25, 0x26,  # reads memory; reads and writes variables; their names
    0x30, 0x31, 0x32, 0x39,  # reads the program, and data of the network
    0x50, 0x58, 0x70, 0x71, 0x73,  # monitors, checks; reads and writes inputs and outputs
))  # fmt: skip
_UMAS_NAMES = {
    0x33: "begin to load a program",
    0x34: "load a part of a program",
    0x35: "end loading a program",
    0x40: "start",
    0x41: "stop",
}


class CommandRules:
    """Finds masters that write too often (SEC-102), and commands that stop a device (SEC-103).

    Reports them at the end of the capture.
    """

    def __init__(self, limits: SecurityLimits, cases: SecurityCases) -> None:
        self._cases = cases
        self._on_network = _windows(limits.write_flood)
        self._on_line = _windows(limits.line_write_flood)
        self._commands = _windows(limits.stop_command)

    def transaction(self, transaction: NamedTransaction, source: str, slave: str) -> None:
        """Count the next transaction if it writes or stops a device. It must have a request.

        `source` is the IP address of the master and `slave` the slave's HOST:PORT. On a serial
        line, both are the name of the line.
        """
        known = FUNCTIONS.get(transaction.function)
        if known is not None and known.writes:
            windows = self._on_line if transaction.transport.is_serial else self._on_network
            self._note_write(
                windows,
                source,
                slave,
                Write(transaction.start_ns, packets_of(transaction), lambda: transaction),
            )
        command = stop_command(transaction)
        if command is not None:
            self._note_command(transaction, source, command)

    def run(self, writes: Sequence[tuple[str, str, Write]]) -> None:
        """Count many writes together, with the same result as `transaction` for each."""
        for source, slave, write in writes:
            self._note_write(self._on_network, source, slave, write)

    def _note_write(
        self,
        windows: LruDict[tuple[str, str], SlidingWindow],
        source: str,
        slave: str,
        write: Write,
    ) -> None:
        window = windows[source, slave]
        counted = window.add(write.start_ns, write.packets)
        if not counted:
            return

        def first_finding() -> Finding:
            transaction = write.transaction()
            text = (
                f"{master_text(transaction)} writes {{count}} times to {place_text(transaction)}, "
                f"for example {request_text(transaction)}"
            )
            finding = transaction_finding("SEC-102", transaction, text, ts_ns=window.first_ns)
            return replace(finding, function=None, reference=None)

        packets = window.last_packets(counted)
        self._cases.add(source, "SEC-102", first_finding, counted, packets=packets)

    def _note_command(self, transaction: NamedTransaction, source: str, command: str) -> None:
        window = self._commands[source, ""]
        counted = window.add(transaction.start_ns, packets_of(transaction))
        if counted:
            text = f"{master_text(transaction)} tells {{examples}}"
            finding = transaction_finding("SEC-103", transaction, text, ts_ns=window.first_ns)
            example = f"unit {transaction.unit} of {place_text(transaction)} to {command}"
            packets = window.last_packets(counted)
            self._cases.add(source, finding.code, lambda: finding, counted, [example], packets)


def stop_command(transaction: NamedTransaction) -> str | None:
    """Return a text for a message that names the command of a request that stops or restarts a
    device.

    Returns None for any other request.
    """
    if transaction.function == DIAGNOSTICS:
        name = _STOPPING_DIAGNOSTICS.get(transaction.sub_function or 0)
        return None if name is None else f"{name} (08/{transaction.sub_function:04X})"
    if transaction.function != _UMAS:
        return None
    pdu = whole_pdu(transaction.transport, transaction.request_raw)
    if pdu is None:
        return None  # The capture cut the request, so the command is unknown.
    if len(pdu) <= _UMAS_COMMAND:
        return "do what function 5AH says without a command"
    command = pdu[_UMAS_COMMAND]
    if command in _UMAS_HARMLESS:
        return None
    return f"{_UMAS_NAMES.get(command, 'carry out an unknown command')} (5AH/{command:02X})"


def _windows(limit: SecurityLimit) -> LruDict[tuple[str, str], SlidingWindow]:
    return LruDict(lambda: SlidingWindow(limit), MAX_WRITERS)
