"""Checks captures and logs against the rules of the standard and of manuals."""

# A log is not decoded again: its transactions and events contain facts about connections and damage
# that only the live sources knew. But its transactions are named again, with the profiles of the
# user and of the log, so that the rules in the present profiles apply. Each capture is checked
# separately; the files of a rotated capture are checked as one.
#
# With --start and --end, only the transactions and events in that time are checked. From the time
# before, the rules only learn which connections were opened and closed.

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import EventKind, InputError, SerialFormat, UsageError, WireEvent
from mbtool.core.limits import MODBUS_PORT
from mbtool.devices import NamedTransaction, Namer, Profile, builtin_profiles, load_profile
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.finding import Finding, event_finding
from mbtool.devices.checking.rules import RULES, Severity
from mbtool.devices.checking.security_limits import SecurityLimits
from mbtool.devices.profile_checks import finding_prefix
from mbtool.ledger.account import Account
from mbtool.ledger.request_tally import merged
from mbtool.logs.rotation import with_parts
from mbtool.modbus import Outcome
from mbtool.sources.files import STANDARD_INPUT
from mbtool.troubles.judge import Judge, Judgement
from mbtool.troubles.words import WORDS
from mbtool.workflows.shared.log_records import profiles_of_logs
from mbtool.workflows.shared.model_hints import ModelHints
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.shared.reading_choice import column_reading
from mbtool.workflows.shared.time_window import TimeWindow
from mbtool.workflows.shared.unreadable_lines import UnreadableLines

if TYPE_CHECKING:
    from mbtool.columns.quiet_rows import BlockRows
    from mbtool.decode.decoder import Record
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.query.where import Where

_CONNECTIONS = frozenset((EventKind.OPENED, EventKind.CLOSED))


@dataclass(frozen=True, slots=True)
class CodeFilter:
    """Chooses findings by their codes: those that begin with a text in `select`, but not with one
    in `ignore`.

    If a code begins with a text of both, the longer text decides. If both are equally long, the
    finding is ignored.
    """

    select: tuple[str, ...] = ()
    """The beginnings of the codes to choose, such as `RTU-1`; if it is empty, all codes are
    chosen."""
    ignore: tuple[str, ...] = ()

    @property
    def leaves_out_codes(self) -> bool:
        """True if some codes are left out."""
        return bool(self.select or self.ignore)

    @classmethod
    def parse(cls, select: Sequence[str], ignore: Sequence[str]) -> CodeFilter:
        """Make a filter from the values of --select and --ignore.

        Each value is one or more beginnings of codes, separated by commas, in upper or lower case:
        `RTU-1,MB`.
        """
        return cls(_codes(select), _codes(ignore))

    def takes(self, code: str) -> bool:
        chosen = _longest(code, self.select) if self.select else 0
        return chosen is not None and chosen > (_longest(code, self.ignore) or -1)

    def demand_known(self, profiles: Sequence[Profile]) -> None:
        """Raise UsageError if no code begins with some text of the filter, or if all that is
        selected is ignored. The known codes are those of the standard's rules and of the rules in
        `profiles`.
        """
        if self.select and not any(map(self.takes, self.select)):
            raise UsageError(
                f"--ignore {','.join(self.ignore)} leaves out all that --select chooses"
            )
        prefixes = {f"{finding_prefix(profile)}-" for profile in profiles}
        letters = [rule.code for rule in RULES.values() if rule.is_of_devices]
        codes = [rule.code for rule in RULES.values() if not rule.is_of_devices]
        codes += WORDS
        # The codes of rules in profiles cannot all be listed. They consist of the profile's prefix,
        # a letter for the kind of rule, and then for example a function code.
        of_devices = tuple(f"{prefix}{letter}" for prefix in prefixes for letter in letters)
        for text in (*self.select, *self.ignore):
            is_known = any(each.startswith(text) for each in (*codes, *prefixes))
            if not is_known and not text.startswith(of_devices):
                families = {code.partition("-")[0] for code in codes}
                families |= {prefix.removesuffix("-") for prefix in prefixes}
                raise UsageError(
                    f"no code begins with {text!r}; they begin with {', '.join(sorted(families))}, "
                    "for example RTU-1 or FT1A-Q16"
                )


