"""A trouble in a report: its rank, its text, and the units that have it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from mbtool.ledger.history import UnitRow
from mbtool.troubles.failure_limits import is_grave


class Rank(IntEnum):
    """The rank of a trouble; the lowest number is the worst."""

    UNREADABLE = 0
    DEAD = 1
    ATTACK = 2
    FAILING = 3
    SLOW = 4
    RULE = 5
    ODD = 6
    """Nothing fails, but polling pauses, answers come late, or each poll opens a TCP connection."""
    MINOR = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class VerdictTrouble:
    """One thing that is wrong with a unit, a link, a host or a rule."""

    rank: Rank
    text: str
    """A clause that names the unit, link or host that has the trouble."""
    weight: float = 0.0
    """Troubles of the same rank are sorted by this number, the greatest first."""
    who: str = ""
    """The name of the unit, link, host or rule that the trouble belongs to."""
    search: str = ""
    """The text that finds the trouble's transactions in the search field of the report's table."""
    cases: tuple[tuple[int, str], ...] = ()
    """The begin (UTC ns) of each of the worst cases, and a text about it such as `for 7.25 s`;
    empty if `search` finds them."""
    cases_title: str = ""
    """A line above the cases that says which they are; empty if they are all there are."""
    units: frozenset[UnitRow] = frozenset()
    is_refusal: bool = False
    is_rule: bool = False
    """True if the trouble is a broken rule, which stands among the findings, too."""


def link_word(link: str) -> str:
    """Return the link and a space, for the page's search field; empty if the link has spaces."""
    return "" if " " in link else f"{link} "


def rank_of(grave: Rank, failed: int, asked: int) -> Rank:
    """Return `grave` if enough of the requests failed (troubles/failure_limits.py), else MINOR."""
    return grave if is_grave(failed, asked) else Rank.MINOR
