"""Makes the HTML page of `mbtool report` from captures, which are read once."""

# The page has the figures of `stats`, the rows of `inventory` and the findings of `check`. The
# classes of these commands compute them from a single reading of the files. For the comparison of
# `diff`, both captures are read once more, because it needs all traffic of both at once.

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from mbtool.core import EventKind, InputError, WireEvent
from mbtool.devices import NamedTransaction, builtin_profiles, load_profile
from mbtool.ledger.advice import advice_of
from mbtool.ledger.identification import identify
from mbtool.ledger.inventory import inventory
from mbtool.ledger.statistics_report import is_counted_together
from mbtool.ledger.unit_account import UnitKey
from mbtool.ports.clock import now_ns
from mbtool.sources.files import shown_name
from mbtool.sources.makers import maker
from mbtool.troubles.broken_rules import Summaries
from mbtool.troubles.polling import late_units
from mbtool.values.guessed_series import with_guesses
from mbtool.values.values import Values
from mbtool.version import __version__
from mbtool.views.report.contents import (
    ComparisonWith,
    FileOrigin,
    ReportContents,
    ReportWords,
    encoded,
    report_document,
)
from mbtool.views.report.page import page
from mbtool.views.report.transaction_rows import TransactionRows
from mbtool.views.statistics_summary import TOGETHER_TEXT
from mbtool.workflows.check import CheckedRecord, CheckRun, CodeFilter
from mbtool.workflows.diff import DiffOptions, compare
from mbtool.workflows.shared.read_all import Watch, unwatched

if TYPE_CHECKING:
    from mbtool.columns.quiet_rows import BlockRows
    from mbtool.devices.checking.finding import Finding
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.query.where import Where
    from mbtool.workflows.shared.reading import ReadingOptions
    from mbtool.workflows.shared.time_window import TimeWindow


NO_WORDS = ReportWords()
_LACKING = frozenset((EventKind.GAP, EventKind.DISCARDED, EventKind.CUT, EventKind.UNREADABLE))
MAX_LACKING = 200
"""The page lists at most this many events about missing or unreadable data."""


