"""Keeps what live views show besides statistics: last transactions, values, events, findings."""

# Each record costs little time (a test counts the calls): if a poll (repeated request) reads the
# same values as last time, no point (named value) is changed, because the age of a point is the age
# of its poll. Rows are made only when a view is drawn.
#
# Memory: MAX_KEPT records and as many events of connections, MAX_POINTS points, MAX_TROUBLES kinds
# of events and findings, MAX_POLLS polls, and the account (ledger/account.py). A new record
# replaces the oldest one, and a new poll the one that was not sent for longest; further points and
# kinds are only counted in `left_out`.

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple, overload

from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.devices.references import write_reference
from mbtool.ledger.account import MAX_POLLS, Account
from mbtool.ledger.request_tally import RequestTally
from mbtool.ledger.statistics_report import report, unit_tallies
from mbtool.modbus import FUNCTIONS, Outcome, Table, Verdict
from mbtool.modbus.functions import MASK_WRITE_REGISTER, READ_WRITE_REGISTERS
from mbtool.modbus.response import MAX_FRAMES
from mbtool.values.guessed_series import guessed_name
from mbtool.watching.guessed_points import GuessedPoints, number_of
from mbtool.watching.watched_rows import (
    NEVER_NS,
    KeptRecord,
    Record,
    TroubleRow,
    WatchedPoint,
    WatchedPoll,
    errors_of,
)

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, PointValue, Profile
    from mbtool.ledger.poll_statistics import PollKey, PollStatistics
    from mbtool.ledger.unit_account import UnitAccount
    from mbtool.troubles.judge import Judgement
    from mbtool.troubles.trouble import Trouble
    from mbtool.values.judging import Judged

# The code below makes table rows from a board (the figures of live views): copies, which do not
# change later.

_ANSWERS = (Outcome.OK, Outcome.EXCEPTION, Outcome.MALFORMED)
"""Outcomes with a response, the same as in statistics."""
_AT_NS = attrgetter("at_ns")
_FIELDS = attrgetter(*(one.name for one in fields(WatchedPoint)))


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


@dataclass(slots=True, kw_only=True)
class WatchedPointRow(WatchedPoint):
    """A row for a point (a value named by the slave's profile), or an unnamed register or bit."""

    key: Hashable
    kept: KeptRecord
    """The last transaction of the poll (repeated request) that gave the value."""
    last_ns: int
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
    """True if the account counts the request as a retry."""


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
    """The troubles of the unit, the worst first."""


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
            findings[kind.link, kind.unit] += kind.times
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
    return sorted(map(copy, board.troubles.values()), key=lambda row: row.kept.order)


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
    poll = point.poll
    row = WatchedPointRow(
        *_FIELDS(point), key=key, kept=poll.last, last_ns=poll.last_ns, pair=_pair(point)
    )
    row.history = point.history.copy()
    return row


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


MAX_KEPT = 10_000
MAX_POINTS = 20_000
MAX_TROUBLES = 1024
_MAX_BLAMED = 2 * MAX_KEPT
_MAX_RETRIES = 2 * MAX_KEPT

RetryKey = tuple[str, int, int]
"""The link and the unit of a request, and its time in UTC ns."""
_BAD_CHECK = EventKind.BAD_CHECK.value
_CONNECTION = (EventKind.OPENED, EventKind.CLOSED)


