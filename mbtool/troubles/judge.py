"""Makes the judgement: the list of troubles, with cause and remedy, for every command."""

# Each record (a transaction, an event, or a block of answered requests) is counted in the account
# (ledger/account.py) and given to the senses: classes that each find some kinds of troubles
# (sense.py). Broken rules come from the Checker (devices/checking). The judgement can be asked for
# at any time. It leaves out a trouble that another trouble causes (`explains` in words.py), and
# joins the same trouble of several units, links or masters into one.
#
# Memory: that of the account and of the senses.

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from mbtool.core import WireEvent
from mbtool.core.moments import counted, duration, in_ms
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.checker import Checker
from mbtool.devices.checking.rules import Severity
from mbtool.ledger.account import OTHER_UNITS, Account
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.statistics_report import LinkReport, report, unit_tallies
from mbtool.modbus import Outcome
from mbtool.troubles.broken_rules import Summaries, rule_troubles
from mbtool.troubles.cases import Cases
from mbtool.troubles.failed_shares import is_grave
from mbtool.troubles.line_damage import LineDamage
from mbtool.troubles.line_late import LateOnLine
from mbtool.troubles.line_sides import HeardSides
from mbtool.troubles.line_strays import StrayBytes
from mbtool.troubles.net_gateway import Gateways
from mbtool.troubles.net_hosts import Hosts
from mbtool.troubles.net_lost import LossyPaths, LostConnections
from mbtool.troubles.net_polls import NetworkPolls
from mbtool.troubles.polling import polling_troubles
from mbtool.troubles.trouble import MAX_OTHERS, Sureness, Trouble
from mbtool.troubles.units import unit_troubles
from mbtool.troubles.value_faults import ValueFaults
from mbtool.troubles.words import WORDS

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.checking.quiet_run import QuietRows, QuietRun
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.answered_reads import AnsweredValues
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.troubles.sense import Sense

# The senses that find the troubles of a serial line.


def line_senses(context: CaptureContext) -> list[Sense]:
    """Return a sense of each kind; `context` has facts about the present capture."""
    return [LateOnLine(), HeardSides(), LineDamage(), StrayBytes(context.line_of)]


# The senses that find the troubles of a network.


def network_senses(cases: Cases) -> list[Sense]:
    """Return a sense of each kind; `cases` has the slow answers as evidence."""
    return [NetworkPolls(cases), Gateways(), LostConnections(), LossyPaths(), Hosts()]


Q = TypeVar("Q", bound="QuietRows")

MIN_JOINED = 3
"""Troubles with the same code are shown as one if at least this many units, links or masters have
it."""
MIN_ANSWERED = 20
"""With fewer answered requests than this, a recording is too short to say that all is well."""
MIN_EXPLAINED_SHARE = 0.5
"""The trouble of one unit, or a small one, is the cause of another trouble only if it has at least
this share (0 to 1) of the other's cases."""
PIECES_PER_CASE = 4
"""An adapter may deliver the bytes of one damaged frame in several pieces. So the trouble of a unit
or line explains bytes that are no frame (RTU-201, RTU-202) if there are at most this many of them
for each case of the trouble."""
MIN_CHANCE_OF_SILENCE = 1e-6
"""The least probability (0 to 1) that damage hits all answers of a unit. If it is smaller, the
damage of the line does not explain why this unit never answers."""
_BYTES = frozenset(("RTU-201", "RTU-202"))
"""The codes of findings for bytes that are no frame with a correct CRC."""
_SEVERITIES = tuple(Severity)
_ROWS = {code: place for place, code in enumerate(WORDS)}
_ANSWERS = (Outcome.OK, Outcome.EXCEPTION, Outcome.MALFORMED)


@dataclass(frozen=True, slots=True)
class Judgement:
    """What is wrong, the worst first; or that all is well, or that too little was heard."""

    troubles: Sequence[Trouble]
    links: Sequence[LinkReport]
    """The statistics of each link, from which the troubles were found."""
    is_chosen: bool = False
    """True if the user chose the codes, so that no trouble among them does not mean that all is
    well."""

    @property
    def is_enough(self) -> bool:
        """True if enough requests were answered to say that all is well."""
        return _count_answered(self._total) >= MIN_ANSWERED

    @property
    def level(self) -> str:
        """Return `bad` if a trouble is an error, `well` if there is none and enough was heard, else
        `doubt`.
        """
        if any(one.severity is Severity.ERROR for one in self.troubles):
            return "bad"
        is_well = not (self.troubles or self.is_chosen) and self.is_enough
        return "well" if is_well else "doubt"

    @property
    def summary(self) -> str:
        """Return a sentence for the case that there is no trouble: who answers how many requests,
        or that too little was heard.
        """
        if self.is_chosen:
            return "No trouble of the chosen codes shows."
        total, units = self._total, unit_tallies(self.links)
        if not total.transactions:
            is_any = any(link.tally.transactions for link in self.links)
            if is_any:
                return "There are only broadcasts, which no unit answers, in the recording."
            return "There is no transaction in the recording."
        lacking, answered = total.count(Outcome.NOT_CAPTURED), _count_answered(total)
        lacks = f"; the recording lacks parts of {counted(lacking, 'transaction', ',')}"
        if not answered:
            return f"No trouble shows, but no request is answered{lacks if lacking else ''}."
        who = "the unit answers" if len(units) == 1 else f"{units_text(units)} answer"
        usual = total.latency.percentile(50)
        half = f", half of them within {in_ms(usual)} ms" if usual else ""
        text = f"{who} {counted(answered, 'request', ',')}{half}{lacks if lacking else ''}"
        if self.is_enough:
            return f"Everything is well: {text}."
        watched_ns = self.links[0].all_watched_ns
        time = f" in {duration(watched_ns)}" if watched_ns else ""
        return f"Too short to judge{time}: {text}; no trouble shows."

    @property
    def _total(self) -> RequestTally:
        return merged([*unit_tallies(self.links).values()])


