"""Prints findings (broken rules): a summary for each rule and place, or every finding on a line."""

# A master that repeats a mistake in every poll breaks the same rule many times. So the summary has
# one entry for each rule code and place: the number of cases, and the first and the last of them.
#
#     FT1A-Q16  error  812 times  rs485 unit 1, idec-ft1a-touch
#         first 2026-11-21 09:14:03.300: write registers HR400001..400110: quantity 110, ...
#         last  2026-11-21 09:20:11.100: write registers HR400001..400112: quantity 112, ...
#
# Memory: two findings for each entry, at most MAX_PLACES entries for each code.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.text import Text

from mbtool.core.wording import clock_time, counted, day
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.rules import Severity
from mbtool.modbus import Outcome
from mbtool.views.place_columns import host_of
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Console

    from mbtool.ledger.failed_requests import FailedRequests


MAX_PLACES = 5
"""A summary shows at most this many places for each code; a scan of all addresses would give
many."""
_INDENT = "    "
_NARROWEST = 20
_ORDER = tuple(Severity)
_STYLES = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.NOTE: "cyan"}


@dataclass(slots=True)
class PlaceSummary:
    """Counts the findings (broken rules) with one code at one place; keeps the first and last one.

    A place is link, unit and device, and also the file if several files are checked.
    """

    place: str
    first: Finding
    last: Finding
    number: int = 0

    def add(self, finding: Finding) -> None:
        self.number += finding.count
        if finding.ts_ns < self.first.ts_ns:
            self.first = finding
        if finding.ts_ns >= self.last.ts_ns:
            self.last = finding


class CodeSummary:
    """Counts the findings (broken rules) with one code at each of at most MAX_PLACES places."""

    def __init__(self, severity: Severity) -> None:
        self.severity = severity
        self._places: dict[tuple[str, str], PlaceSummary] = {}
        self.number_elsewhere = 0
        """Number of findings at further places, which have no entry of their own."""

    def add(self, finding: Finding, file: str) -> None:
        place = _place(finding, file)
        # For an attack it matters who makes it, so each source address gets an entry of its own.
        is_attack = finding.code.startswith("SEC")
        key = (place, host_of(finding.source) if is_attack else "")
        summary = self._places.get(key)
        if summary is None:
            if len(self._places) == MAX_PLACES:
                self.number_elsewhere += finding.count
                return
            summary = self._places[key] = PlaceSummary(place, finding, finding)
        summary.add(finding)

    def places(self) -> list[PlaceSummary]:
        """Return the summaries of at most MAX_PLACES places, the one with most findings first."""
        return sorted(self._places.values(), key=lambda one: -one.number)


class Summaries:
    """Counts findings (broken rules) by code and place; keeps the first and last of each place."""

    def __init__(self) -> None:
        self._by_code: dict[str, CodeSummary] = {}

    def add(self, finding: Finding, file: str = "") -> None:
        """Add a finding. `file` names the capture file; empty if only one file is checked."""
        code = self._by_code.get(finding.code)
        if code is None:
            code = self._by_code[finding.code] = CodeSummary(finding.severity)
        code.add(finding, file)

    def __bool__(self) -> bool:
        return bool(self._by_code)

    def __iter__(self) -> Iterator[tuple[str, CodeSummary]]:
        """Yield each code with its summary: errors first, then warnings and notes, each by code."""
        return iter(
            sorted(self._by_code.items(), key=lambda one: (_ORDER.index(one[1].severity), one[0]))
        )


def print_summaries(console: Console, summaries: Summaries) -> None:
    """Print an entry for each code and place: the number of findings, and the first and
    last one.
    """
    rows = [
        (code, summary, place, counted(place.number, "time"))
        for code, summary in summaries
        for place in summary.places()
    ]
    code_width = max((len(row[0]) for row in rows), default=0)
    level_width = max((len(row[1].severity) for row in rows), default=0)
    times_width = max((len(row[3]) for row in rows), default=0)
    elsewhere = Counter({code: summary.number_elsewhere for code, summary in summaries})
    for index, (code, summary, place, times) in enumerate(rows):
        level = summary.severity
        line = Text(code.ljust(code_width), _STYLES[level])
        line.append(f"  {level.value.ljust(level_width)}  {times.rjust(times_width)}  ", "default")
        line.append(printable(place.place), "default")
        console.print(line, soft_wrap=True)
        _print_cases(console, place)
        is_last_of_code = index + 1 == len(rows) or rows[index + 1][0] != code
        if is_last_of_code and elsewhere[code]:
            _print_indented(console, f"and {counted(elsewhere[code], 'time')} at other places")


def _print_cases(console: Console, place: PlaceSummary) -> None:
    """Print a line for the first and one for the last finding of a place; one if it is the only."""
    first, last = place.first, place.last
    if first is last:
        _print_indented(console, f"{_time(first)}: {first.message}")
        return
    _print_indented(console, f"first {_time(first)}: {first.message}")
    message = "the same" if last.message == first.message else last.message
    _print_indented(console, f"last  {_time(last)}: {message}")


def _print_indented(console: Console, text: str) -> None:
    """Print an indented text. It is wrapped into several lines on a terminal, but not on a pipe."""
    text = printable(text)
    lines = [text]
    if console.is_terminal:
        lines = wrap(text, max(console.width - len(_INDENT), _NARROWEST))
    for line in lines:
        console.print(Text(_INDENT + line), soft_wrap=True)


def failed_text(failed: FailedRequests) -> str:
    """Return how many requests got no good answer: `90 requests got no answer, 4 an exception`.

    The text is empty if all got one.
    """
    numbers = (
        (failed.count(Outcome.NO_ANSWER) - failed.damaged, "no answer"),
        (failed.damaged, "a damaged answer"),
        (failed.count(Outcome.MALFORMED), "a malformed answer"),
        (failed.count(Outcome.EXCEPTION), "an exception"),
    )
    told = [(number, what) for number, what in numbers if number]
    if not told:
        return ""
    (first, what), *others = told
    text = f"{counted(first, 'request', ',')} got {what}"
    return ", ".join([text, *(f"{number:,} {what}" for number, what in others)])


def finding_line(finding: Finding) -> Text:
    """Return a finding as one line: time, code, link and unit, message and number of cases."""
    times = f" ({finding.count} times)" if finding.count > 1 else ""
    line = Text(f"{_time(finding)}  ")
    line.append(f"{finding.code:<9}", _STYLES[finding.severity])
    line.append(printable(f"  {where(finding)}: {finding.message}{times}"))
    return line


def _place(finding: Finding, file: str) -> str:
    """Return the place of a finding as text: link, unit, device, and `file` unless it is empty."""
    device = f", {finding.device}" if finding.device else ""
    return f"{where(finding)}{device}{', ' * bool(file)}{file}"


def where(finding: Finding) -> str:
    """Return the link and the unit of a finding as text; only the link if it has no unit."""
    text = finding.link
    if finding.unit is not None:
        text += f" unit {finding.unit}"
    return text


def _time(finding: Finding) -> str:
    return f"{day(finding.ts_ns)} {clock_time(finding.ts_ns)}"
