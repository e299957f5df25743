"""Checks captures and logs against the rules: files in, findings out."""

# A log is not decoded again: its transactions and events hold facts about connections and damage
# that only the live sources knew. But its transactions get their names again, from the profiles of
# the user and of the log, so that the rules of today's profiles apply. Each capture is checked
# separately; the files of a rotated capture are checked as one.
#
# Of a part of the files (a window of time), the transactions and events in it are checked as if
# there were no others, but for the connections that were opened before.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import EventKind, InputError, UsageError, WireEvent
from mbtool.core.link_spec import MODBUS_PORT
from mbtool.devices import NamedTransaction, Namer, builtin_profiles, load_profile
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.checker import Checker
from mbtool.devices.checking.finding import Finding, event_finding
from mbtool.devices.checking.rules import RULES
from mbtool.devices.checking.security_limits import SecurityLimits
from mbtool.devices.profile_checks import finding_prefix
from mbtool.sources.files import STANDARD_INPUT
from mbtool.workflows.shared.log_records import profiles_of_logs
from mbtool.workflows.shared.model_hints import ModelHints
from mbtool.workflows.shared.read_all import unwatched
from mbtool.workflows.shared.reading import Reading
from mbtool.workflows.shared.reading_choice import column_reading
from mbtool.workflows.shared.time_window import TimeWindow
from mbtool.workflows.shared.unreadable_lines import UnreadableLines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from mbtool.core import SerialFormat
    from mbtool.decode.decoder import Record
    from mbtool.devices import Profile
    from mbtool.devices.checking.quiet_run import QuietRows
    from mbtool.workflows.shared.reading import ReadingOptions

    WatchRows = Callable[[Reading, Iterator[Record | QuietRows]], Iterator[Record | QuietRows]]

LARGE = 1_000_000
"""A capture file of at least so many bytes is read as arrays, if it can be; for a smaller one their
library would take longer to load."""
_CONNECTIONS = frozenset((EventKind.OPENED, EventKind.CLOSED))


@dataclass(frozen=True, slots=True)
class CodeFilter:
    """Chooses finding codes that begin with a text of `select`, but not with one of `ignore`.

    If a code begins with a text of each, the longer text decides. If both are equally long, the
    code is ignored.
    """

    select: tuple[str, ...] = ()
    """If empty, all codes are chosen."""
    ignore: tuple[str, ...] = ()

    @classmethod
    def parse(cls, select: Sequence[str], ignore: Sequence[str]) -> CodeFilter:
        """Read the texts of the two options, such as `RTU-1,MB`, in upper or lower case."""
        return cls(_codes(select), _codes(ignore))

    def takes(self, code: str) -> bool:
        chosen = _longest(code, self.select) if self.select else 0
        return chosen is not None and chosen > (_longest(code, self.ignore) or -1)

    def demand_known(self, profiles: Sequence[Profile]) -> None:
        """Raise UsageError if a text of the filter is not the beginning of any code."""
        prefixes = {f"{finding_prefix(profile)}-" for profile in profiles}
        letters = [rule.code for rule in RULES.values() if rule.is_of_devices]
        codes = [rule.code for rule in RULES.values() if not rule.is_of_devices]
        # Not all codes of devices can be listed: behind the prefix of the profile and the letter of
        # the kind of rule is, for example, a function code.
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
    """A finding, and the file that it was found in."""

    finding: Finding
    file: str


class CheckedRecord(NamedTuple):
    """A record, and what was found when it was checked."""

    record: Record | None
    """As it was read; None at the end of a capture, which has findings of its own, and for a
    record outside of the window."""
    named: Record | None
    """The same with the names of today's profiles."""
    findings: list[FileFinding]


NOTHING = CheckedRecord(None, None, [])


