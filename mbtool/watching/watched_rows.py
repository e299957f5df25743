"""What live views keep for each poll, point, and kind of event or finding."""

# Memory: a poll (repeated request) keeps its last transaction, the time of the last change of each
# of its values (at most 2000, as many as a request can read) and HISTORY latencies; a point (named
# value) keeps HISTORY values.

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import WireEvent
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.ledger.poll_statistics import PollStatistics
from mbtool.modbus import Outcome, Table

if TYPE_CHECKING:
    from mbtool.ledger.request_tally import RequestTally

Record = NamedTransaction | WireEvent

HISTORY = 32
"""The number of latencies or values that are kept for a sparkline."""
NEVER_NS = 0
"""Stands for the time of a change if there was none."""

_FAULTS = (Outcome.EXCEPTION, Outcome.LATE, Outcome.NO_ANSWER, Outcome.MALFORMED)
"""Outcomes that count as errors. A request whose response the capture lacks is not one of them."""


class KeptRecord(NamedTuple):
    """A transaction or an event, with its number in the capture."""

    order: int
    """The number of the record among all records, from 1."""
    number: int | None
    """The number of the transaction among all transactions, from 1; None for an event."""
    at_ns: int
    """The start of the transaction, or the time of the event, in ns since 1970."""
    record: Record


def kept_record(order: int, number: int | None, record: Record) -> KeptRecord:
    """Return a record with its numbers (see KeptRecord) and its time."""
    at_ns = record.ts_ns if isinstance(record, WireEvent) else record.start_ns
    return KeptRecord(order, number, at_ns, record)


@dataclass(slots=True)
class WatchedPoll:
    """A request that a master repeats: its last transaction, and which of its values changed."""

    account: PollStatistics
    last: KeptRecord
    """The last transaction; not one whose response the capture's end cut off, if there is another.
    """
    last_ns: int = NEVER_NS
    """The time of the last request, in ns since 1970."""
    is_damaged: bool = False
    """True if the response in `last` came with a wrong CRC or LRC."""
    values: list[int] | None = None
    """The values that were last read or written; None before the first ones."""
    changed_ns: list[int] = field(default_factory=list)
    """For each value the time of its last change, in ns since 1970; NEVER_NS if it never
    changed."""
    points_changed_ns: dict[str, int] = field(default_factory=dict)
    """The time of the last change (ns since 1970) of each point (named value) that has changed, by
    its name."""
    latencies: deque[int | None] = field(default_factory=lambda: deque(maxlen=HISTORY))
    """The last latencies in ns; None for a request without response."""
    period_ns: int = 0
    """The median time between two requests, in ns; 0 if only one was sent."""
    has_regular_period: bool = False
    """False if the times between two requests differ widely, by the rule of the account."""
    shares_points: bool = False
    """True if another poll gives or gave values of the same points, so that a value may have
    changed though this poll reads the same as before."""
    _period_at: int = 0

    def refresh_period(self) -> None:
        """Compute `period_ns` again if the number of periods has grown by more than an eighth.

        Doing it for each request would take too long.
        """
        count = self.account.period.count
        if count > self._period_at + self._period_at // 8:
            self._period_at = count
            self.period_ns = self.account.period.percentile(50)
            self.has_regular_period = self.account.has_regular_period

    def forget_period(self) -> None:
        """Let the next `refresh_period` compute the period in any case."""
        self._period_at = 0


@dataclass(slots=True)
class WatchedPoint:
    """A point (a value that the profile names), or a register or bit without a name."""

    link: str
    unit: int
    device: str | None
    reference: str
    name: str
    """The name of the point; empty for a register or bit without a name."""
    table: Table | None
    address: int | None
    """The address on the wire; None for a named point."""
    poll: WatchedPoll
    """The poll (repeated request) that gave the last value; the value is as old as the poll's last
    response."""
    value: int | float | None = None
    text: str = ""
    value_unit: str | None = None
    before: str = ""
    """The text of the value before the last change; empty if the value never changed."""
    changed_ns: int = NEVER_NS
    changes: int = 0
    is_written: bool = False
    """True if a master wrote the last value, False if it was read."""
    history: deque[float] = field(default_factory=lambda: deque(maxlen=HISTORY))
    """The last values of the point, each different from the one before."""

    def set(
        self, value: int | float | None, text: str, at_ns: int, *, written: bool = False
    ) -> None:
        """Note a value that was read or written at `at_ns` (ns since 1970).

        `value` is None if the value is a text only. The point's first value is not counted as a
        change.
        """
        self.is_written = written
        if text == self.text and value == self.value:
            return
        if self.text:
            self.before, self.changed_ns = self.text, at_ns
            self.changes += 1
        self.value, self.text = value, text
        if value is not None:
            self.history.append(value)


@dataclass(slots=True)
class TroubleRow:
    """A row for all findings of one code, or events of one kind, about one unit of a link."""

    code: str
    """The code of the finding, or the kind of the event."""
    is_finding: bool
    link: str
    unit: int | None
    first_ns: int
    kept: KeptRecord
    """The last transaction with the finding, or the last event."""
    last_ns: int = 0
    times: int = 0

    @property
    def key(self) -> Hashable:
        return self.code, self.link, self.unit


def errors_of(tally: RequestTally) -> int:
    """Return the number of requests with an exception, a malformed response or no response."""
    return sum(tally.count(outcome) for outcome in _FAULTS)
