"""Collects the cases of one rule and one source, and makes one finding of them with their number.

A source is a host, or a serial line.
"""

# Memory: for each combination of source and rule, the number of cases, MAX_EXAMPLES examples, the
# packets of MAX_CASES cases, and one finding. There are at most MAX_SOURCES combinations; later
# ones get no finding.

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import Finding
from mbtool.modbus.identification import ENCAPSULATED, REPORT_SERVER_ID

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

MAX_EXAMPLES = 3
MAX_SOURCES = 4096
MAX_CASES = 20_000

_READ_DEVICE_IDENTIFICATION = 0x0E
_READ_MODEL_CODE = 0x42

Packets = tuple[int, ...]
"""The numbers of the packets of a request and its response."""


@dataclass(slots=True)
class _SourceCases:
    finding: Finding
    """The finding about the first case. `summary` fills in {count} and {examples} in its
    message."""
    count: int = 0
    examples: list[str] = field(default_factory=list)
    has_more_examples: bool = False
    packets: dict[Packets, None] = field(default_factory=dict)
    """The packets of the cases, in the order in which they were added."""

    def add(self, count: int, examples: Iterable[str], packets: Iterable[Packets]) -> None:
        self.count += count
        for one in packets:
            if one and len(self.packets) < MAX_CASES:
                self.packets[one] = None
        for example in () if self.has_more_examples else examples:
            if example in self.examples:
                continue
            if len(self.examples) < MAX_EXAMPLES:
                self.examples.append(example)
            else:
                self.has_more_examples = True
                break

    def summary(self) -> Finding:
        """One finding about all cases, with their number and some examples in its message."""
        examples = ", ".join(self.examples) + (", ..." if self.has_more_examples else "")
        message = self.finding.message.replace("{count}", str(self.count))
        message = message.replace("{examples}", examples)
        cases = tuple(sorted(self.packets))
        return replace(self.finding, message=message, count=self.count, cases=cases)


class SecurityCases:
    """Collects the cases of all rules about attacks and scans."""

    def __init__(self) -> None:
        self._cases: dict[tuple[str, str], _SourceCases] = {}
        """The cases; the key is the code of the rule and the source (a host or serial line)."""

    def add(
        self,
        source: str,
        code: str,
        make: Callable[[], Finding],
        count: int,
        examples: Iterable[str] = (),
        packets: Iterable[Packets] = (),
    ) -> None:
        """Add `count` cases of one source (a host or serial line) to those of the rule `code`.

        `make` is called for the first cases of a rule and source, and makes the finding that the
        summary uses. `examples` are short texts, such as addresses, of which the message shows
        some. `packets` are those of the cases.
        """
        cases = self._cases.get((code, source))
        if cases is None:
            if len(self._cases) >= MAX_SOURCES:
                return
            cases = self._cases[code, source] = _SourceCases(make())
        cases.add(count, examples, packets)

    def close(self) -> Iterator[Finding]:
        """Give one finding for each rule and source, sorted by the rule's code and by time."""
        found = (cases.summary() for cases in self._cases.values())
        yield from sorted(found, key=lambda one: (one.code, one.ts_ns))


def host_of(end: str) -> str:
    """The host in a text HOST:PORT; the whole text if it has no port."""
    return end.rpartition(":")[0] or end


def master_text(transaction: NamedTransaction) -> str:
    """Return the name of the request's sender, for a message: the master's host, or `the master` on
    a serial line, where it has no address.
    """
    return "the master" if transaction.source is None else host_of(transaction.source)


def place_text(transaction: NamedTransaction) -> str:
    """Return the slave's place, for a message: its HOST:PORT, or its line as `the line rs485`."""
    return transaction.destination or f"the line {transaction.link}"


def is_identification(transaction: NamedTransaction) -> bool:
    function = transaction.function
    if function == ENCAPSULATED:
        return transaction.sub_function == _READ_DEVICE_IDENTIFICATION
    return function in (REPORT_SERVER_ID, _READ_MODEL_CODE)