class Judge:
    """Takes all records in order: counts them, checks them against the rules, and judges them.

    Each record goes to `count` (or to `hear`, and by the caller to the account) and to `check`.
    """

    def __init__(self, ledger: Account, context: CaptureContext | None = None) -> None:
        """`ledger` is the account of all captures. `context` has the facts that rules need beside
        the records; its functions are asked about the present capture.
        """
        self.ledger = ledger
        self.findings = Summaries()
        """The broken rules that `note` received, by code and place."""
        self.remarks: list[str] = []
        """Sentences for the user that are no findings; those of a capture come when it has
        ended."""
        self._context = context or CaptureContext()
        self._cases = Cases()
        self._values = ValueFaults(self._context.assignments)
        of_lines, of_networks = line_senses(self._context), network_senses(self._cases)
        self._of_lines = (self._cases, self._values, *of_lines)
        """The senses that take the transactions of serial lines."""
        self._of_networks = (self._cases, self._values, *of_networks)
        self._senses = (*self._of_lines, *of_networks)
        self._checker: Checker | None = None
        """The rule checker with its state of the present capture; None between captures."""

    def begin_capture(self, context: CaptureContext | None = None) -> None:
        """Note that the next record belongs to another capture, perhaps of another day.

        `context` has the facts about it for the rules, if they differ from those of the first one.
        """
        self._checker = Checker(context or self._context)
        self.ledger.begin_capture()
        for sense in self._senses:
            sense.begin_capture()

    def become_norm(self) -> None:
        """Take the captures that follow as a baseline, by whose values others are judged."""
        self._values.become_norm()

    def judge_by(self, norm: Judge) -> None:
        """Judge the values of the captures that follow by those of a baseline as well."""
        self._values.judge_by(norm._values)

    @property
    def norm_remark(self) -> str | None:
        """A sentence for the user if the baseline could not be used; None if it was used, or if
        there is no baseline.
        """
        return self._values.norm_remark

    def end_capture(self) -> Iterator[Finding]:
        """Yield the findings that are known only at the end of the present capture."""
        checker, self._checker = self._checker, None
        if checker is not None:
            yield from checker.close()
            self.remarks += checker.remarks

    def count(
        self, record: NamedTransaction | WireEvent, *, is_wanted: bool = True
    ) -> PollStatistics | None:
        """Count the next record; return its poll, None for an event and for a response without
        request. With `is_wanted` false, it is left out of the account, as the user's filter says.
        """
        self.hear(record)
        if not is_wanted:
            self.ledger.left_out += 1
            return None
        return self.ledger.add(record)

    def hear(self, record: NamedTransaction | WireEvent) -> None:
        """Let the senses take the next record, which the caller adds to the account."""
        if isinstance(record, WireEvent):
            for sense in self._senses:
                sense.event(record)
        else:
            for sense in self._of_lines if record.transport.is_serial else self._of_networks:
                sense.transaction(record)

    def count_run(self, run: QuietRun, reads: AnsweredValues) -> None:
        """Count many answered requests of a network together. `reads` has their values."""
        for sense in self._senses:
            sense.run(run)
        self._values.reads(reads)
        self.ledger.add_run(run)

    def check(self, record: NamedTransaction | WireEvent) -> Iterator[Finding]:
        """Yield the findings that the next record makes certain."""
        if self._checker is None:
            self.begin_capture()
        assert self._checker is not None
        return self._checker.feed(record)

    def check_rows(
        self, rows: Q
    ) -> Iterator[tuple[NamedTransaction | WireEvent | Q, Iterator[Finding]]]:
        """Check many answered reads; as Checker.feed_rows."""
        if self._checker is None:
            self.begin_capture()
        assert self._checker is not None
        return self._checker.feed_rows(rows)

    def note(self, finding: Finding, file: str = "") -> None:
        """Note a finding, so that it is one of the troubles unless another one is its cause.

        `file` names the capture file; empty if only one file is read.
        """
        self.findings.add(finding, file)

    def judgement(self, links: Sequence[LinkReport] | None = None) -> Judgement:
        """Judge all records so far. `links` is the account of each link, if the caller has it."""
        links = report(self.ledger) if links is None else links
        found = [trouble for sense in self._senses for trouble in sense.troubles(links)]
        found += unit_troubles(links, self._cases)
        found += polling_troubles(links, self._cases)
        found += _stray_frames(links)
        found += rule_troubles(self.findings)
        several = len(links) > 1
        named = [
            replace(one, names_link=several)
            for one in self._cases.with_evidence(_unexplained_troubles(found))
        ]
        return Judgement(_sorted_worst_first(_join_alike(named)), links)


