"""Holds what is decoded against all rules: records in, findings out."""

# Each rule looks at the records of its own kind, in the order in which they are decoded, which is
# that of their ends. No rule asks the clock, and all that they hold is bounded, as their modules
# say. What many transactions come to is told at the end, when all of them are known.
#
# A frame that may be another (Verdict.AMBIGUOUS) breaks no rule of content, since its bytes may say
# something else (naming.py gives it no codes); how many there are is a remark.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.connections import ConnectionRules, is_foreign_message
from mbtool.devices.checking.fa3 import Fa3Rules, is_fa3
from mbtool.devices.checking.line import LineRules
from mbtool.devices.checking.polls import PollRules
from mbtool.devices.checking.responses import AnswerRules
from mbtool.devices.checking.transactions import TransactionRules
from mbtool.devices.checking.wago import WagoRules, is_wago
from mbtool.modbus.adu import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.named_transaction import NamedTransaction


class Checker:
    """All rules, for one capture."""

    def __init__(self, surroundings: CaptureContext | None = None) -> None:
        self._around = surroundings or CaptureContext()
        self._each = TransactionRules()
        self._answers = AnswerRules()
        self._polls = PollRules()
        self._lines = LineRules()
        self._connections = ConnectionRules(self._around.ports)
        self._fa3 = Fa3Rules()
        self._wago = WagoRules()
        self._ambiguous = 0
        self.remarks: list[str] = []
        """What is no finding and yet worth a line, once the capture has ended."""

    def feed(self, record: NamedTransaction | WireEvent) -> Iterator[Finding]:
        """Take the next record, a transaction as it was named with today's rules."""
        if isinstance(record, WireEvent):
            yield from self._event(record)
        else:
            yield from self._transaction(record)

    def close(self) -> Iterator[Finding]:
        """The capture ends."""
        yield from self._answers.close()
        yield from self._connections.close()
        yield from self._lines.close()
        yield from self._polls.close()
        if self._ambiguous:
            many = self._ambiguous > 1
            self.remarks.append(
                f"{self._ambiguous} transactions are ambiguous; what they say was held against no "
                "rule"
                if many
                else "1 transaction is ambiguous; what it says was held against no rule"
            )
        self.remarks += self._lines.remarks

    def _transaction(self, one: NamedTransaction) -> Iterator[Finding]:
        profile = self._around.assignments.profile_for(one)
        is_doubtful = Verdict.AMBIGUOUS in one.verdicts
        self._ambiguous += is_doubtful
        yield from self._each.check(one, profile)
        is_serial = one.transport.is_serial
        format_ = self._around.line_of(one.link) if is_serial else None
        # What answers a broadcast is told as that, and not once more as what nobody asked for.
        if not self._lines.is_answer_to_broadcast(one):
            yield from self._answers.transaction(one, profile)
        if is_serial:
            yield from self._lines.transaction(one, profile, format_)
        else:
            yield from self._connections.transaction(one)
        if format_ is not None or not is_serial:
            self._polls.transaction(one)
        if profile is not None and not is_doubtful:
            if is_fa3(profile):
                yield from self._fa3.transaction(one, profile)
            if is_wago(profile):
                yield from self._wago.transaction(one)

    def _event(self, event: WireEvent) -> Iterator[Finding]:
        yield from self._answers.event(event)
        if not event.source and not event.destination:
            yield from self._lines.event(event)
            return
        of_fa3 = any(map(is_fa3, self._around.assignments.profiles_at(event.destination)))
        if of_fa3:
            yield from self._fa3.event(event)
        if not (of_fa3 and is_foreign_message(event.raw)):
            yield from self._connections.event(event)
