"""Makes troubles of a report of what is odd in the polling though requests are answered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.wording import duration
from mbtool.ledger.history import UnitRow
from mbtool.troubles.odd_polling import LateUnit, PollingPause
from mbtool.views.report.troubles import Rank, VerdictTrouble, link_word
from mbtool.views.trouble_words import joined_oddities, oddities_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.troubles.odd_polling import Oddity
    from mbtool.views.trouble_words import Unit

_MS = 1_000_000


def odd_troubles(
    kinds: Sequence[Sequence[Oddity[Unit]]], name_of: Callable[[Unit], str]
) -> list[VerdictTrouble]:
    """Return oddities as troubles, the worst first. `kinds` has the oddities by kind; `name_of`
    returns a unit as text.
    """
    return [_trouble(some, name_of) for some in joined_oddities(kinds)]


def _trouble(some: Sequence[Oddity[Unit]], name_of: Callable[[Unit], str]) -> VerdictTrouble:
    worst = some[0]
    cases: tuple[tuple[int, str], ...] = ()
    title = ""
    if isinstance(worst, LateUnit):
        who = name_of(worst.unit)
        search = f"{link_word(worst.unit[0])}unit:{worst.unit[1]} ms>={worst.late_ns // _MS}"
    else:
        who = worst.master or worst.link
        search = link_word(worst.link).strip()
    if isinstance(worst, PollingPause):
        cases = tuple((begin_ns, f"for {duration(ns)}") for ns, begin_ns in worst.cases)
        if sum(one.number for one in some if isinstance(one, PollingPause)) > len(cases):
            of = f" of {who}" if len(some) > 1 else ""
            title = f"the longest{of}:" if len(cases) == 1 else f"the {len(cases)} longest{of}:"
    return VerdictTrouble(
        rank=Rank.ODD,
        text=oddities_text(some, name_of),
        weight=sum(one.lost_s for one in some),
        who=who,
        search=search,
        cases=cases,
        cases_title=title,
        units=frozenset(UnitRow(*one.unit) for one in some if isinstance(one, LateUnit)),
    )
