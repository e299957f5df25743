"""Writes the first lines of statistics: a summary, and the most frequent failures."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.wording import counted, duration, percent, plural
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.statistics_report import (
    is_counted_together,
    unit_polls,
    unit_tallies,
    unit_times,
)
from mbtool.modbus import Outcome
from mbtool.troubles.failed_shares import FailedShare, missing_share, refused_share
from mbtool.troubles.failure_limits import are_damaged, is_grave, never_answers
from mbtool.troubles.odd_polling import odd_polling
from mbtool.troubles.refusals import always_refused, joint_refusals
from mbtool.troubles.slower_units import slow_and_slower_units
from mbtool.views.statistics_columns import StyledLine
from mbtool.views.statistics_words import per_second
from mbtool.views.trouble_words import (
    JOINED,
    TOGETHER_TEXT,
    Unit,
    exception_text,
    joined_oddities,
    joint_refusals_text,
    many_slow_text,
    many_slower_text,
    oddities_text,
    since_text,
    slow_text,
    slower_text,
    unit_name,
    units_text,
    worst_stray_frames,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.ledger.unit_times import UnitTimes

    ShareOf = Callable[[RequestTally, UnitTimes | None], FailedShare | None]

_BAD, _DOUBT = "red", "yellow"
_MOST_UNITS = 3
_MOST_ODDITIES = 3


def verdict(links: Sequence[LinkReport]) -> list[StyledLine]:
    """Return a line that sums up, then lines for each kind of trouble.

    Troubles are missing responses, exceptions, malformed and unsolicited responses, TCP resets,
    units that are slow or became slower, and what is odd in the polling. `report` and `watch` judge
    by the same limits.
    """
    total = merged([link.tally for link in links])
    if not total.transactions:
        return [StyledLine("no transactions so far", "bold")]
    lines = [StyledLine(_sum(links, total), "bold")]
    if not all(link.has_times for link in links):
        text = "! no times: the bytes of the file have none, so there are no rates and periods"
        lines.append(StyledLine(text, _DOUBT))
    if is_counted_together(links):
        lines.append(StyledLine(f"! {TOGETHER_TEXT}", _DOUBT))
    units = _Units(links)
    lines += _missing(links, units, total)
    lines += _exceptions(links, units, total)
    lines += _malformed(units)
    lines += _stray_frames(links)
    lines += _unasked(total)
    lines += _resets(links)
    lines += _slow(units)
    return [*lines, *_odd_polling(links, units)]


class _Units:
    """The counts of all units, and their names."""

    def __init__(self, links: Sequence[LinkReport]) -> None:
        self.tallies = unit_tallies(links)
        self.times = unit_times(links)
        self._several = len(links) > 1

    def name(self, unit: Unit) -> str:
        return unit_name(unit, several=self._several)

    def _times(self, unit: Unit, tally: RequestTally) -> UnitTimes | None:
        """Return the times of a unit's requests; None if it never answers, as all of them fail."""
        return None if never_answers(tally) else self.times.get(unit)

    def failing(self, share_of: ShareOf) -> _Failing:
        """Return the units with failures of a kind."""
        shares = {
            unit: share
            for unit, tally in self.tallies.items()
            if (share := share_of(tally, self._times(unit, tally))) is not None
        }
        grave = [
            unit
            for unit, share in shares.items()
            if share.is_grave or never_answers(self.tallies[unit])
        ]
        return _Failing(shares, grave)


class _Failing(NamedTuple):
    """The units with failures of one kind, and those that fail gravely."""

    shares: dict[Unit, FailedShare]
    grave: list[Unit]

    @property
    def style(self) -> str:
        return _BAD if self.grave else _DOUBT

    def worst(self, text_of: Callable[[Unit], str]) -> str:
        """Return the units with most failures as text: `40 of unit 3, 2 of unit 4 and 3 more`."""
        often = sorted(self.shares.items(), key=lambda one: -one[1].failed)
        return _listed(
            [f"{share.failed:,} of {text_of(unit)}{since_text(share)}" for unit, share in often]
        )


def _malformed_share(tally: RequestTally, times: UnitTimes | None) -> FailedShare | None:
    del times
    number = tally.count(Outcome.MALFORMED)
    return FailedShare(number, tally.requests) if number else None


def _sum(links: Sequence[LinkReport], total: RequestTally) -> str:
    watched_ns = links[0].all_watched_ns
    units = {(link.name, one.unit): one.device for link in links for one in link.functions}
    of = units_text(units)
    rate = per_second(total.requests * 1e9 / watched_ns if watched_ns else None)
    time = f" in {duration(watched_ns)} ({rate}/s)" if watched_ns else ""
    where = f"{counted(len(links), 'link', ',')}, {of}"
    if len(links) == 1:
        one = links[0]
        settings = f" {one.settings}" if one.settings else ""
        if len(units) == 1:
            ((_, unit), device) = next(iter(units.items()))
            of = f"unit {unit} {device or ''}".rstrip()
        where = f"{one.transport} {one.name}{settings}, {of}"
    return f"{where}: {counted(total.requests, 'request', ',')}{time}, {_answered(total)}"


def _answered(total: RequestTally) -> str:
    """Return the share of requests that were answered as text, such as `98 % answered`.

    Broadcasts, and requests whose outcome the capture does not show, are not counted.
    """
    answers = sum(total.count(one) for one in (Outcome.OK, Outcome.EXCEPTION, Outcome.MALFORMED))
    asked = answers + total.unanswered
    return f"{percent(answers / asked)} answered" if asked else "no request to be answered"