class Board:
    """Takes records one by one; its attributes hold what live views show."""

    def __init__(
        self,
        format_of: Callable[[str], SerialFormat | None] = lambda _: None,
        profile_for: Callable[[NamedTransaction], Profile | None] = lambda _: None,
        *,
        kept: int = MAX_KEPT,
        whole: Board | None = None,
    ) -> None:
        """Make an empty board that keeps at most `kept` records.

        `format_of` returns the character format of a link by its name, None if the link is not
        serial. `profile_for` returns the profile of a transaction's slave, None if it has none.
        `whole` is the board of all records if this board is for those that pass a filter.
        """
        self.profile_for = profile_for
        self.whole = whole or self
        """The board that tells how well slaves answer, and which requests are retries, as a filter
        may let only failures pass."""
        self.part: Board | None = None
        """The board of the records that pass a filter, which gets the retries from this board."""
        self.account = Account(format_of, self._note_retry, is_part=whole is not None)
        self.retries: OrderedDict[RetryKey, None] = OrderedDict()
        """The last requests that are retries; on a board for a filter none, as they are those of
        the board `whole`."""
        self._asked_again: OrderedDict[RetryKey, PollStatistics] = OrderedDict()
        """On a board for a filter, the last requests that may be retries, and their polls."""
        self._bad_checks: dict[str, deque[tuple[int, KeptRecord]]] = {}
        """By link, times (UTC ns) and events of the last frames with a wrong CRC or LRC that
        belong to no unit so far. They are one more than can still be matched with a request, so
        the last one that stays is among them."""
        self.blamed: OrderedDict[int, int] = OrderedDict()
        """The unit by the `order` number of a record: of an event that tells of a damaged response
        of the unit, and of the request to it."""
        self.damaged: OrderedDict[int, WireEvent] = OrderedDict()
        """The event of the damaged response by the `order` number of the request to which it
        belongs."""
        self.records: deque[KeptRecord] = deque(maxlen=kept)
        """The last transactions and events, in the order in which they were decoded; without
        connections that open and close, as many short ones would push out everything else."""
        self.connections: deque[KeptRecord] = deque(maxlen=kept)
        """The last events of connections that open and close."""
        self.listed = 0
        """The number of records that were ever put into `records`."""
        self.polls: OrderedDict[int, WatchedPoll] = OrderedDict()
        """The polls (repeated requests) by their number, which counts them from 0 in the order in
        which they were first sent. The one that was sent last is at the end."""
        self.points: dict[tuple[str, int, object, object], WatchedPoint] = {}
        self.troubles: dict[tuple[str, str, int | None], TroubleRow] = {}
        self.guesses: GuessedPoints | None = GuessedPoints()
        """The registers that are surely one number; None to show words."""
        self.left_out = 0
        self.judgement: Judgement | None = None
        """What is wrong, as it was last judged; None before that, and on a board for a filter."""
        self.last_ns = 0
        """The latest start of a transaction, or time of an event, so far; in ns since 1970."""

    def add(self, kept: KeptRecord, *, listed: bool = True) -> None:
        """Take the next record, with its numbers in the capture.

        With `listed` false it changes all figures, but is not kept.
        """
        record = kept.record
        if isinstance(record, WireEvent):
            self._add_event(kept, record, listed=listed)
            return
        if listed:
            self.records.append(kept)
            self.listed += 1
        at_ns = kept.at_ns
        if at_ns > self.last_ns:
            self.last_ns = at_ns
        counted = self.account.add(record)
        frame_ns = self.account.damaged_ns
        is_damaged = frame_ns is not None
        if frame_ns is not None:
            self._blame(record, kept, frame_ns)
        if counted is not None:
            poll = self.polls.get(counted.number)
            if poll is None:
                poll = self.polls[counted.number] = WatchedPoll(counted, kept)
                if len(self.polls) > MAX_POLLS:
                    self.polls.popitem(last=False)
            else:
                self.polls.move_to_end(counted.number)
            self._note_poll(poll, kept, record, at_ns, is_damaged=is_damaged)
            if record.retries and self.whole is not self and record.request_ns is not None:
                self._note_possible_retry((record.link, record.unit, record.request_ns), counted)
        for code in record.findings:
            self._note_trouble(code, kept, record.link, record.unit, at_ns)

    def _add_event(self, kept: KeptRecord, event: WireEvent, *, listed: bool) -> None:
        if listed and event.kind in _CONNECTION:
            self.connections.append(kept)
        elif listed:
            self.records.append(kept)
            self.listed += 1
        self.account.add(event)
        self.last_ns = max(self.last_ns, event.ts_ns)
        if event.kind is EventKind.BAD_CHECK:
            events = self._bad_checks.setdefault(event.link, deque(maxlen=MAX_FRAMES + 1))
            events.append((event.ts_ns, kept))
        self._note_trouble(event.kind.value, kept, event.link, None, event.ts_ns)

    def advance(self, before_ns: int | None) -> None:
        """Let the account count the periods and retries of requests from before `before_ns` (ns
        since 1970).

        It holds requests back to take them in order of time, as records do not come in that order.
        The caller says that no earlier request will come; None takes all that wait.
        """
        self.account.settle(before_ns)
        if before_ns is None:
            for poll in self.polls.values():
                poll.forget_period()

    def _note_retry(self, poll: PollStatistics, at_ns: int, by: int) -> None:
        """Note that a request of `poll` is a retry (`by` 1), or none after all (-1).

        `at_ns` (UTC ns) is its time. A board with a filter lacks the requests between, so it
        gets the retries from here.
        """
        if self.whole is not self:
            return
        key = poll.key.link, poll.key.unit, at_ns
        if self.part is not None and key in self.part._asked_again:
            self.part.account.count_retry(self.part._asked_again[key], at_ns, by)
        if by < 0:
            self.retries.pop(key, None)
            return
        self.retries[key] = None
        if len(self.retries) > _MAX_RETRIES:
            self.retries.popitem(last=False)

    def _note_possible_retry(self, key: RetryKey, poll: PollStatistics) -> None:
        """Note a request of the poll that may be a retry, or turn out to be."""
        self._asked_again[key] = poll
        if len(self._asked_again) > _MAX_RETRIES:
            self._asked_again.popitem(last=False)
        if key in self.whole.retries:
            self.account.count_retry(poll, key[-1], 1)

    def _note_poll(
        self,
        poll: WatchedPoll,
        kept: KeptRecord,
        one: NamedTransaction,
        at_ns: int,
        *,
        is_damaged: bool,
    ) -> None:
        poll.latencies.append(one.latency_ns)
        if at_ns > poll.last_ns:
            poll.last_ns = at_ns
        if at_ns < poll.last.at_ns and not _is_cut_off(poll.last.record):
            return  # It has no response, so it was decoded late; newer values are shown.
        if one.outcome is Outcome.NOT_CAPTURED and _is_cut_off(one) and kept is not poll.last:
            return  # Keep the last transaction with a known outcome.
        poll.last, poll.is_damaged = kept, is_damaged
        if one.outcome not in (Outcome.OK, Outcome.LATE, Outcome.BROADCAST):
            return
        values = one.request_values if one.response_values is None else one.response_values
        is_same = values == poll.values and one.function != READ_WRITE_REGISTERS
        if values is None or (is_same and not poll.shares_points):
            return
        if poll.values is not None:
            _note_changes(poll, values, at_ns)
        else:
            poll.changed_ns = [NEVER_NS] * len(values)
        poll.values = values
        self._note_points(poll, one, at_ns)

    def _note_points(self, poll: WatchedPoll, one: NamedTransaction, at_ns: int) -> None:
        if one.points:
            for point in one.points:
                self._note_named(poll, one, point, at_ns)
            return
        function = FUNCTIONS.get(one.function)
        if function is None or function.table is None or one.function == MASK_WRITE_REGISTER:
            return
        if one.response_values is not None and one.address is not None:
            written = function.writes and one.function != READ_WRITE_REGISTERS
            self._note_raw(
                poll, one, function.table, one.address, one.response_values, at_ns, written
            )
        address = one.write_address if one.function == READ_WRITE_REGISTERS else one.address
        if function.writes and one.request_values is not None and address is not None:
            self._note_raw(poll, one, function.table, address, one.request_values, at_ns, True)

    def _note_named(
        self, poll: WatchedPoll, one: NamedTransaction, point: PointValue, at_ns: int
    ) -> None:
        key = one.link, one.unit, one.device, point.name
        row = self.points.get(key)
        if row is None:
            if len(self.points) >= MAX_POINTS:
                self.left_out += 1
                return
            name = "" if point.name == point.reference else point.name
            row = self.points[key] = WatchedPoint(
                one.link, one.unit, one.device, point.reference, name, None, None, poll
            )
        before = row.text
        _take_over(row, poll)
        row.value_unit = point.unit
        row.set(point.value, point.text, at_ns, written=point in one.written_points)
        if before and row.changed_ns == at_ns:
            poll.points_changed_ns[point.name] = at_ns

    def _note_raw(
        self,
        poll: WatchedPoll,
        one: NamedTransaction,
        table: Table,
        first: int,
        values: Sequence[int],
        at_ns: int,
        written: bool,
    ) -> None:
        guesses = None if written or table.is_bits else self.guesses
        if guesses is not None:
            for new in guesses.learn(one.link, one.unit, table, first, values, at_ns):
                for address in range(new.address, new.address + new.words):
                    self.points.pop((one.link, one.unit, table, address), None)
        for address, value in enumerate(values, first):
            key = one.link, one.unit, table, address
            guess = None if guesses is None else guesses.at(*key)
            if guess is not None:
                self._note_guess(poll, one, guess, first, values, at_ns)
                continue
            row = self.points.get(key)
            if row is None:
                if len(self.points) >= MAX_POINTS:
                    self.left_out += 1
                    return
                row = self.points[key] = self._raw_point(poll, one, table, address)
            elif row.value == value and row.poll is poll and row.is_written is written:
                continue
            _take_over(row, poll)
            row.set(value, str(value), at_ns, written=written)

    def _note_guess(
        self,
        poll: WatchedPoll,
        one: NamedTransaction,
        guess: Judged,
        first: int,
        values: Sequence[int],
        at_ns: int,
    ) -> None:
        """Note the number of several registers whose type is guessed, if all of them were read."""
        words = values[guess.address - first :][: guess.words] if guess.address >= first else ()
        number = number_of(guess, words) if len(words) == guess.words else None
        if number is None:
            return
        key = one.link, one.unit, guess.table, guess.address
        row = self.points.get(key)
        if row is None:
            if len(self.points) >= MAX_POINTS:
                self.left_out += 1
                return
            row = self.points[key] = WatchedPoint(
                one.link, one.unit, one.device, guessed_name(guess), "", None, None, poll
            )
        _take_over(row, poll)
        row.set(number, str(int(number)) if number == int(number) else f"{number:.7g}", at_ns)

    def _raw_point(
        self, poll: WatchedPoll, one: NamedTransaction, table: Table, address: int
    ) -> WatchedPoint:
        reference = write_reference(self.profile_for(one), table, address)
        return WatchedPoint(one.link, one.unit, one.device, reference, "", table, address, poll)

    def _blame(self, one: NamedTransaction, kept: KeptRecord, frame_ns: int) -> None:
        """Note that the damaged frame of time `frame_ns` (UTC ns) came from the unit of a request.

        Its event is then counted as one about this unit.
        """
        self.blamed[kept.order] = one.unit
        events = self._bad_checks[one.link]
        for at, (at_ns, event) in enumerate(events):
            if at_ns == frame_ns:
                del events[at]
                self.blamed[event.order] = one.unit
                if isinstance(event.record, WireEvent):
                    self.damaged[kept.order] = event.record
                if self._take_back(one.link, events):
                    self._note_trouble(_BAD_CHECK, event, one.link, one.unit, frame_ns)
                break
        while len(self.blamed) > _MAX_BLAMED:
            self.blamed.popitem(last=False)
        while len(self.damaged) > MAX_KEPT:
            self.damaged.popitem(last=False)

    def _take_back(self, link: str, left: Sequence[tuple[int, KeptRecord]]) -> bool:
        """Count one damaged frame of no unit less; `left` has the last events that stay.

        Return False if such frames are not counted, as there are too many kinds of troubles.
        """
        row = self.troubles.get((_BAD_CHECK, link, None))
        if row is None:
            return False
        row.times -= 1
        if not row.times:
            del self.troubles[_BAD_CHECK, link, None]
            return True
        row.last_ns, row.kept = left[-1]
        if len(left) == row.times:
            row.first_ns = left[0][0]
        return True

    def _note_trouble(
        self, code: str, kept: KeptRecord, link: str, unit: int | None, at_ns: int
    ) -> None:
        key = code, link, unit
        row = self.troubles.get(key)
        if row is None:
            if len(self.troubles) >= MAX_TROUBLES:
                self.left_out += 1
                return
            is_finding = not isinstance(kept.record, WireEvent)
            row = self.troubles[key] = TroubleRow(code, is_finding, link, unit, at_ns, kept)
        row.kept, row.last_ns = kept, at_ns
        row.times += 1


def _is_cut_off(record: Record) -> bool:
    """True for a request whose response may have come after the capture's end."""
    return not isinstance(record, WireEvent) and Verdict.CAPTURE_END in record.verdicts


def _take_over(row: WatchedPoint, poll: WatchedPoll) -> None:
    """Let `poll` be the one that gave the last value of a point."""
    if row.poll is not poll:
        row.poll.shares_points = poll.shares_points = True
        row.poll = poll


def _note_changes(poll: WatchedPoll, values: Sequence[int], at_ns: int) -> None:
    """Set the time of the last change to `at_ns` for each value of the poll that has changed.

    `values` are the new values. If their number differs from the last one, all have changed.
    """
    before = poll.values or []
    changed = poll.changed_ns
    if len(values) != len(before):
        poll.changed_ns = [at_ns] * len(values)
        return
    for index, (old, new) in enumerate(zip(before, values, strict=True)):
        if old != new:
            changed[index] = at_ns
