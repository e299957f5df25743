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
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.text import Text

from mbtool.core.moments import counted, moment
from mbtool.devices.checking.rules import Severity
from mbtool.troubles.broken_rules import PlaceSummary, Summaries, where
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from rich.console import Console

    from mbtool.devices.checking.finding import Finding


_INDENT = "    "
_NARROWEST = 20
_STYLES = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.NOTE: "cyan"}


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


def finding_line(finding: Finding) -> Text:
    """Return a finding as one line: time, code, link and unit, message and number of cases."""
    times = f" ({finding.count} times)" if finding.count > 1 else ""
    line = Text(f"{_time(finding)}  ")
    line.append(f"{finding.code:<9}", _STYLES[finding.severity])
    line.append(printable(f"  {where(finding)}: {finding.message}{times}"))
    return line


def _time(finding: Finding) -> str:
    return moment(finding.ts_ns)
