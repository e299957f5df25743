"""Prints which device profiles explain the traffic of each slave."""

# For each slave there is a sentence, and a table of the best profiles with the reasons for and
# against them. If there are more than MAX_DETAILED slaves, there are no tables, and each sentence
# comes only once, with the number of slaves and the names of some.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.text import Text

from mbtool.core.moments import counted
from mbtool.views.tables import plain, plain_table, printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from mbtool.devices.observed_slave import ObservedSlave
    from mbtool.devices.profile_match import MatchResult, ProfileMatch

MIN_SHOWN = 3
MAX_DETAILED = 32
_EXAMPLES = 3
_MAX_SENTENCES = 40


def print_match_results(console: Console, results: Sequence[MatchResult]) -> None:
    """Print the best profiles of every slave; only a summary of more than MAX_DETAILED slaves."""
    if len(results) > MAX_DETAILED:
        _print_summary(console, results)
        return
    for index, result in enumerate(results):
        if index:
            console.print()
        slave = result.slave
        console.print(plain(f"{_slave_text(slave)}: {result.sentence}", "bold"))
        if slave.has_responded:
            console.print(_table(shown_matches(result)))


def _slave_text(slave: ObservedSlave) -> str:
    return f"unit {slave.unit} at {slave.destination or slave.link}"


def _print_summary(console: Console, results: Sequence[MatchResult]) -> None:
    """Print each sentence once, with the slaves that it describes; the most frequent come first."""
    alike: dict[str, list[ObservedSlave]] = {}
    for result in results:
        alike.setdefault(result.sentence, []).append(result.slave)
    ranked = sorted(alike.items(), key=lambda one: -len(one[1]))
    for sentence, slaves in ranked[:_MAX_SENTENCES]:
        console.print(plain(f"{counted(len(slaves), 'slave', ',')}: {sentence}", "bold"))
        examples = ", ".join(map(_slave_text, slaves[:_EXAMPLES]))
        more = " and so on" if len(slaves) > _EXAMPLES else ""
        console.print(plain(f"  {examples}{more}"))
    if len(ranked) > _MAX_SENTENCES:
        rest = sum(len(slaves) for _, slaves in ranked[_MAX_SENTENCES:])
        console.print(plain(f"{counted(rest, 'slave', ',')} of which something else is said"))
    console.print(plain("--format jsonl tells each slave with its profiles"))


def shown_matches(result: MatchResult) -> Sequence[ProfileMatch]:
    """Return the profiles to show: all with the best score, and at least MIN_SHOWN if there are.

    The score says how well a profile explains the slave's traffic. One with score 0 is not shown.
    """
    scored = [one for one in result.matches if one.score > 0]
    return scored[: max(MIN_SHOWN, len(result.best))]


def match_record(result: MatchResult) -> dict[str, Any]:
    """Return the result for one slave as JSON data, with all profiles, even those of score 0."""
    slave = result.slave
    where: dict[str, Any] = {"link": slave.link, "destination": slave.destination}
    return {
        **{key: value for key, value in where.items() if value},
        "unit": slave.unit,
        "transactions": slave.transactions,
        "identity": slave.identity,
        "best": [one.profile for one in result.best],
        "verdict": result.sentence,
        "profiles": [
            {
                "profile": one.profile,
                "score": one.score,
                "explained": one.explained,
                "contradicted": one.contradicted,
                "named": one.named,
                "addresses": one.addresses,
                "for": one.reasons,
                "against": one.against,
            }
            for one in result.matches
        ],
    }


def _table(matches: Sequence[ProfileMatch]) -> Table:
    table = plain_table("profile")
    table.add_column("score", justify="right")
    table.add_column("why", overflow="fold", ratio=1)
    for one in matches:
        lines = [f"+ {reason}" for reason in one.reasons] + [f"- {one}" for one in one.against]
        why = Text("\n".join(map(printable, lines)))
        table.add_row(plain(one.profile), str(one.score), why)
    return table
