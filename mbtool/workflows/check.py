"""Holds captures and logs against the rules: paths in, findings out."""

# A log is taken as it was decoded when it was made, since only that has what its sources told of
# connections and damage. Its transactions are named anew, by the profiles that the user gives and
# those that it carries, so that it is held against today's rules. Each capture is held against them
# by itself; the parts of a rotated one are one.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import InputError, UsageError, WireEvent
from mbtool.core.link_spec import MODBUS_PORT
from mbtool.devices import Namer, builtin_profiles, load_profile
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.checker import Checker
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.rules import RULES
from mbtool.devices.profile_checks import finding_prefix
from mbtool.workflows.shared.model_hints import ModelHints
from mbtool.workflows.shared.reading import Reading

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.core import SerialFormat
    from mbtool.decode.decoder import Record
    from mbtool.devices import Profile
    from mbtool.workflows.shared.reading import ReadingOptions


@dataclass(frozen=True, slots=True)
class Selection:
    """Which codes are wanted: those that begin with one of `select`, and with none of `ignore`.

    Where both fit a code, the longer one counts.
    """

    select: tuple[str, ...] = ()
    """All, where there are none."""
    ignore: tuple[str, ...] = ()

    @classmethod
    def parse(cls, select: Sequence[str], ignore: Sequence[str]) -> Selection:
        """Read `RTU-1,MB` and the like, in any case."""
        return cls(_codes(select), _codes(ignore))

    def takes(self, code: str) -> bool:
        wanted = _longest(code, self.select) if self.select else 0
        return wanted is not None and wanted > (_longest(code, self.ignore) or -1)

    def demand_known(self, profiles: Sequence[Profile]) -> None:
        """See that each beginning is one of some code. Raises UsageError."""
        prefixes = {f"{finding_prefix(profile)}-" for profile in profiles}
        letters = [rule.code for rule in RULES.values() if rule.is_of_devices]
        codes = [rule.code for rule in RULES.values() if not rule.is_of_devices]
        for text in (*self.select, *self.ignore):
            is_known = any(code.startswith(text) for code in codes) or any(
                prefix.startswith(text)
                or any(text.startswith(f"{prefix}{letter}") for letter in letters)
                for prefix in prefixes
            )
            if not is_known:
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
    place: str


class Checking:
    """One pass over some files."""

    def __init__(
        self, paths: Sequence[str], options: ReadingOptions, selection: Selection | None = None
    ) -> None:
        self._selection = selection or Selection()
        self.reading = Reading(paths, options)
        self._ports: frozenset[int] | None = None
        if options.any_port:
            self._ports = frozenset((*options.ports, *options.rtu_ports, MODBUS_PORT))
        self._checker: Checker | None = None
        """Of the capture that is being read."""
        self._namer: Namer | None = None
        """Names what stands in a log anew."""
        self._captures = 0
        self._place = ""
        self._remarks: list[str] = []
        self._hints = ModelHints(lambda one: self.reading.assignments.profile_for(one))
        self.transactions = 0
        self.counts: Counter[str] = Counter()
        """How often each code was found, of those that are wanted."""

    def demand_selection(self) -> None:
        """See that the codes that are wanted exist. Raises UsageError.

        They do, where a built-in profile, one that the user gives or one of a log has them.
        """
        known = [*map(load_profile, builtin_profiles()), *self.reading.assignments.profiles]
        try:
            self._selection.demand_known(known)
        except UsageError:
            self._selection.demand_known([*known, *self.reading.profiles_of_logs()])

    @property
    def remarks(self) -> list[str]:
        """What a reader should know beside the findings, a line each."""
        return [*self.reading.remarks, *self._remarks, *self._hints.remarks]

    def findings(self) -> Iterator[FileFinding]:
        """Give everything that is found, capture by capture. Raises what Reading.records does."""
        try:
            for record in self.reading.records():
                if self._checker is None or self.reading.captures != self._captures:
                    yield from self._end_capture()
                    self._begin_capture()
                self._place = self.reading.place
                yield from self._check(record)
        except InputError:
            yield from self._end_capture()
            raise
        yield from self._end_capture()

    def _begin_capture(self) -> None:
        reading = self.reading
        self._captures = reading.captures
        self._namer = Namer(reading.assignments) if reading.is_log else None
        self._checker = Checker(CaptureContext(reading.assignments, self._format_of, self._ports))

    def _end_capture(self) -> Iterator[FileFinding]:
        checker, self._checker = self._checker, None
        if checker is not None:
            yield from self._wanted(checker.close())
            self._remarks += checker.remarks

    def _check(self, record: Record) -> Iterator[FileFinding]:
        if self._checker is None:
            return
        if not isinstance(record, WireEvent):
            self.transactions += 1
            self._hints.note(record)
            if self._namer is not None:
                record = self._namer.name(record)
        yield from self._wanted(self._checker.feed(record))

    def _format_of(self, link: str) -> SerialFormat | None:
        return self.reading.format_of(link)

    def _wanted(self, findings: Iterator[Finding]) -> Iterator[FileFinding]:
        for finding in findings:
            if self._selection.takes(finding.code):
                self.counts[finding.code] += finding.count
                yield FileFinding(finding, self._place)


def _codes(texts: Sequence[str]) -> tuple[str, ...]:
    return tuple(code.strip().upper() for text in texts for code in text.split(",") if code.strip())


def _longest(code: str, beginnings: Sequence[str]) -> int | None:
    fitting = [len(each) for each in beginnings if code.startswith(each)]
    return max(fitting, default=None)
