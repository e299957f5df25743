"""Writes the troubles that `stats`, `report` and `watch` tell in the same words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.wording import clock_time, counted, day, duration, in_ms
from mbtool.ledger.statistics import MAX_GROUPS, MAX_LINKS, OTHER_UNITS
from mbtool.modbus import Outcome
from mbtool.troubles.odd_polling import LateUnit, Oddity, PollingPause, ShortConnections

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from mbtool.ledger.request_tally import RequestTally
    from mbtool.troubles.failed_shares import FailedShare
    from mbtool.troubles.refusals import JointRefusals
    from mbtool.troubles.slower_units import Slower

Unit = tuple[str, int]
"""Link and unit."""
JOINED = 3
"""At least so many slow units, or oddities of one kind, are told as one."""


TOGETHER_TEXT = (
    f"there are more than {MAX_GROUPS:,} pairs of unit and function, or {MAX_LINKS:,} links: "
    "others are counted together, and figures of single units may be too small"
)


def units_text(units: Collection[Unit]) -> str:
    """Return the number of units as text: `40 units`, or `at least 40 units` where some are counted
    together.
    """
    known = sum(number != OTHER_UNITS for _, number in units)
    least = "at least " if known < len(units) else ""
    return f"{least}{counted(known, 'unit', ',')}"


def unit_name(unit: Unit, *, several: bool) -> str:
    """Return a unit as text: `unit 4`, with the link if there are `several` links."""
    link, number = unit
    name = "other units" if number == OTHER_UNITS else f"unit {number}"
    return f"{name} at {link or 'other links'}" if several else name


def since_text(share: FailedShare) -> str:
    """Return the time of failures: ` since 10:43:02`, ` from 10:43:02 to 10:51:10` or empty."""
    since, until = (
        None if ns is None else moment_text(ns, is_long=share.is_long)
        for ns in (share.since_ns, share.until_ns)
    )
    if until is None:
        return "" if since is None else f" since {since}"
    return f" until {until}" if since is None else f" from {since} to {until}"


def moment_text(ns: int, *, is_long: bool) -> str:
    """Return a time of day with seconds; if the capture `is_long`, with the date, to the minute."""
    return f"{day(ns)} {clock_time(ns)[:5]}" if is_long else clock_time(ns)[:8]


def slow_text(name: str, own_ns: float, usual_ns: float) -> str:
    text = f"{name} is slow: half of its answers take {in_ms(own_ns)} ms or more, "
    return f"{text}those of the others {in_ms(usual_ns)} ms"


def many_slow_text(slow: int, units: int, worst: str) -> str:
    """Return how many of the `units` are slow; `worst` has the text for the slowest one."""
    return f"{slow} of {units} units are slow; {worst}"


def slower_text(name: str, slower: Slower) -> str:
    since = moment_text(slower.since_ns, is_long=slower.is_long)
    text = f"{name} answers slower since {since}: in {in_ms(slower.mean_ns)} ms on average"
    return f"{text}, before in {in_ms(slower.before_ns)} ms"


def many_slower_text(slower: int, units: int, worst: str) -> str:
    """Return how many of the `units` became slower; `worst` has the text for the worst one."""
    return f"{slower} of {units} units became slower; {worst}"


def joint_refusals_text(joint: JointRefusals, codes: str = "", *, is_short: bool = False) -> str:
    """Return which units refuse how many requests, and if that looks like a scan.

    `codes` has the exception codes as text. With `is_short`, the text does not say who scans.
    """
    some = f"all {joint.of}" if joint.units == joint.of else f"{joint.units} of {joint.of}"
    refused, asked = joint.tally.count(Outcome.EXCEPTION), joint.tally.requests
    share = f"all their requests ({asked:,})"
    if refused < asked:
        share = f"{refused:,} of their {counted(asked, 'request', ',')}"
    text = f"{some} units refuse {share}{f', {codes}' if codes else ''}"
    if not joint.scanned:
        return text
    by = f" by {joint.master}" if joint.master and not is_short else ""
    return f"{text}: {joint.scanned:,} different ones, as in a scan{by}"


def codes_text(tally: RequestTally) -> str:
    """Return the exception code of most refusals in words, or the two most frequent codes."""
    total = sum(tally.exceptions.values())
    if not total:
        return "with unknown codes"  # Only a log that another program wrote lacks them.
    often = sorted(tally.exceptions, key=lambda one: -tally.exceptions[one])
    first, *others = (exception_text(code, tally.exception_names[code]) for code in often)
    if not others:
        return f"with {first}"
    if tally.exceptions[often[0]] * 2 > total:
        return f"mostly with {first}"
    return f"with {first}{f', {others[0]} or others' if len(others) > 1 else f' or {others[0]}'}"


def exception_text(code: int, name: str) -> str:
    """Return code and name, such as `02 illegal data address`.

    The name of an unknown code has the number in it, so the name alone is returned.
    """
    return name if name.startswith("exception") else f"{code:02X} {name}".rstrip()


def stray_frames_text(link: str, number: int) -> str:
    frames = counted(number, "frame", ",")
    return f"{link} has {frames} with a wrong CRC that no unit can be blamed for"


def worst_stray_frames(frames: Mapping[str, int], *, most: int) -> list[str]:
    """Return texts on the `most` links with most damaged frames of no known unit, and a last one on
    how many more links have some. `frames` has their numbers by link.
    """
    worst = sorted(frames.items(), key=lambda one: -one[1])
    texts = [stray_frames_text(link, number) for link, number in worst[:most]]
    more = len(worst) - len(texts)
    return [*texts, f"{counted(more, 'more link', ',')} with such frames"] if more > 0 else texts


def oddity_text(
    one: Oddity[Unit], name_of: Callable[[Unit], str], *, is_short: bool = False
) -> str:
    """Return what is odd in the polling. `name_of` returns a unit as text.

    With `is_short`, the text leaves out what is usual, and the link whose polling paused.
    """
    match one:
        case LateUnit():
            longest = duration(one.longest_ns)
            after = f"after {longest}" if one.number == 1 else f"the longest after {longest}"
            text = f"{name_of(one.unit)} gives {counted(one.number, 'answer', ',')} late, {after}"
            usual = f"usually {in_ms(one.usual_ns)} ms"
        case PollingPause():
            longest = duration(one.longest_ns)
            how = f"{one.number:,} times, for up to {longest}"
            how = f"for {longest}" if one.number == 1 else how
            of = f" of {one.link}" if one.master and not is_short else ""
            text = f"{one.master or one.link} paused a poll{of} {how}"
            usual = f"usually every {duration(one.usual_ns)}"
        case ShortConnections():
            text = f"{one.master or 'masters'} opened {one.opened:,} TCP connections to "
            text += f"{one.link} for {counted(one.requests, 'request', ',')}"
            usual = "one could stay open"
    return text if is_short else f"{text} ({usual})"


def joined_oddities(kinds: Sequence[Sequence[Oddity[Unit]]]) -> list[list[Oddity[Unit]]]:
    """Return oddities as they are told, those that cost most time first.

    `kinds` has the oddities by kind. If those of a kind are many (JOINED), they are one list, the
    worst first; else each is a list of its own.
    """
    told = []
    for kind in kinds:
        by_cost = sorted(kind, key=lambda one: -one.lost_s)
        told += [by_cost] if len(by_cost) >= JOINED else [[one] for one in by_cost]
    return sorted(told, key=lambda some: -sum(one.lost_s for one in some))


def oddities_text(
    some: Sequence[Oddity[Unit]], name_of: Callable[[Unit], str], *, is_short: bool = False
) -> str:
    """Return one list of `joined_oddities` as text: the worst, and how many more there are."""
    text = oddity_text(some[0], name_of, is_short=is_short)
    more = len(some) - 1
    return f"{text}, and {counted(more, f'more {_noun(some)}', ',')}" if more else text


def _noun(some: Sequence[Oddity[Unit]]) -> str:
    """Return what differs between oddities of one kind: `unit`, `link` or `master`."""
    owners = [(one.link, one.master) for one in some if not isinstance(one, LateUnit)]
    if not owners:
        return "unit"
    if len({link for link, _ in owners}) == len(some):
        return "link"
    return "master" if len({master for _, master in owners}) == len(some) else "case"