def units_text(units: Collection[tuple[str, int]]) -> str:
    """Return the number of units as text: `40 units`, or `at least 40 units` where some are counted
    together. A unit is a link and a number.
    """
    known = sum(number != OTHER_UNITS for _, number in units)
    least = "at least " if known < len(units) else ""
    return f"{least}{counted(known, 'unit', ',')}"


def _stray_frames(links: Sequence[LinkReport]) -> Iterator[Trouble]:
    for link in links:
        if link.stray_frames > 0:
            yield Trouble(
                code="LINE-STRAY",
                link=link.name,
                count=link.stray_frames,
                of=link.tally.transactions,
                weight=link.stray_frames,
                is_small=not is_grave(link.stray_frames, link.tally.transactions),
                figures={"frames": counted(link.stray_frames, "frame", ",")},
            )


def _unexplained_troubles(found: Sequence[Trouble]) -> list[Trouble]:
    """Return the troubles that no other trouble is the cause of.

    What is only possible goes first, so that it explains nothing that has another cause.
    """
    possible = [one for one in found if one.sureness is Sureness.POSSIBLE]
    gone = {id(one) for one in possible if any(_explains(cause, one) for cause in found)}
    found = [one for one in found if id(one) not in gone]
    causes: dict[str, list[Trouble]] = {}
    for one in found:
        if one.words.explains:
            causes.setdefault(one.link, []).append(one)
    return [
        one
        for one in found
        if not any(cause is not one and _explains(cause, one) for cause in causes.get(one.link, ()))
    ]


def _explains(cause: Trouble, other: Trouble) -> bool:
    if cause.link != other.link:
        return False
    if cause.code == "LINE-SAME-UNIT" and other.code == "LINE-LATE":
        # Answers that collide behind the request of a dead unit are not its late ones.
        return other.sureness is Sureness.POSSIBLE
    if cause.code == "LINE-TWO-MASTERS" and other.code in ("LINE-SETTINGS", "LINE-FOREIGN"):
        # Masters that ask in step collide for seconds, always with the same bytes.
        return cause.count >= MIN_EXPLAINED_SHARE * other.count
    if other.code not in cause.words.explains:
        return False
    if cause.victims and other.unit is not None:
        return other.unit in cause.victims
    if cause.unit is None:
        if other.code == "UNIT-SILENT" and cause.of:
            return (cause.count / cause.of) ** other.count >= MIN_CHANCE_OF_SILENCE
        return not cause.is_small or cause.count >= MIN_EXPLAINED_SHARE * other.count
    is_of_line = other.unit is None or other.words.noun == "line" or other.code.startswith("RTU")
    is_of_unit = is_of_line or other.unit == cause.unit
    share = 1 / PIECES_PER_CASE if other.code in _BYTES else MIN_EXPLAINED_SHARE
    return is_of_unit and cause.count >= share * other.count


def _join_alike(found: Iterable[Trouble]) -> Iterator[Trouble]:
    """Join the same trouble of at least MIN_JOINED units, links or masters into one, worst
    first.
    """
    kinds: dict[tuple[str, bool], list[Trouble]] = {}
    for one in found:
        kinds.setdefault((one.code, one.is_small), []).append(one)
    for some in kinds.values():
        some.sort(key=lambda one: -one.weight)
        if len(some) < MIN_JOINED:
            yield from some
        else:
            yield replace(some[0], others=tuple(some[1 : MAX_OTHERS + 1]))


def _sorted_worst_first(troubles: Iterable[Trouble]) -> list[Trouble]:
    def rank(one: Trouble) -> tuple[int, int, float]:
        row = _ROWS.get(one.code, -1 if one.code.startswith("SEC") else len(_ROWS))
        return _SEVERITIES.index(one.severity), row, -one.weight

    return sorted(troubles, key=rank)


def _count_answered(total: RequestTally) -> int:
    return sum(map(total.count, _ANSWERS))
