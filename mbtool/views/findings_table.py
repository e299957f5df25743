"""Shows findings: a summary of each code, or every finding."""

# A master that repeats a mistake in every poll breaks the same rule many times. So the summary has
# one entry for each code: the number of cases, the time of the first one, and its message.
#
#     FT1A-Q16  error  812 times  2026-11-21 09:14:03.300  rs485 unit 1
#         write registers HR400001..400110: quantity 110, limit is 100
#
# Memory: one finding for each code.

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.text import Text

from mbtool.core.wording import counted
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.rules import Severity
from mbtool.views.cells import clock_time, day
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Console


_INDENT = "    "
_NARROWEST = 20
_ORDER = tuple(Severity)
_STYLES = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.NOTE: "cyan"}


@dataclass(slots=True)
class CodeSummary:
    """The first finding of one code, and the number of cases."""

    first: Finding
    number: int = 0

    def add(self, finding: Finding) -> None:
        self.number += finding.count
        if finding.ts_ns < self.first.ts_ns:
            self.first = finding


class Summaries:
    """Collects findings by code."""

    def __init__(self) -> None:
        self._by_code: dict[str, CodeSummary] = {}

    def add(self, finding: Finding) -> None:
        self._by_code.setdefault(finding.code, CodeSummary(finding)).add(finding)

    def __bool__(self) -> bool:
        return bool(self._by_code)

    def __iter__(self) -> Iterator[CodeSummary]:
        """Give the summaries sorted by severity, errors first, then by code."""
        return iter(
            sorted(
                self._by_code.values(),
                key=lambda one: (_ORDER.index(one.first.severity), one.first.code),
            )
        )


def print_summaries(console: Console, summaries: Summaries) -> None:
    """Print two lines for each code: the number of cases with the first time and place, and the
    message of the first finding.
    """
    rows = [
        (
            one.first.code,
            one.first.severity.value,
            counted(one.number, "time"),
            f"{_time(one.first)}  {where(one.first)}",
        )
        for one in summaries
    ]
    widths = [max((len(row[index]) for row in rows), default=0) for index in range(3)]
    for one, (code, level, times, place) in zip(summaries, rows, strict=True):
        line = Text(code.ljust(widths[0]), _STYLES[one.first.severity])
        line.append(f"  {level.ljust(widths[1])}  {times.rjust(widths[2])}  ", "default")
        line.append(printable(place), "default")
        console.print(line, soft_wrap=True)
        _print_message(console, one.first.message)


def _print_message(console: Console, message: str) -> None:
    """Print a finding's message, indented. Only a terminal gets it wrapped into several lines."""
    text = printable(message)
    lines = [text]
    if console.is_terminal:
        lines = wrap(text, max(console.width - len(_INDENT), _NARROWEST))
    for line in lines:
        console.print(Text(_INDENT + line), soft_wrap=True)


def finding_line(finding: Finding) -> Text:
    """Write a finding as one line: time, code, place, message and number of cases."""
    times = f" ({finding.count} times)" if finding.count > 1 else ""
    line = Text(f"{_time(finding)}  ")
    line.append(f"{finding.code:<9}", _STYLES[finding.severity])
    line.append(printable(f"  {where(finding)}: {finding.message}{times}"))
    return line


def where(finding: Finding) -> str:
    """The link, and the unit if the finding has one."""
    text = finding.link
    if finding.unit is not None:
        text += f" unit {finding.unit}"
    return text


def _time(finding: Finding) -> str:
    return f"{day(finding.ts_ns)} {clock_time(finding.ts_ns)}"
