"""All rules about attacks and scans, SEC-101 to SEC-205."""

# At the end of the capture, each rule gives one finding for each source, with the number of cases.
# A source is a host; on a serial line, where masters have no addresses, it is the line. The rules
# that distinguish hosts (SEC-101, SEC-201, SEC-205) apply to networks only.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import CONNECTION_JOINED, EventKind, WireEvent
from mbtool.devices.checking.commands import CommandRules
from mbtool.devices.checking.masters import MasterRules
from mbtool.devices.checking.scans import ScanRules
from mbtool.devices.checking.security_cases import SecurityCases, host_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.checking.security_limits import SecurityLimits
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
        self._masters.run(run)
        self._commands.run(run)
        self._scans.run(run)

    def event(self, event: WireEvent) -> None:
        """Note the opening of a TCP connection. Other events do not matter to these rules."""
        if event.kind is EventKind.OPENED:
            host = host_of(event.source)
            if event.message.startswith(CONNECTION_JOINED):
                self._masters.joined(host, event.destination, event.ts_ns)
            else:
                self._masters.heard(host, event.ts_ns)
            self._scans.opened(event)

    def close(self) -> Iterator[Finding]:
        """Give the findings, at the end of the capture."""
        self._scans.close()
        yield from self._cases.close()
