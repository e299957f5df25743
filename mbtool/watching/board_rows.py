"""Makes table rows from a board (the figures of live views): copies, which do not change later."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple, overload

from mbtool.core import WireEvent
from mbtool.ledger.request_tally import RequestTally
from mbtool.ledger.statistics_report import report, unit_tallies
from mbtool.modbus import Outcome
from mbtool.watching.watched_rows import NEVER_NS, KeptRecord, errors_of

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Mapping

    from mbtool.ledger.poll_statistics import PollKey
    from mbtool.ledger.unit_account import UnitAccount
    from mbtool.modbus import Table
    from mbtool.troubles.trouble import Trouble
    from mbtool.watching.board import Board, RetryKey
    from mbtool.watching.watched_rows import (
        WatchedPoint,
        WatchedPoll,
    )

_ANSWERS = (Outcome.OK, Outcome.EXCEPTION, Outcome.MALFORMED)
"""Outcomes with a response, the same as in statistics."""
_AT_NS = attrgetter("at_ns")


class PollRow(NamedTuple):
    """A row for a repeated request. Times are in ns since 1970, durations in ns."""

    key: Hashable
    kept: KeptRecord
    """The last transaction of this poll."""
    is_damaged: bool
    """True if the response in the last transaction came with a wrong CRC or LRC."""
    poll: PollKey
    function_name: str
    reference: str | None
    device: str | None
    asked: int
    errors: int
    """The number of exceptions, malformed responses and missing responses."""
    missing: int
    retries: int
    last_ns: int
    period_ns: int
    """The median time between two requests; 0 if it is not known."""
    has_regular_period: bool
    """False if the times between two requests differ so widely that the median tells nothing."""
    slowest_ns: int
    values: Sequence[int]
    changed_ns: Sequence[int]
    points_changed_ns: dict[str, int]
    latencies: Sequence[int | None]


class WatchedPointRow(NamedTuple):
    """A row for a point (a value named by the slave's profile), or an unnamed register or bit."""

    key: Hashable
    kept: KeptRecord
    """The last transaction of the poll (repeated request) that gave the value."""
    link: str
    unit: int
    device: str | None
    reference: str
    name: str
    table: Table | None
    value: int | float | None
    text: str
    value_unit: str | None
    before: str
    changed_ns: int
    last_ns: int
    changes: int
    is_written: bool
    history: Sequence[float]
    pair: tuple[int, int] | None
    """The numbers in this register and in the next one, to be shown as a 32-bit float; None if no
    response had both."""


class RecordRow(NamedTuple):
    """A row for a transaction or an event."""

    key: Hashable
    kept: KeptRecord
    unit: int | None
    """The unit; for an event, that of the damaged response which it tells of, or None."""
    is_damaged: bool
    """True if the response to the request came with a wrong CRC or LRC."""
    is_retry: bool
    """True if the request is a retry, by the rule of the account."""


class WatchedSlaveRow(NamedTuple):
    """A row for one unit of a link. Times are in ns since 1970, durations in ns."""

    key: Hashable
    kept: None
    link: str
    unit: int
    device: str | None
    asked: int
    answered: int
    """The number of responses; exceptions and malformed responses are among them."""
    exceptions: int
    missing: int
    damaged: int
    """The number of missing responses that came, but with a wrong CRC or LRC."""
    malformed: int
    retries: int
    median_ns: int
    slowest_ns: int
    first_ns: int
    last_ns: int
    answered_ns: int | None
    silent_since_ns: int | None
    findings: int
    whole: WatchedSlaveRow | None
    """Under a filter, the row of the same unit for all records, by which it is judged."""
    troubles: tuple[Trouble, ...]
    """What is wrong with the unit, the worst first."""


class TroubleRow(NamedTuple):
    """A row for all findings of one code, or events of one kind, about one unit of a link."""

    key: Hashable
    kept: KeptRecord
    code: str
    is_finding: bool
    link: str
    unit: int | None
    times: int
    first_ns: int
    last_ns: int


WatchRow = PollRow | WatchedPointRow | RecordRow | WatchedSlaveRow | TroubleRow


def poll_rows(board: Board) -> list[PollRow]:
    """Return the repeated requests in the order in which they were first sent."""
    polls = sorted(board.polls.items())
    return [_poll_row(number, poll) for number, poll in polls]


def point_rows(board: Board) -> list[WatchedPointRow]:
    """Return points, registers and bits in the order in which they were first read or written."""
    return [_point_row(key, point) for key, point in board.points.items()]


class RecordRows(Sequence[RecordRow]):
    """The rows of many records. A row is made when it is read: a screen shows few of them."""

    def __init__(
        self,
        kept: list[KeptRecord],
        blamed: Mapping[int, int],
        retries: Collection[RetryKey],
        *,
        heard: int,
    ) -> None:
        """Take the records in the order of the rows, and the board's `blamed` and `retries`."""
        self._kept, self._blamed, self._retries = kept, blamed, retries
        self.heard = heard
        """The number of records so far, with the older ones that are no longer kept."""

    def __len__(self) -> int:
        return len(self._kept)

    @overload
    def __getitem__(self, at: int) -> RecordRow: ...
    @overload
    def __getitem__(self, at: slice) -> RecordRows: ...
    def __getitem__(self, at: int | slice) -> RecordRow | RecordRows:
        if isinstance(at, slice):
            return RecordRows(self._kept[at], self._blamed, self._retries, heard=self.heard)
        return _record_row(self._kept[at], self._blamed, self._retries)


def record_rows(board: Board) -> RecordRows:
    """Return the transactions and events that are kept, in the order of their times."""
    kept = sorted(board.records, key=_AT_NS)
    retries = frozenset(board.whole.retries)
    return RecordRows(kept, dict(board.blamed), retries, heard=board.listed)


def _record_row(
    kept: KeptRecord, blamed: Mapping[int, int], retries: Collection[RetryKey]
) -> RecordRow:
    record = kept.record
    if isinstance(record, WireEvent):
        return RecordRow(kept.order, kept, blamed.get(kept.order), False, False)
    is_retry = record.retries > 0 and (record.link, record.unit, record.request_ns) in retries
    return RecordRow(kept.order, kept, record.unit, kept.order in blamed, is_retry)


def slave_rows(board: Board) -> list[WatchedSlaveRow]:
    """Return the slaves, sorted by link and unit, with their troubles when `judge` was last
    asked.
    """
    every = {} if board.whole is board else {row.key: row for row in slave_rows(board.whole)}
    troubles: dict[tuple[str, int], list[Trouble]] = {}
    for trouble in () if board.whole.judgement is None else board.whole.judgement.troubles:
        for one in trouble.all:
            if one.unit is not None:
                troubles.setdefault((one.link, one.unit), []).append(one)
    findings: Counter[tuple[str, int | None]] = Counter()
    for kind in board.troubles.values():
        if kind.is_finding:
            findings[kind.link, kind.unit] += kind.count
    links = report(board.account, with_cycles=False)
    retries: Counter[tuple[str, int]] = Counter()
    for link in links:
        for each in link.functions:
            retries[link.name, each.unit] += each.repetitions
    tallies = unit_tallies(links, broadcasts=True)
    return [
        _slave_row(
            unit,
            tallies.get(key, RequestTally()),
            retries[key],
            findings[key],
            every.get(key),
            tuple(troubles.get(key, ())),
        )
        for key, unit in sorted(board.account.units.items())
    ]


def trouble_rows(board: Board) -> list[TroubleRow]:
    """Return findings and events by kind; the kind that occurred last is at the end."""
    rows = [
        TroubleRow(
            key, one.last, one.code, one.is_finding, one.link, one.unit, one.count, one.first_ns,
            one.last_ns,
        )
        for key, one in board.troubles.items()
    ]  # fmt: skip
    return sorted(rows, key=lambda row: row.kept.order)


def _poll_row(number: int, poll: WatchedPoll) -> PollRow:
    poll.refresh_period()
    account = poll.account
    tally = account.tally
    return PollRow(
        key=number,
        kept=poll.last,
        is_damaged=poll.is_damaged,
        poll=account.key,
        function_name=account.function_name,
        reference=account.reference,
        device=account.device,
        asked=tally.requests,
        errors=errors_of(tally),
        missing=tally.not_in_time,
        retries=account.repetitions,
        last_ns=poll.last_ns,
        period_ns=poll.period_ns,
        has_regular_period=poll.has_regular_period,
        slowest_ns=tally.latency.greatest,
        values=poll.values or (),
        changed_ns=tuple(poll.changed_ns),
        points_changed_ns=dict(poll.points_changed_ns),
        latencies=tuple(poll.latencies),
    )


def _point_row(key: Hashable, point: WatchedPoint) -> WatchedPointRow:
    return WatchedPointRow(
        key=key,
        kept=point.poll.last,
        link=point.link,
        unit=point.unit,
        device=point.device,
        reference=point.reference,
        name=point.name,
        table=point.table,
        value=point.value,
        text=point.text,
        value_unit=point.value_unit,
        before=point.before,
        changed_ns=point.changed_ns,
        last_ns=point.poll.last_ns,
        changes=point.changes,
        is_written=point.is_written,
        history=tuple(point.history),
        pair=_pair(point),
    )


def _pair(point: WatchedPoint) -> tuple[int, int] | None:
    first, values = point.poll.account.key.address, point.poll.values
    if point.address is None or first is None or values is None:
        return None
    at = point.address - first
    return (values[at], values[at + 1]) if 0 <= at < len(values) - 1 else None


def _slave_row(
    unit: UnitAccount,
    tally: RequestTally,
    retries: int,
    findings: int,
    whole: WatchedSlaveRow | None,
    troubles: tuple[Trouble, ...],
) -> WatchedSlaveRow:
    return WatchedSlaveRow(
        key=unit.key,
        kept=None,
        link=unit.key.link,
        unit=unit.key.unit,
        device=unit.device,
        asked=tally.requests,
        answered=sum(map(tally.count, _ANSWERS)),
        exceptions=tally.count(Outcome.EXCEPTION),
        missing=tally.not_in_time,
        damaged=tally.damaged,
        malformed=tally.count(Outcome.MALFORMED),
        retries=retries,
        median_ns=tally.latency.percentile(50),
        slowest_ns=tally.latency.greatest,
        first_ns=unit.first_ns,
        last_ns=unit.last_ns,
        answered_ns=unit.answered_ns if unit.answered_ns > NEVER_NS else None,
        silent_since_ns=unit.silent_since_ns if unit.is_silent else None,
        findings=findings,
        whole=whole,
        troubles=troubles,
    )
