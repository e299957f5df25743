"""Sums up findings (broken rules of `check`) by code and place, and reports them as troubles."""

# A master that repeats a mistake in every poll breaks the same rule many times. So the findings of
# one code at one place (link, unit and device) are counted together, and only the first and the
# last are kept. A finding with the severity of a note becomes no trouble, as it need not be a
# fault.
#
# Memory: two findings for each place, at most MAX_PLACES places for each code.

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from mbtool.core.moments import counted, host_of
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.rules import Severity
from mbtool.troubles.trouble import Evidence, Trouble

MAX_PLACES = 5
"""A summary shows at most this many places for each code; a scan of all addresses would give
many."""
_ORDER = tuple(Severity)


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


def rule_troubles(findings: Summaries) -> Iterator[Trouble]:
    """Yield a trouble for each code that has findings, except for notes."""
    for code, summary in findings:
        if summary.severity is Severity.NOTE:
            continue
        places = summary.places()
        number = sum(place.number for place in places) + summary.number_elsewhere
        first = min((place.first for place in places), key=lambda one: one.ts_ns)
        is_attack = code.startswith("SEC")
        is_one_unit = len({(one.first.link, one.first.unit) for one in places}) == 1
        more = len(places) - 1
        worst = places[0].first
        where_text = host_of(worst.source) or worst.link if is_attack else where(worst)
        if more:
            where_text += f" and {counted(more, 'more place')}"
        yield Trouble(
            code=code,
            link=first.link,
            unit=first.unit if is_one_unit and not is_attack else None,
            master=host_of(first.source) if is_attack else "",
            count=number,
            weight=number,
            figures={"times": counted(number, "time", ","), "place": where_text},
            evidence=(_evidence(first),),
            search=code,
        )


def _evidence(finding: Finding) -> Evidence:
    return Evidence(
        ts_ns=finding.ts_ns,
        text=finding.message,
        file=finding.file,
        packets=finding.packets,
        offsets=finding.offsets,
    )


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
