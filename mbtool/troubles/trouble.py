"""A trouble: what is wrong with a link, a unit or a master, why, what to do, and the evidence."""

# Texts and figures are separate. words.py has one row for each code, with cause and remedy as
# templates; a rule makes a Trouble with the figures for these templates. So every command shows the
# same texts. A command only decides how many troubles it shows, and how much of each.

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.core.moments import clock_time, counted, day
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.rules import Severity, rule_of
from mbtool.troubles.words import WORDS, Words

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

MAX_EVIDENCE = 100
"""A trouble keeps at most this many cases as evidence; its `count` counts all cases."""
MAX_OTHERS = 1000
"""A trouble that stands for several units, links or masters keeps at most this many of the
others."""


class Sureness(StrEnum):
    """How sure the cause of a trouble is."""

    CERTAIN = "certain"
    """The recording proves the trouble."""
    LIKELY = "likely"
    """No other cause that is known fits the recording as well."""
    POSSIBLE = "possible"
    """Other causes fit, too; the page of the trouble says how to make sure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """One case of a trouble: its time, and where its bytes stand in the recording."""

    ts_ns: int
    """The time of the request, or of the event, in ns since 1970."""
    text: str = ""
    """The event in a few words; empty if the trouble already says it."""
    file: str | None = None
    packets: tuple[int, ...] = ()
    """The numbers of the packets in the file, from 1, as Wireshark counts them."""
    offsets: tuple[int, ...] = ()
    """In a file of the bytes of a serial line, the numbers of bytes before request and response."""

    @classmethod
    def of(cls, one: Transaction, text: str = "") -> Evidence:
        packets = (one.request_packet, one.response_packet)
        offsets = (one.request_offset, one.response_offset)
        return cls(
            ts_ns=one.start_ns,
            text=text,
            file=one.file,
            packets=tuple(number for number in packets if number is not None),
            offsets=tuple(number for number in offsets if number is not None),
        )

    @classmethod
    def of_event(cls, event: WireEvent, text: str = "") -> Evidence:
        return cls(ts_ns=event.ts_ns, text=text or event.message)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """One thing that is wrong."""

    code: str
    """A row of words.py, such as LINE-LATE. A code never changes its meaning."""
    link: str
    unit: int | None = None
    """The unit that has the trouble; None if the line or a master has it."""
    master: str = ""
    """The master's host, where the trouble is a master's; empty on a serial line."""
    count: int = 1
    """The number of requests, frames or connections that have the trouble."""
    of: int = 0
    """Out of how many in the same time; 0 if there is nothing to compare with."""
    since_ns: int | None = None
    """The time of the first case (ns since 1970); None if there were cases from the beginning."""
    until_ns: int | None = None
    """The time of the last case (ns since 1970); None if the trouble lasted to the end."""
    is_long: bool = False
    """True if the recording takes a day or longer, so that times need a date."""
    is_small: bool = False
    """True if the trouble is shown as a note, whatever the code's severity: few requests are
    concerned."""
    figures: Mapping[str, str] = field(default_factory=dict)
    """The texts for the names in the templates of the code's words."""
    weight: float = 0.0
    """Troubles of one code are sorted by this number, the greatest first."""
    sureness: Sureness = Sureness.CERTAIN
    evidence: tuple[Evidence, ...] = ()
    """The first cases, at most MAX_EVIDENCE."""
    search: str = ""
    """The filter that finds the cases in the table of a report; empty if the filter of the link or
    unit finds them."""
    others: tuple[Trouble, ...] = ()
    """The troubles with the same code of other units, links or masters, the worst first."""
    victims: tuple[int, ...] = ()
    """The units whose troubles this trouble explains, if they are others than `unit`."""
    names_link: bool = False
    """True if the recording has several links, so that `who` needs the link."""

    @property
    def words(self) -> Words:
        """Return the code's row of words.py; for a broken rule a row made of the rule."""
        return WORDS.get(self.code) or _words_of_rule(self.code)

    @property
    def severity(self) -> Severity:
        return Severity.NOTE if self.is_small else self.words.severity

    @property
    def who(self) -> str:
        """Return the unit, master or link that has the trouble: `unit 4`, `unit 4 at 10.0.0.2`."""
        if self.unit is None:
            return self.master or self.link
        name = f"unit {self.unit}" if self.unit >= 0 else "other units"
        return f"{name} at {self.link or 'other links'}" if self.names_link else name

    @property
    def cause(self) -> str:
        """Return what is wrong as a clause, with who, how often, and since when.

        If others have the same trouble, it is that of the worst one, and the number of the others.
        """
        cause = self.words.cause
        text = cause.format(**self._figures()) + ("" if "{when}" in cause else self.when)
        if not self.others:
            return text
        return f"{text}; {counted(len(self.others), f'more {self.words.noun}', ',')} likewise"

    @property
    def remedy(self) -> str:
        """Return what to do about it, as a clause in the imperative."""
        return self.words.remedy.format(**self._figures())

    @property
    def sentence(self) -> str:
        """Return cause and remedy: `unit 2 answers after 0.70 s, ...: raise the time-out`."""
        return f"{self.cause}: {self.remedy}"

    @property
    def short(self) -> str:
        """Return what is wrong in a few words, without who: `33 % refused since 10:43:02`."""
        short = self.words.short
        return short.format(**self._figures()) + self.when if short else self.code

    @property
    def finding(self) -> Finding:
        """Return the trouble as a finding, for the log."""
        first_ns = self.evidence[0].ts_ns if self.evidence else 0
        return Finding(
            code=self.code,
            message=self.sentence,
            ts_ns=first_ns if self.since_ns is None else self.since_ns,
            link=self.link,
            unit=self.unit,
            count=self.count,
            file=self.evidence[0].file if self.evidence else None,
            packets=self.evidence[0].packets if self.evidence else (),
            offsets=self.evidence[0].offsets if self.evidence else (),
            level=self.severity,
        )

    @property
    def all(self) -> tuple[Trouble, ...]:
        """Return the trouble of the worst one, and those of the others, each for itself."""
        return (replace(self, others=()), *self.others)

    @property
    def when(self) -> str:
        """Return the time of the cases as text: ` since 10:43:02`; empty if it is all the time."""
        since, until = (
            None if ns is None else moment_text(ns, is_long=self.is_long)
            for ns in (self.since_ns, self.until_ns)
        )
        if until is None:
            return "" if since is None else f" since {since}"
        return f" until {until}" if since is None else f" from {since} to {until}"

    def _figures(self) -> dict[str, str]:
        figures = {
            "who": self.who,
            "link": self.link,
            "count": f"{self.count:,}",
            "when": self.when,
        }
        return {**figures, "of": f"{self.of:,}", **self.figures}


def moment_text(ns: int, *, is_long: bool) -> str:
    """Return a time of day with seconds; if the recording `is_long`, with the date, to the
    minute.
    """
    return f"{day(ns)} {clock_time(ns)[:5]}" if is_long else clock_time(ns)[:8]


def _words_of_rule(code: str) -> Words:
    """Return the words of a broken rule of `check` (devices/checking/rules.py)."""
    rule = rule_of(code)
    meaning = "a rule that this version does not know" if rule is None else rule.meaning.rstrip(".")
    return Words(
        code,
        Severity.WARNING if rule is None else rule.severity,
        f"{meaning[:1].lower()}{meaning[1:]} ({code}, {{times}} at {{place}})",
        f"see docs/findings.md, section {code if rule is None else rule.code}",
        "place",
    )


def keep(cases: list[Evidence], case: Evidence) -> None:
    """Add a case to the first ones, if there are fewer than MAX_EVIDENCE."""
    if len(cases) < MAX_EVIDENCE:
        cases.append(case)