@dataclass(frozen=True, slots=True)
class FileFinding:
    """A finding, and the name of the file in which it was found."""

    finding: Finding
    file: str


class CheckedRecord(NamedTuple):
    """A transaction or event, with the findings that the rules reported when it was passed
    to them.
    """

    record: Record | None
    """The transaction or event as it was read. None at the end of a capture, when findings about
    the whole capture come, and for a record outside of the time that is checked."""
    named: Record | None
    """The same as `record`, None included; but a transaction of a log has names from the profiles
    in use now."""
    findings: list[FileFinding]
    rows: BlockRows | None = None
    """Many answered reads that were checked together, instead of a record; otherwise None."""
    poll: PollStatistics | None = None
    """The poll that the transaction belongs to, in the account; None if it has none."""
    damaged_ns: int | None = None
    """The time (UTC ns) of the damaged response to the transaction; None if it had none."""

    @property
    def row_count(self) -> int:
        """The number of its transactions, for a progress bar."""
        return 1 if self.rows is None else len(self.rows)


NOTHING = CheckedRecord(None, None, [])


class CheckRun:
    """Reads files once, checks their content against the rules, and counts the findings."""

    def __init__(
        self,
        paths: Sequence[str],
        options: ReadingOptions,
        codes: CodeFilter | None = None,
        limits: SecurityLimits | None = None,
        window: TimeWindow | None = None,
        *,
        wanted: Where | None = None,
        on_retry: Callable[[PollStatistics, int, int], None] | None = None,
        observes: bool = False,
    ) -> None:
        """Prepare to read. `codes` chooses the findings, `limits` are those of attacks and scans,
        `window` the time that is checked.

        `wanted` returns True for the transactions to count, and to report findings of; None for
        all. `on_retry` and `observes` are those of Account.
        """
        self._wanted = wanted
        self._codes = codes or CodeFilter()
        self._limits = limits or SecurityLimits()
        self._window = window or TimeWindow(None, None)
        self._paths = paths = with_parts(paths)
        self._options = options
        self._line = options.line
        self._columns = column_reading(paths, options) if wanted is None else None
        self.reading: Reading = self._columns or Reading(paths, options)
        self._ports: frozenset[int] | None = None
        if options.any_port:
            self._ports = frozenset((*options.ports, *options.rtu_ports, MODBUS_PORT))
        self.ledger = Account(self._format_of, on_retry, observes=observes)
        """The account of all files."""
        self._judge = Judge(
            self.ledger,
            CaptureContext(
                self.reading.assignments,
                self._format_of,
                lambda link: self.reading.exact_times.is_exact(link),
                self._ports,
                self._limits,
            ),
        )
        self._judged: Judgement | None = None
        """What `judgement` returned last."""
        self._is_open = False
        """True between the first and the last record of a capture."""
        self._lines: UnreadableLines | None = None
        """Finds the serial lines in the current capture whose bytes are mostly unreadable; None
        outside of a capture."""
        self._namer: Namer | None = None
        """Gives the transactions of a log names from the profiles in use now; None if no log is
        read."""
        self._formats: dict[str, SerialFormat] = {}
        """The baud rate and character format of each serial line in the current capture, by link
        name."""
        self._captures = 0
        self._file = ""
        self.problem: str | None = None
        """The error that ended the reading before the end of the files; None if there was none."""
        self._hints = ModelHints(self.reading.profile_for)
        self.counts: Counter[str] = Counter()
        """By code, the number of findings that the filter has chosen."""

    def demand_codes(self) -> None:
        """Raise UsageError if no code begins with some text of the filter.

        The codes are those of the standard's rules, of built-in profiles, of the user's profiles,
        and of profiles in the logs.
        """
        known = [*map(load_profile, builtin_profiles()), *self.reading.assignments.profiles]
        try:
            self._codes.demand_known(known)
        except UsageError:
            self._codes.demand_known([*known, *profiles_of_logs(self._paths, self._line)])

    @property
    def transactions(self) -> int:
        """The number of transactions that were checked."""
        return self.ledger.transactions + self.ledger.left_out

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about the files, for example about cut packets. Findings are not among
        them.
        """
        outside = self._window.why_empty
        remarks = [*self.reading.remarks, *self._judge.remarks, *self._hints.remarks]
        return remarks if outside is None else [*remarks, outside]

    @property
    def is_outside(self) -> bool:
        """True if the files have transactions, but none in the time between --start and --end."""
        return self._window.why_empty is not None

    def learn(self, baseline: Sequence[str], watch: Watch = unwatched) -> list[str]:
        """Read the captures of a baseline, by which values are judged; return lines for the user.

        Raises InputError if they cannot be read, or have no transaction.
        """
        norm = CheckRun(baseline, self._options)
        norm.reading.demand_files()
        norm._judge.become_norm()
        remarks = []
        try:
            for _ in norm.findings(watch):
                pass
        except InputError as error:
            remarks = [f"{error}; compared with what is there"]
        if not norm.transactions:
            raise InputError(f"{', '.join(baseline)}: no transaction in it to compare with")
        self._judge.judge_by(norm._judge)
        return [f"baseline: {one}" for one in (*norm.reading.remarks, *remarks)]

    @property
    def norm_remark(self) -> str | None:
        """A sentence for the user if the baseline could not be used; None if it was used, or if
        there is no baseline.
        """
        return self._judge.norm_remark

    def findings(self, watch: Watch = unwatched) -> Iterator[FileFinding]:
        """Yield the findings that the filter chooses, capture by capture.

        `watch` passes on the records as they are read, and may show the progress. Raises InputError
        for a file that cannot be read, and, after all findings, for a file that is cut or damaged.
        """
        for one in self._checked(watch(self.reading, self._parts())):
            yield from one.findings

    def checked(self) -> Iterator[CheckedRecord]:
        """Yield each transaction or event with its findings, and at the end of each capture the
        findings about the whole capture.

        Many answered reads without a finding of their own may come together as one CheckedRecord.

        Raises InputError for a file that cannot be read, and, after all findings, for a file that
        is cut or damaged.
        """
        return self._checked(self._parts())

    def _parts(self) -> Iterator[Record | BlockRows]:
        columns = self._columns if self._window.is_whole else None
        return self.reading.records() if columns is None else columns.quiet_parts()

    def _checked(self, parts: Iterable[Record | BlockRows]) -> Iterator[CheckedRecord]:
        try:
            self._find_first_request()
            for part in parts:
                if not self._is_open or self.reading.captures != self._captures:
                    yield CheckedRecord(None, None, list(self._end_capture()))
                    self._begin_capture()
                self._file = self.reading.file
                if isinstance(part, WireEvent | NamedTransaction):
                    yield self._check(part)
                else:
                    yield from self._check_rows(part)
        except InputError as error:
            self.problem = str(error)
            yield CheckedRecord(None, None, list(self._end_capture()))
            self.ledger.settle()
            raise
        yield CheckedRecord(None, None, list(self._end_capture()))
        self.ledger.settle()

    def _find_first_request(self) -> None:
        """Read the files up to the first request, if --start or --end count from it."""
        if not self._window.is_relative:
            return
        if STANDARD_INPUT in self._paths:
            raise UsageError(
                "--start and --end of standard input: give dates, such as 2026-11-22T09:14, "
                "as it cannot be read twice"
            )
        next(self._window.begun(Reading(self._paths, self._options).records()), None)

    def _begin_capture(self) -> None:
        reading = self.reading
        self._captures = reading.captures
        self._formats = {}
        self._lines = UnreadableLines(lambda link: reading.line_of(link))
        self._namer = Namer(reading.assignments) if reading.is_log else None
        self._is_open = True
        self._judge.begin_capture(
            CaptureContext(
                reading.assignments,
                self._format_of,
                reading.exact_times.is_exact,
                self._ports,
                self._limits,
            )
        )

    def _end_capture(self) -> Iterator[FileFinding]:
        lines, self._lines = self._lines, None
        if lines is not None:
            unreadable = lines.unreadable()
            yield from self._chosen(event_finding("RTU-204", *each) for each in unreadable)
        self._is_open = False
        yield from self._chosen(self._judge.end_capture())

    def _check_rows(self, rows: BlockRows) -> Iterator[CheckedRecord]:
        for some, found in self._judge.check_rows(rows):
            findings = list(self._chosen(found))
            if isinstance(some, NamedTransaction | WireEvent):
                yield CheckedRecord(some, some, findings, poll=self._judge.count(some))
            else:
                self._judge.count_run(some.run, some.reads)
                yield CheckedRecord(None, None, findings, some)

    def _check(self, record: Record) -> CheckedRecord:
        if self._lines is None:
            return NOTHING
        if record not in self._window:
            # Rules about connections need to know which are open when the checked time begins.
            if isinstance(record, WireEvent) and record.kind in _CONNECTIONS:
                for _ in self._judge.check(record):
                    pass
            return NOTHING
        self._lines.note(record)
        named = record
        is_wanted = True
        if not isinstance(record, WireEvent):
            is_wanted = self._wanted is None or self._wanted(record)
            self._hints.note(record)
            if self._namer is not None:
                named = self._namer.name(record)
        poll = self._judge.count(named, is_wanted=is_wanted)
        found = list(self._judge.check(named))
        chosen = list(self._chosen(found if is_wanted else ()))
        damaged_ns = None if poll is None else self.ledger.damaged_ns
        return CheckedRecord(record, named, chosen, poll=poll, damaged_ns=damaged_ns)

    def _format_of(self, link: str) -> SerialFormat | None:
        """Return the baud rate and character format of a line in the current capture; None if they
        are not known yet.

        Once known, they are cached, as the rules ask for them for each transaction.
        """
        format_ = self._formats.get(link)
        if format_ is None:
            format_ = self.reading.format_of(link)
            if format_ is not None:
                self._formats[link] = format_
        return format_

    def failed_requests(self) -> dict[str, int]:
        """Return how many requests got no good answer, whether they break a rule or not: by the
        names that the JSON of `stats` has for them.
        """
        polls = (poll.tally for poll in self.ledger.polls.values())
        tally = merged([*polls, *(one.tally for one in self.ledger.uses.values())])
        return {
            "late": tally.count(Outcome.LATE),
            "no_answer": tally.unanswered,
            "wrong_crc": tally.damaged,
            "exception": tally.count(Outcome.EXCEPTION),
            "malformed": tally.count(Outcome.MALFORMED),
        }

    @property
    def is_anything_wrong(self) -> bool:
        """True if there are findings, or troubles that are more than a note."""
        if self.counts:
            return True
        return any(one.severity is not Severity.NOTE for one in self.judgement().troubles)

    def judgement(self) -> Judgement:
        """Judge what was read so far: the troubles whose codes the filter chooses."""
        if self._judged is None or self._is_open:
            found = self._judge.judgement()
            chosen = [one for one in found.troubles if self._codes.takes(one.code)]
            self._judged = replace(found, troubles=chosen, is_chosen=self._codes.leaves_out_codes)
        return self._judged

    def _chosen(self, findings: Iterable[Finding]) -> Iterator[FileFinding]:
        for finding in findings:
            if self._codes.takes(finding.code) and not self._window.is_before_ns(finding.ts_ns):
                self.counts[finding.code] += finding.count
                # A log names the file that it was made of; the user knows the log.
                file = self._file if self.reading.is_log else finding.file or self._file
                self._judge.note(finding, file if len(self._paths) > 1 else "")
                yield FileFinding(finding, file)


def _codes(texts: Sequence[str]) -> tuple[str, ...]:
    return tuple(code.strip().upper() for text in texts for code in text.split(",") if code.strip())


def _longest(code: str, beginnings: Sequence[str]) -> int | None:
    """The length of the longest text in `beginnings` with which `code` begins; None if there is no
    such text.
    """
    return max((len(each) for each in beginnings if code.startswith(each)), default=None)