def _missing(links: Sequence[LinkReport], units: _Units, total: RequestTally) -> list[StyledLine]:
    if not total.unanswered:
        return []
    failing = units.failing(missing_share)
    damaged = {unit for unit, tally in units.tallies.items() if are_damaged(tally)}
    dead = [
        units.name(unit)
        for unit, tally in units.tallies.items()
        if never_answers(tally) and unit not in damaged
    ]
    lines = [StyledLine(f"! {_listed(dead)} never answered", _BAD)] if dead else []
    share = sum(link.load.spent.missing_ns for link in links if link.load is not None)
    watched = sum(link.watched_ns for link in links if link.load is not None)
    cost = f"; waiting took {percent(share / watched)} of the time" if share and watched else ""
    worst = failing.worst(
        lambda unit: units.name(unit) + (" with a wrong CRC" if unit in damaged else "")
    )
    repeated = sum(one.poll.repetitions for link in links for one in link.polls)
    again = f"; {repeated:,} asked again at once" if repeated else ""
    text = f"! {counted(total.unanswered, 'answer', ',')} missing: {worst}{again}{cost}"
    return [*lines, StyledLine(text, failing.style)]


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_UNITS} more" if len(names) > _MOST_UNITS else ""
    return ", ".join(names[:_MOST_UNITS]) + more


def _exceptions(
    links: Sequence[LinkReport], units: _Units, total: RequestTally
) -> list[StyledLine]:
    number = sum(total.exceptions.values())
    if not number:
        return []
    polls = unit_polls(links)
    failing = units.failing(refused_share)
    for unit, share in failing.shares.items():
        if always_refused(polls.get(unit, ()), units.tallies[unit]):
            # No beginning is told of requests that the unit refuses each time.
            failing.shares[unit] = share._replace(since_ns=None, until_ns=None)
    by_count = sorted(total.exceptions.items(), key=lambda one: -one[1])
    codes = ", ".join(
        f"{count:,} x {exception_text(code, total.exception_names[code])}"
        for code, count in by_count[:_MOST_UNITS]
    )
    rest = len(by_count) - _MOST_UNITS
    more = f" and {counted(rest, 'more code')}" if rest > 0 else ""
    joint = joint_refusals(failing.grave, units.tallies, polls)
    if joint is not None:
        text = f"! {counted(number, 'exception', ',')}: {codes}{more}"
        return [StyledLine(text, _BAD), StyledLine(f"! {joint_refusals_text(joint)}", _BAD)]
    text = f"! {counted(number, 'exception', ',')}: {failing.worst(units.name)}; {codes}{more}"
    return [StyledLine(text, failing.style)]


def _malformed(units: _Units) -> list[StyledLine]:
    failing = units.failing(_malformed_share)
    number = sum(share.failed for share in failing.shares.values())
    if not number:
        return []
    text = f"! {counted(number, 'answer', ',')} malformed: {failing.worst(units.name)}"
    return [StyledLine(text, failing.style)]


def _stray_frames(links: Sequence[LinkReport]) -> list[StyledLine]:
    of_links = [link for link in links if link.stray_frames > 0]
    texts = worst_stray_frames(
        {link.name: link.stray_frames for link in of_links}, most=_MOST_UNITS
    )
    grave = any(is_grave(link.stray_frames, link.tally.transactions) for link in of_links)
    return [StyledLine(f"! {text}", _BAD if grave else _DOUBT) for text in texts]


def _unasked(total: RequestTally) -> list[StyledLine]:
    lines = []
    unsolicited, lacking = total.count(Outcome.UNSOLICITED), total.count(Outcome.NOT_CAPTURED)
    if unsolicited:
        text = f"! {counted(unsolicited, 'answer', ',')} that nobody asked for"
        if total.unsolicited_exceptions:
            text = f"{text}, {total.unsolicited_exceptions:,} of them with an exception"
        lines.append(StyledLine(text, _DOUBT))
    if lacking:
        text = f"! {lacking:,} not captured whole: the capture's loss, not a device's fault"
        lines.append(StyledLine(text, _DOUBT))
    return lines


def _resets(links: Sequence[LinkReport]) -> list[StyledLine]:
    resets = sum(one.resets for link in links for _, one in link.connections)
    refused = sum(one.refused for link in links for _, one in link.connections)
    parts = [f"{resets:,} reset"] if resets else []
    parts += [f"{refused:,} refused"] if refused else []
    if not parts:
        return []
    word = plural(resets + refused, "connection")
    return [StyledLine(f"! {word}: {', '.join(parts)}", _DOUBT)]


def _slow(units: _Units) -> list[StyledLine]:
    """Return a line on each slow unit, then on each that became slower; if one of these are many
    (JOINED), one line on the worst of them.
    """
    slow, became_slower = slow_and_slower_units(
        {unit: tally.latency for unit, tally in units.tallies.items()}, units.times
    )
    medians = {unit: units.tallies[unit].latency.percentile(50) for unit in slow}
    texts = [
        slow_text(units.name(unit), medians[unit], slow[unit])
        for unit in sorted(slow, key=lambda unit: slow[unit] / medians[unit])
    ]
    if len(texts) >= JOINED:
        texts = [many_slow_text(len(texts), len(units.tallies), texts[0])]
    slower = sorted(became_slower.items(), key=lambda one: -one[1].factor)
    others = [slower_text(units.name(unit), one) for unit, one in slower]
    if len(others) >= JOINED:
        others = [many_slower_text(len(others), len(units.tallies), others[0])]
    return [StyledLine(f"! {text}", _DOUBT) for text in (*texts, *others)]


def _odd_polling(links: Sequence[LinkReport], units: _Units) -> list[StyledLine]:
    told = joined_oddities(odd_polling(links, units.tallies))
    return [
        StyledLine(f"! {oddities_text(some, units.name)}", _DOUBT) for some in told[:_MOST_ODDITIES]
    ]