class CheckRun:
    """One pass over some files: checks them and counts the findings."""

    def __init__(
        self,
        paths: Sequence[str],
        options: ReadingOptions,
        codes: CodeFilter | None = None,
        limits: SecurityLimits | None = None,
        window: TimeWindow | None = None,
    ) -> None:
        self._codes = codes or CodeFilter()
        self._limits = limits or SecurityLimits()
        self._window = window or TimeWindow(None, None)
        self._paths = paths
        self._options = options
        self._line = options.line
        self._columns = column_reading(paths, options, at_least=LARGE)
        self.reading: Reading = self._columns or Reading(paths, options)
        self._ports: frozenset[int] | None = None
        if options.any_port:
            self._ports = frozenset((*options.ports, *options.rtu_ports, MODBUS_PORT))
        self._checker: Checker | None = None
        """Checks the rules in the capture that is being read."""
        self._lines: UnreadableLines | None = None
        """Finds the serial lines in this capture that cannot be read."""
        self._namer: Namer | None = None
        """Names the transactions of a log by today's profiles; None while no log is read."""
        self._formats: dict[str, SerialFormat] = {}
        """The settings of serial lines in the capture that is being read."""
        self._captures = 0
        self._file = ""
        self._remarks: list[str] = []
        self._hints = ModelHints(self.reading.profile_for)
        self.transactions = 0
        self.counts: Counter[str] = Counter()
        """Number of findings of each chosen code."""

    def demand_codes(self) -> None:
        """Raise UsageError if no code begins with a text of the filter.

        Codes are those of the standard's rules, of built-in profiles, of profiles that the user
        gives, and of profiles in the logs.
        """
        known = [*map(load_profile, builtin_profiles()), *self.reading.assignments.profiles]
        try:
            self._codes.demand_known(known)
        except UsageError:
            self._codes.demand_known([*known, *profiles_of_logs(self._paths, self._line)])

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about the files, beside the findings."""
        outside = self._window.why_empty
        remarks = [*self.reading.remarks, *self._remarks, *self._hints.remarks]
        return remarks if outside is None else [*remarks, outside]

    @property
    def is_outside(self) -> bool:
        """True if the files have transactions, but none in the window."""
        return self._window.why_empty is not None

    def findings(self, watch: WatchRows = unwatched) -> Iterator[FileFinding]:
        """Yield the findings with chosen codes, capture by capture.

        `watch` may show how much has been read. Raises InputError for a file that cannot be read;
        for a file that is cut or damaged, after all findings.
        """
        columns = self._columns if self._window.is_whole else None
        parts = self.reading.records() if columns is None else columns.quiet_parts()
        for _, _, found in self._checked(watch(self.reading, parts)):
            yield from found

    def checked(self) -> Iterator[CheckedRecord]:
        """Yield each record with its findings, and then those of the whole capture.

        Raises InputError as `findings` does.
        """
        return self._checked(self.reading.records())

    def _checked(self, parts: Iterable[Record | QuietRows]) -> Iterator[CheckedRecord]:
        try:
            self._find_first_request()
            for part in parts:
                if self._checker is None or self.reading.captures != self._captures:
                    yield CheckedRecord(None, None, list(self._end_capture()))
                    self._begin_capture()
                self._file = self.reading.file
                yield self._check(part)
        except InputError:
            yield CheckedRecord(None, None, list(self._end_capture()))
            raise
        yield CheckedRecord(None, None, list(self._end_capture()))

    def _find_first_request(self) -> None:
        """Read the beginning of the files if the window counts from their first request."""
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
        self._checker = Checker(
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
        checker, self._checker = self._checker, None
        if checker is not None:
            yield from self._chosen(checker.close())
            self._remarks += checker.remarks

    def _check(self, record: Record | QuietRows) -> CheckedRecord:
        if self._checker is None or self._lines is None:
            return NOTHING
        if not isinstance(record, WireEvent | NamedTransaction):
            self.transactions += len(record)
            return CheckedRecord(None, None, list(self._chosen(self._checker.feed_rows(record))))
        if record not in self._window:
            # Rules about connections need to know which are open when the window begins.
            if isinstance(record, WireEvent) and record.kind in _CONNECTIONS:
                for _ in self._checker.feed(record):
                    pass
            return NOTHING
        self._lines.note(record)
        named = record
        if not isinstance(record, WireEvent):
            self.transactions += 1
            self._hints.note(record)
            if self._namer is not None:
                named = self._namer.name(record)
        return CheckedRecord(record, named, list(self._chosen(self._checker.feed(named))))

    def _format_of(self, link: str) -> SerialFormat | None:
        """The settings of a line in this capture, kept since they are asked for each transaction.

        A line that is not known yet may be known later.
        """
        format_ = self._formats.get(link)
        if format_ is None:
            format_ = self.reading.format_of(link)
            if format_ is not None:
                self._formats[link] = format_
        return format_

    def _chosen(self, findings: Iterator[Finding]) -> Iterator[FileFinding]:
        for finding in findings:
            if self._codes.takes(finding.code) and not self._window.is_before_ns(finding.ts_ns):
                self.counts[finding.code] += finding.count
                yield FileFinding(finding, self._file)


def _codes(texts: Sequence[str]) -> tuple[str, ...]:
    return tuple(code.strip().upper() for text in texts for code in text.split(",") if code.strip())


def _longest(code: str, beginnings: Sequence[str]) -> int | None:
    """The length of the longest text in `beginnings` that the code begins with; None if none."""
    return max((len(each) for each in beginnings if code.startswith(each)), default=None)
