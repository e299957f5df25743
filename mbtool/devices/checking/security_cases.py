"""Collects the cases of each source and rule, so that they become one finding with their number."""

# Memory: for each combination of source and rule, the number of cases, MAX_EXAMPLES examples and
# one finding. There are at most MAX_SOURCES combinations; later ones get no finding.

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import Finding

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.devices.named_transaction import NamedTransaction

MAX_EXAMPLES = 3
MAX_SOURCES = 4096


@dataclass(slots=True)
class _SourceCases:
    finding: Finding
    """The finding about the first case; {count} and {examples} in the message are filled later."""
    count: int = 0
    examples: list[str] = field(default_factory=list)
    has_more_examples: bool = False

    def add(self, count: int, examples: Iterable[str]) -> None:
        self.count += count
        for example in examples:
            if example in self.examples:
                continue
            if len(self.examples) < MAX_EXAMPLES:
                self.examples.append(example)
            else:
                self.has_more_examples = True
                break

    def summary(self) -> Finding:
        """The finding about all cases."""
        examples = ", ".join(self.examples) + (", ..." if self.has_more_examples else "")
        message = self.finding.message.replace("{count}", str(self.count))
        message = message.replace("{examples}", examples)
        return replace(self.finding, message=message, count=self.count)


class SecurityCases:
    """The cases of all rules about attacks and scans."""

    def __init__(self) -> None:
        self._cases: dict[tuple[str, str], _SourceCases] = {}
        """The cases, by the code of the rule and the source."""

    def add(self, source: str, finding: Finding, count: int, examples: Iterable[str] = ()) -> None:
        """Add cases of one source. Only the finding of its first cases is kept."""
        key = (finding.code, source)
        cases = self._cases.get(key)
        if cases is None:
            if len(self._cases) >= MAX_SOURCES:
                return
            cases = self._cases[key] = _SourceCases(finding)
        cases.add(count, examples)

    def close(self) -> Iterator[Finding]:
        """Give a finding for each rule and source, by code and time."""
        found = (cases.summary() for cases in self._cases.values())
        yield from sorted(found, key=lambda one: (one.code, one.ts_ns))


def host_of(end: str) -> str:
    """The host of HOST:PORT."""
    return end.rpartition(":")[0] or end


def master_text(transaction: NamedTransaction) -> str:
    """The master, for a message: its host; the masters of a serial line have no addresses."""
    return "the master" if transaction.source is None else host_of(transaction.source)


def place_text(transaction: NamedTransaction) -> str:
    """The slave's address or line, for a message: `10.0.0.2:502`, `the line rs485`."""
    return transaction.destination or f"the line {transaction.link}"
