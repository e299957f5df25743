"""Counts the transactions of a pyarrow table by their outcomes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.modbus import Outcome, Verdict

if TYPE_CHECKING:
    from mbtool.columns.schema import Table


@dataclass(slots=True)
class TransactionCounts:
    """The number of transactions by outcome, and the number of ambiguous ones (confidence below
    0.8).
    """

    outcomes: Counter[Outcome] = field(default_factory=Counter)
    ambiguous: int = 0

    def add(self, other: TransactionCounts) -> None:
        self.outcomes += other.outcomes
        self.ambiguous += other.ambiguous


def table_counts(table: Table) -> TransactionCounts:
    """Count the transactions of a table that has the columns of schema.py."""
    outcomes: Counter[Outcome] = Counter()
    for one in table["outcome"].value_counts().to_pylist():
        outcomes[Outcome(one["values"])] += one["counts"]
    verdicts = table["verdicts"].combine_chunks().flatten().to_pylist()
    return TransactionCounts(outcomes, verdicts.count(Verdict.AMBIGUOUS))
