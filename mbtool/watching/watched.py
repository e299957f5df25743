"""Keeps the records for live views on two boards: all records, and those that pass a filter."""

# A filter that is set later is applied to all records if the caller still has them, otherwise to
# the records that are kept here. From then on, each new record is added to both boards. So figures
# under a filter may lack the oldest transactions; `unfiltered` is their number.
#
# Memory: two boards (board.py), and MAX_MARKED marked records.

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from heapq import merge
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat, WireEvent
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.ledger.statistics_report import report
from mbtool.troubles.judge import Judge, Judgement
from mbtool.watching.board import MAX_KEPT, Board
from mbtool.watching.watched_rows import KeptRecord, Record, kept_record

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, Profile

    Wanted = Callable[[NamedTransaction], bool]

MAX_MARKED = 1000
_ORDER = attrgetter("order")


class Watched:
    """All records so far, for the live views. Not safe for several threads at once."""

    def __init__(
        self,
        format_of: Callable[[str], SerialFormat | None] = lambda _: None,
        profile_for: Callable[[NamedTransaction], Profile | None] = lambda _: None,
        context: CaptureContext | None = None,
        *,
        kept: int = MAX_KEPT,
    ) -> None:
        """Take functions that return the character format of a link by its name, and the profile of
        a transaction's slave. `context` has the facts that rules need beside the records.
        """
        self._format_of, self._profile_for, self._kept = format_of, profile_for, kept
        self._context = context or CaptureContext(line_of=format_of)
        self._guesses = True
        self.wanted: Wanted | None = None
        """The user's filter; None if every record passes."""
        self._order = self._numbers = 0
        self._settled_ns: int | None = 0
        self.whole = self._board()
        self._judge = Judge(self.whole.account, self._context)
        self.filtered: Board | None = None
        """The board of the records that pass the filter; None without a filter."""
        self.unfiltered = 0
        """The number of oldest transactions that the filter has not seen, as they were no longer
        kept."""
        self.marked: dict[int, KeptRecord] = {}
        """The records that the user marked, by their `order` (number among all records)."""

    def show_words(self) -> None:
        """Show the words of registers, and guess no types. Call it before the first record."""
        self._guesses = False
        self.whole.guesses = None

    def add(self, record: Record) -> None:
        """Take the next record: a transaction or an event."""
        self._order += 1
        is_event = isinstance(record, WireEvent)
        if not is_event:
            self._numbers += 1
        kept = kept_record(self._order, None if is_event else self._numbers, record)
        self.whole.add(kept)
        self._judge.hear(record)
        for finding in self._judge.check(record):
            self._judge.note(finding)
        if self.filtered is not None:
            self._add_filtered(self.filtered, kept)

    def judge(self) -> Judgement:
        """Return the troubles of all records so far, and keep them on the board."""
        links = report(self.whole.account, with_cycles=False)
        self.whole.judgement = self._judge.judgement(links)
        return self.whole.judgement

    def advance(self, before_ns: int | None) -> None:
        """Let the account count the requests from before `before_ns` (ns since 1970).

        The account holds requests back to count them in order of time, as records do not come in
        that order. The caller says that no earlier request will come; None counts all that wait.
        """
        self._settled_ns = before_ns
        self.whole.advance(before_ns)
        if self.filtered is not None:
            self.filtered.advance(before_ns)

    def restart(self) -> None:
        """Forget all records, because a file is played from its beginning again.

        The filter and the marks stay.
        """
        self._order = self._numbers = self.unfiltered = 0
        self.whole = self._board()
        self._judge = Judge(self.whole.account, self._context)
        if self.filtered is not None:
            self.filtered = self.whole.part = self._board(self.whole)

    def set_filter(self, wanted: Wanted | None, past: Iterable[Record] | None = None) -> None:
        """Apply a filter to the kept records and to all later ones; None ends filtering.

        `past` begins with all records that were added so far; with it, the filter sees them all.
        """
        self.wanted = wanted
        self.filtered = self.whole.part = None
        self.unfiltered = 0
        if wanted is None:
            return
        self.filtered = self.whole.part = self._board(self.whole)
        whole = self.whole
        records = (
            merge(whole.records, whole.connections, key=_ORDER)
            if past is None
            else _numbered(islice(past, self._order))
        )
        for kept in records:
            self._add_filtered(self.filtered, kept)
        if past is None:
            numbers = (kept.number for kept in whole.records if kept.number is not None)
            self.unfiltered = next(numbers, self._numbers + 1) - 1
        self.filtered.advance(self._settled_ns)

    def toggle_mark(self, kept: KeptRecord) -> bool:
        """Mark a record; if it is marked already, remove its mark.

        Returns False, and marks nothing, if MAX_MARKED other records are marked.
        """
        if self.marked.pop(kept.order, None) is not None:
            return True
        if len(self.marked) >= MAX_MARKED:
            return False
        self.marked[kept.order] = kept
        return True

    def _board(self, whole: Board | None = None) -> Board:
        board = Board(self._format_of, self._profile_for, kept=self._kept, whole=whole)
        if not self._guesses:
            board.guesses = None
        return board

    def _add_filtered(self, board: Board, kept: KeptRecord) -> None:
        """Add a record to the filter's board if it passes the filter.

        A filter is for transactions only, so an event changes the figures but is not listed.
        """
        if isinstance(kept.record, WireEvent):
            board.add(kept, listed=False)
        elif self.wanted is not None and self.wanted(kept.record):
            board.add(kept)
        else:
            board.account.left_out += 1


def _numbered(records: Iterable[Record]) -> Iterator[KeptRecord]:
    """Yield records, from the first one of the capture on, with their numbers."""
    number = 0
    for order, record in enumerate(records, 1):
        is_event = isinstance(record, WireEvent)
        number += not is_event
        yield kept_record(order, None if is_event else number, record)
