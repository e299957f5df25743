"""Checks the transactions and events of a capture against all rules of `mbtool check`."""

# Each rule gets the records (transactions and events) that concern it in the order in which they
# are decoded. A record is decoded when it ends: a transaction with its response or its timeout.
# Rules do not read the clock. Their memory is bounded; each module states its bounds. Findings that
# summarise many transactions come at the end of the capture.
#
# Rules about content do not apply to an ambiguous frame (Verdict.AMBIGUOUS), because it may have
# been misread (naming.py gives it no finding codes). A remark says how many transactions are
# ambiguous.

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeVar

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.connections import ConnectionRules, is_foreign_message
from mbtool.devices.checking.fa3 import Fa3Rules, is_fa3
from mbtool.devices.checking.line import LineRules
from mbtool.devices.checking.polls import PollRules
from mbtool.devices.checking.quiet_run import QuietRows, QuietRun
from mbtool.devices.checking.responses import DamagedFrames, ResponseRules, WagoRules, is_wago
from mbtool.devices.checking.security import SecurityRules
from mbtool.devices.checking.transactions import TransactionRules
from mbtool.modbus.adu import Verdict

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.named_transaction import NamedTransaction

Q = TypeVar("Q", bound=QuietRows)

_ONE_BY_ONE = 64
"""If a rule cannot check many rows (answered reads) together, this many rows are checked one by
one. Then the rules are asked again about the remaining rows; after each further refusal, twice as
many rows as before are checked one by one."""


class Checker:
    """Checks the transactions and events of one capture against all rules."""

    def __init__(self, context: CaptureContext | None = None) -> None:
        self._context = context or CaptureContext()
        self._transactions = TransactionRules()
        self._polls = PollRules()
        self._responses = ResponseRules(self._polls.usual_ns)
        self._lines = LineRules(self._context.has_exact_times)
        self._damaged = DamagedFrames()
        self._connections = ConnectionRules(self._context.ports)
        self._fa3 = Fa3Rules()
        self._wago = WagoRules()
        self._security = SecurityRules(self._context.limits)
        self._ambiguous = 0
        self.remarks: list[str] = []
        """Sentences for the user that are no findings, such as the number of ambiguous
        transactions. The list is complete after `close`."""

    def feed(self, record: NamedTransaction | WireEvent) -> Iterator[Finding]:
        """Check the next transaction or event. Yields each finding as soon as it is certain.

        The finding codes in a transaction are used as they are, so `Namer.name` of this version of
        mbtool must have set them.
        """
        if isinstance(record, WireEvent):
            yield from self._event(record)
        else:
            yield from self._transaction(record)

    def feed_rows(
        self, rows: Q
    ) -> Iterator[tuple[NamedTransaction | WireEvent | Q, Iterator[Finding]]]:
        """Check many answered reads of slaves without profiles, with the same findings as `feed`
        for each.

        The first reads are checked one by one, until every rule can check the remaining ones
        together. That is much faster. Yields each of the first reads with its findings, then the
        remaining ones as one object with theirs. The rules check a read while its findings are
        taken: take them all before the next step.
        """
        count = _ONE_BY_ONE
        while len(rows):
            run = rows.run
            if self._takes(run):
                yield rows, self._run(run)
                return
            for one in rows.records(count):
                yield one, self.feed(one)
            rows, count = rows.behind(count), 2 * count

    def _run(self, run: QuietRun) -> Iterator[Finding]:
        yield from self._responses.run(run)
        yield from self._connections.run(run)
        self._polls.run(run)
        self._security.run(run)

    def _takes(self, run: QuietRun) -> bool:
        if self._responses.has_pending and self._connections.has_pending:
            return False  # Together, their findings would come in another order than from `feed`.
        rules = (self._connections, self._security, self._responses)
        return all(one.takes(run) for one in rules)

    def close(self) -> Iterator[Finding]:
        """Give the findings that are only known at the end of the capture."""
        yield from self._responses.close()
        yield from self._connections.close()
        yield from self._damaged.close()
        yield from self._lines.close()
        yield from self._polls.close()
        yield from self._fa3.close()
        yield from self._security.close()
        if self._ambiguous:
            self.remarks.append(
                f"{self._ambiguous} transactions are ambiguous; their contents were not checked"
                if self._ambiguous > 1
                else "1 transaction is ambiguous; its contents were not checked"
            )
        self.remarks += self._lines.remarks

    def _transaction(self, one: NamedTransaction) -> Iterator[Finding]:
        profile = self._context.assignments.profile_for(one)
        is_ambiguous = Verdict.AMBIGUOUS in one.verdicts
        self._ambiguous += is_ambiguous
        yield from self._damaged.transaction(one)
        yield from self._transactions.check(one, profile)
        is_serial = one.transport.is_serial
        format_ = self._context.line_of(one.link) if is_serial else None
        # A response to a broadcast is reported as MB-301. The rule MB-403 (a response without a
        # request) must not report it a second time.
        if not self._lines.is_response_to_broadcast(one):
            yield from self._responses.transaction(one, profile)
        if is_serial:
            yield from self._lines.transaction(one, profile, format_)
        else:
            yield from self._connections.transaction(one)
        if format_ is not None or not is_serial:
            self._polls.transaction(one)
        if not is_ambiguous:
            self._security.transaction(one, profile)
        if profile is not None and not is_ambiguous:
            if is_fa3(profile):
                yield from self._fa3.transaction(one, profile)
            if is_wago(profile):
                yield from self._wago.transaction(one)

    def _event(self, event: WireEvent) -> Iterator[Finding]:
        if event.kind is EventKind.BAD_CHECK:
            yield from self._damaged.event(event)
        yield from self._responses.event(event)
        if not event.source and not event.destination:
            yield from self._lines.event(event)
            return
        self._security.event(event)
        profiles = self._context.assignments.profiles_at(event.destination)
        fa3 = next(filter(is_fa3, profiles), None)
        at_fa3 = fa3 is not None
        if fa3 is not None:
            yield from self._fa3.event(event, fa3)
        if not (at_fa3 and is_foreign_message(event.raw)):
            yield from self._connections.event(event)
