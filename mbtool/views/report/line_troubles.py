"""Finds the troubles of a report that belong to lines, hosts and rules, and not to single units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.wording import counted
from mbtool.devices.checking.rules import Severity, rule_of
from mbtool.views.place_columns import host_of
from mbtool.views.report.troubles import Rank, VerdictTrouble, link_word, rank_of
from mbtool.views.trouble_words import stray_frames_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.views.findings_table import Summaries


def line_troubles(links: Sequence[LinkReport]) -> list[VerdictTrouble]:
    """Return troubles of lines: bad CRCs that fit no unit, and TCP connections reset or refused."""
    troubles = []
    for link in links:
        if link.stray_frames > 0:
            troubles.append(
                VerdictTrouble(
                    rank=rank_of(Rank.FAILING, link.stray_frames, link.tally.transactions),
                    text=stray_frames_text(link.name, link.stray_frames),
                    weight=link.stray_frames,
                    who=link.name,
                    search=link_word(link.name).strip(),
                )
            )
        lost = sum(one.resets + one.refused for _, one in link.connections)
        if lost:
            troubles.append(
                VerdictTrouble(
                    rank=Rank.MINOR,
                    text=f"{link.name} had {counted(lost, 'connection', ',')} reset or refused",
                    weight=lost,
                    who=link.name,
                    search=link_word(link.name).strip(),
                )
            )
    return troubles


def finding_troubles(findings: Summaries) -> list[VerdictTrouble]:
    """Return the broken rules as troubles, except those that the counts of units show already."""
    troubles = []
    for code, summary in findings:
        places = summary.places()
        number = sum(place.number for place in places) + summary.number_elsewhere
        rule = rule_of(code)
        meaning = "" if rule is None else rule.meaning.rstrip(".")
        meaning = f"{meaning[:1].lower()}{meaning[1:]}"
        first = places[0].first
        if code.startswith("SEC") and summary.severity is not Severity.NOTE:
            who = host_of(first.source) or first.link
            rank, text = Rank.ATTACK, f"{who}: {meaning} ({code})"
        elif code == "RTU-204":
            rank, text = Rank.UNREADABLE, f"{first.link}: {meaning}"
        elif summary.severity is Severity.ERROR or _is_of_a_manual(code, summary.severity):
            rank, text = Rank.RULE, f"{code}, {counted(number, 'time', ',')}: {meaning}"
        else:
            continue
        troubles.append(
            VerdictTrouble(rank=rank, text=text, weight=number, who=code, search=code, is_rule=True)
        )
    return troubles


def _is_of_a_manual(code: str, severity: Severity) -> bool:
    """True for a warning about a rule of a device's manual.

    The counts of units show the warnings about the standard's rules.
    """
    return severity is Severity.WARNING and not code.startswith(("MB-", "RTU-", "TCP-"))
