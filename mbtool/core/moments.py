"""Reads the times that a user writes: dates with times of day, and times since a beginning."""

#     2026-11-22T09:14:03.201Z    a date and a time as ISO 8601; UTC if no zone is given
#     2026-11-22 09:14            the same; without a time of day, 00:00
#     90, 2.5, 90s, 1h30m, 250ms  a time since the beginning; without a unit, seconds

from __future__ import annotations

import re
from datetime import UTC, datetime
from decimal import Decimal
from typing import NamedTuple

from mbtool.core.errors import UsageError

MAX_NS = 2**63 - 1

SECOND_NS = 1_000_000_000
"""A second in ns."""
DAY_NS = 86_400 * SECOND_NS
"""A day in ns."""

_PLAIN = re.compile(r"[0-9]{1,10}(?:\.[0-9]{1,9})?")
_DURATION = re.compile(
    r"(?:(?P<d>[0-9.]+)d)?(?:(?P<h>[0-9.]+)h)?(?:(?P<m>[0-9.]+)m(?!s))?"
    r"(?:(?P<s>[0-9.]+)s)?(?:(?P<ms>[0-9.]+)ms)?"
)
_UNITS_NS = {"d": DAY_NS, "h": 3600 * SECOND_NS, "m": 60 * SECOND_NS, "s": SECOND_NS,
             "ms": 1_000_000}  # fmt: skip
_ISO = re.compile(r"(?P<whole>[0-9]{4}-[0-9]{2}-[0-9]{2}(?:[T ][0-9]{2}:[0-9]{2}(?::[0-9]{2})?)?)"
                  r"(?:\.(?P<fraction>[0-9]{1,9}))?(?P<zone>Z|[+-][0-9]{2}:[0-9]{2})?")  # fmt: skip
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class TimePoint(NamedTuple):
    """A time that the user gave in an option."""

    ns: int
    """The time in UTC ns if `is_absolute`; otherwise in ns since the beginning of the capture."""
    is_absolute: bool


def parse_moment(text: str, option: str) -> TimePoint:
    """Read a time that a user gave in an option.

    Raises UsageError, which names the option, for a text that is no time.
    """
    absolute_ns = parse_iso(text)
    if absolute_ns is not None:
        return TimePoint(absolute_ns, is_absolute=True)
    since_ns = _duration_ns(text)
    if since_ns is not None and since_ns <= MAX_NS:
        return TimePoint(since_ns, is_absolute=False)
    raise UsageError(
        f"{option} {text[:40]!r}: write seconds (2.5), a time such as 1h30m, "
        "or a moment such as 2026-11-22T09:14:03"
    )


def parse_duration(text: str, option: str, least_ns: int, most_ns: int) -> int:
    """Read a time such as `2.5` (seconds), `250ms` or `1h30m` that a user gave in an option, in ns.

    Raises UsageError, which names the option, for a text that is no such time, and for a time below
    `least_ns` or above `most_ns`.
    """
    ns = _duration_ns(text)
    if ns is None:
        raise UsageError(
            f"{option} {text[:40]!r}: write a time such as 2.5 (seconds), 250ms or 1h30m"
        )
    if ns < least_ns:
        raise UsageError(f"{option} {text[:40]}: is shorter than {least_ns / 1e6:g} ms, the least")
    if ns > most_ns:
        days = most_ns // _UNITS_NS["d"]
        raise UsageError(f"{option} {text[:40]}: is longer than {days:,} days, the most")
    return ns


def parse_iso(text: str) -> int | None:
    """Convert a time in ISO 8601 to UTC ns; None if the text has another form."""
    match = _ISO.fullmatch(text.strip())
    if match is None:
        return None
    text = match["whole"] if ":" in match["whole"] else f"{match['whole']}T00:00"
    try:
        whole = datetime.fromisoformat(text + (match["zone"] or "Z"))
    except ValueError:  # The date does not exist, such as month 13.
        return None
    since = whole - _EPOCH
    ns = int((match["fraction"] or "").ljust(9, "0"))
    return (since.days * 86_400 + since.seconds) * SECOND_NS + ns


def _duration_ns(text: str) -> int | None:
    """Convert a duration such as `90`, `2.5` or `1h30m` to ns; None for other texts."""
    if _PLAIN.fullmatch(text):
        return int(Decimal(text) * SECOND_NS)
    match = _DURATION.fullmatch(text) if len(text) <= 40 else None
    parts = {} if match is None else {key: one for key, one in match.groupdict().items() if one}
    if not parts or not all(_PLAIN.fullmatch(one) for one in parts.values()):
        return None
    return int(sum(Decimal(one) * _UNITS_NS[key] for key, one in parts.items()))
