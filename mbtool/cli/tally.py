"""Counts printed records, for the sentence at the end of a command."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import counted
from mbtool.modbus import Outcome, Verdict

if TYPE_CHECKING:
    from mbtool.columns.table_counts import TransactionCounts
    from mbtool.decode.decoder import Record

CONNECTION_EVENTS = frozenset((EventKind.OPENED, EventKind.CLOSED))
"""Events that are no failure: a connection was opened or closed."""

_WORDS = {
    Outcome.OK: "ok",
    Outcome.EXCEPTION: "exception",
    Outcome.LATE: "late",
    Outcome.NO_ANSWER: "without answer",
    Outcome.NOT_CAPTURED: "not captured",
    Outcome.UNSOLICITED: "unsolicited",
    Outcome.BROADCAST: "broadcast",
    Outcome.MALFORMED: "malformed",
}


@dataclass(slots=True)
class Tally:
    """Counts transactions by outcome, and events by kind."""

    outcomes: Counter[Outcome] = field(default_factory=Counter)
    events: Counter[EventKind] = field(default_factory=Counter)
    ambiguous: int = 0

    def add(self, record: Record) -> None:
        if isinstance(record, WireEvent):
            self.events[record.kind] += 1
        else:
            self.outcomes[record.outcome] += 1
            self.ambiguous += Verdict.AMBIGUOUS in record.verdicts

    def add_counts(self, counts: TransactionCounts) -> None:
        self.outcomes += counts.outcomes
        self.ambiguous += counts.ambiguous

    @property
    def transactions(self) -> int:
        return self.outcomes.total()

    def sentence(self) -> str:
        """Sum up: `12 transactions: 10 ok, 2 exception; 3 events: 3 skipped`."""
        text = counted(self.transactions, "transaction")
        parts = [
            f"{self.outcomes[key]:,} {word}" for key, word in _WORDS.items() if self.outcomes[key]
        ]
        if parts:
            text += ": " + ", ".join(parts)
        if self.ambiguous:
            text += f" ({self.ambiguous:,} ambiguous)"
        troubles = {
            kind: count for kind, count in self.events.items() if kind not in CONNECTION_EVENTS
        }
        if troubles:
            total = sum(troubles.values())
            text += f"; {counted(total, 'event')}: "
            text += ", ".join(f"{count:,} {kind.value}" for kind, count in sorted(troubles.items()))
        return text
