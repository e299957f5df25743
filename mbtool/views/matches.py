"""Shows the profiles that explain the traffic of each slave."""

# For each slave: a sentence, and a table of the best profiles with the reasons for and against.

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.text import Text

from mbtool.views.tables import plain, plain_table, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console
    from rich.table import Table

    from mbtool.devices.profile_match import MatchResult, ProfileMatch

MIN_SHOWN = 3


def print_match_results(console: Console, results: Sequence[MatchResult]) -> None:
    """Print every slave with its best profiles."""
    for index, result in enumerate(results):
        if index:
            console.print()
        slave = result.slave
        where = f"unit {slave.unit} at {slave.destination or slave.link}"
        console.print(plain(f"{where}: {result.sentence}", "bold"))
        if slave.has_responded:
            console.print(_table(shown_matches(result)))


def shown_matches(result: MatchResult) -> Sequence[ProfileMatch]:
    """The profiles to show: all that tie for the best, at least MIN_SHOWN, none with score 0."""
    scored = [one for one in result.matches if one.score > 0]
    return scored[: max(MIN_SHOWN, len(result.best))]


def match_record(result: MatchResult) -> dict[str, Any]:
    """A result as JSON data, with all profiles, also those that explain nothing."""
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
