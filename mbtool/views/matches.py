"""Shows which profiles explain a slave's traffic."""

# For each slave a sentence, and below it the profiles that explain it best, with what speaks for
# each and what against it.

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.text import Text

from mbtool.views.tables import plain, plain_table, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console
    from rich.table import Table

    from mbtool.devices.profile_match import MatchResult, ProfileMatch

SHOWN = 3


def print_verdicts(console: Console, verdicts: Sequence[MatchResult]) -> None:
    """Every slave with its best profiles."""
    for index, verdict in enumerate(verdicts):
        if index:
            console.print()
        console.print(plain(f"{slave_text(verdict)}: {verdict.sentence}", "bold"))
        if verdict.seen.answered:
            console.print(_table(shown_matches(verdict)))


def slave_text(verdict: MatchResult) -> str:
    """The slave, as a person would say where it is."""
    seen = verdict.seen
    return f"unit {seen.unit} at {seen.destination or seen.link}"


def shown_matches(verdict: MatchResult) -> Sequence[ProfileMatch]:
    """The best and all that tie with it, else SHOWN; none that explains nothing."""
    worth = [one for one in verdict.matches if one.score > 0]
    return worth[: max(SHOWN, len(verdict.best))]


def verdict_record(verdict: MatchResult) -> dict[str, Any]:
    """The same for a program."""
    seen = verdict.seen
    record: dict[str, Any] = {"link": seen.link, "destination": seen.destination}
    return {
        **{key: value for key, value in record.items() if value},
        "unit": seen.unit,
        "transactions": seen.transactions,
        "identity": seen.identity,
        "best": [one.profile for one in verdict.best],
        "verdict": verdict.sentence,
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
            for one in verdict.matches
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