class ReportRun:
    """Reads files once, and makes the HTML page about them."""

    def __init__(
        self,
        files: Sequence[str],
        options: ReadingOptions,
        codes: CodeFilter | None = None,
        window: TimeWindow | None = None,
        *,
        wanted: Where | None = None,
        words: ReportWords = NO_WORDS,
        everything: bool = False,
    ) -> None:
        """Prepare to read. `codes` chooses the findings that the page has, and `window` the part of
        the captures; None for all.

        `wanted` returns True for the transactions that the page is about, None for all; `words` are
        the user's own. With `everything`, the page has all transactions, however large it
        becomes; otherwise only as many as TransactionRows keeps.
        """
        self._files = files
        self._options = options
        self._wanted = wanted
        self._words = words
        self._check = CheckRun(
            files,
            options,
            codes,
            window=window,
            wanted=wanted,
            on_retry=self._mark_retry,
            observes=True,
        )
        self.reading = self._check.reading
        self.account = self._check.ledger
        self._values = Values()
        self.guesses = True
        """True to show registers that are surely one number as that number."""
        self._rows = TransactionRows(everything=everything)
        self._findings = Summaries()
        self._number_of_findings = 0
        self._lacking: list[WireEvent] = []
        self._number_lacking = 0
        self._captures = 0
        self.error: InputError | None = None
        """The error of a file that could be read only in part; None if all files were read to their
        ends."""

    def demand_codes(self) -> None:
        """Raise UsageError if no code of a rule begins with some text of the filter `codes`."""
        self._check.demand_codes()

    def read(self, watch: Watch = unwatched) -> None:
        """Read the files as far as they can be read.

        `watch` passes on the records as they are read, and may show the progress. Raises InputError
        if an error comes before the first transaction.
        """
        try:
            for one in watch(self.reading, self._check.checked()):
                self._add(one)
        except InputError as error:
            if not self.account.transactions:
                raise
            self.error = error

    def page(
        self, against: str | None = None, on_remark: Callable[[str], None] = lambda _: None
    ) -> str:
        """Return the page as HTML. If `against` is not None, the page has a comparison with that
        older capture.

        `on_remark` gets lines for the user about the compared files. Raises InputError if the
        capture `against` cannot be read.
        """
        comparison = None if against is None else self._compared(against, on_remark)
        if self.guesses:
            self._values.series = with_guesses(self._values.series, self._values.requests)
        return page(encoded(report_document(self._contents(comparison))))

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about the files, for example about cut packets, or why they have no
        transaction.
        """
        why_empty = self.reading.why_empty
        return [*self._check.remarks, *([] if why_empty is None else [why_empty])]

    def _add(self, one: CheckedRecord) -> None:
        record, named = one.record, one.named
        findings = [found.finding for found in one.findings]
        for found in one.findings:
            self._number_of_findings += found.finding.count
            self._findings.add(found.finding, found.file if len(self._files) > 1 else "")
        if record is not None and named is not None:
            self._note_capture()
            if isinstance(record, WireEvent) or isinstance(named, WireEvent):
                self._note_event(record)
            elif self._wanted is not None and not self._wanted(record):
                return
            else:
                self._values.add(named)
                self._rows.add(named, _codes_of(named, findings), one.damaged_ns)
            if one.poll is not None and not isinstance(named, WireEvent):
                self._rows.pauses.note(one.poll.key, self._rows.transactions, named)
        if one.rows is not None:
            self._note_capture()
            self._add_rows(one.rows)
        for finding in findings:
            self._rows.add_finding(finding)

    def _add_rows(self, rows: BlockRows) -> None:
        """Take answered reads and writes without findings together."""
        self._values.add_reads(rows.reads)
        self._rows.pauses.note_run(rows.run, self._rows.transactions, rows.chosen)
        self._rows.add_run(rows.run, rows.chosen)

    def _note_capture(self) -> None:
        if self.reading.captures != self._captures:
            self._captures = self.reading.captures
            self._rows.pauses.begin_capture()

    def _note_event(self, record: object) -> None:
        if not isinstance(record, WireEvent):
            return
        if record.kind in _LACKING:
            self._number_lacking += 1
            if len(self._lacking) < MAX_LACKING:
                self._lacking.append(record)

    def _contents(self, comparison: ComparisonWith | None) -> ReportContents:
        profiles = {one.name: one for one in map(load_profile, builtin_profiles())}
        profiles |= {one.name: one for one in self.reading.assignments.profiles}
        names = [*map(shown_name, self._files)]
        judgement = self._check.judgement()
        links = judgement.links
        late = late_units(poll.poll for link in links for poll in link.polls)
        return ReportContents(
            version=__version__,
            made_ns=now_ns(),
            sources=names,
            account=self.account,
            judgement=judgement,
            late_ns={UnitKey(*one.unit): one.late_ns for one in late},
            inventory=inventory(
                self.account,
                names,
                partial(identify, profiles=list(profiles.values())),
                maker,
                profiles,
            ),
            findings=self._findings,
            number_of_findings=self._number_of_findings,
            values=self._values,
            rows=self._rows,
            origins=[self._origin(file) for file in names],
            remarks=[
                *self.remarks,
                *([TOGETHER_TEXT] if is_counted_together(links) else []),
                *([] if self.error is None else [str(self.error)]),
            ],
            lacking=self._lacking,
            number_lacking=self._number_lacking,
            comparison=comparison,
            words=self._words,
            advice=advice_of(links, lambda name: self.account.links[name].format, profiles.get),
        )

    def _origin(self, file: str) -> FileOrigin:
        head = self.reading.results.heads.get(file)
        if head is None:
            return FileOrigin(file)
        return FileOrigin(file, head.capture, head.links, head.devices)

    def _compared(self, other: str, on_remark: Callable[[str], None]) -> ComparisonWith:
        options = DiffOptions(reading=self._options)
        found = compare(other, self._files[0], options, on_remark)
        return ComparisonWith(
            other, found.b_transactions, found.a_transactions, found.is_whole, found.differences
        )

    def _mark_retry(self, poll: PollStatistics, at_ns: int, number: int) -> None:
        self._rows.mark_retry(poll.use.unit.key, at_ns, number)


def _codes_of(one: NamedTransaction, findings: list[Finding]) -> list[str]:
    """Return the codes of those `findings` that are about the transaction `one`.

    The others are about earlier transactions: a rule may need a later transaction to find them.
    """
    return [
        finding.code
        for finding in findings
        if (finding.link, finding.unit, finding.ts_ns) == (one.link, one.unit, one.start_ns)
    ]
