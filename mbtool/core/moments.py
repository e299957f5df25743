"""Reads the times that a user writes: dates with times of day, and times since a beginning."""

#     2026-11-22T09:14:03.201Z    a date and a time as ISO 8601; UTC if no zone is given
#     2026-11-22 09:14            the same; without a time of day, 00:00
#     90, 2.5, 90s, 1h30m, 250ms  a time since the beginning; without a unit, seconds

from __future__ import annotations

import re
from datetime import UTC, date, datetime, timedelta
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


# The code below writes counts, durations, shares and times as text, for messages and tables.

_YEAR_1980_NS = 315_532_800_000_000_000
_EPOCH_DAY = date(1970, 1, 1).toordinal()
_MINUTE_S, _HOUR_S, _DAY_S = 60, 3600, 86_400


def counted(count: int, noun: str, separator: str = ",") -> str:
    """A count and its noun: `1 packet`, `2,000 packets`. The separator stands between thousands."""
    return f"{count:{separator}} {plural(count, noun)}"


def plural(count: int, noun: str) -> str:
    """A noun in singular form, with an "s" added unless the count is 1."""
    return noun if count == 1 else f"{noun}s"


def milliseconds(ns: float) -> str:
    """A duration in ns as a text in ms with one decimal: 8_249_999 becomes `8.2 ms`."""
    return f"{ns / 1e6:.1f} ms"


def in_ms(ns: float) -> str:
    """Write a duration (ns) in ms with at least two significant digits: 0.25, 8.2, 82.1, 1240."""
    ms = ns / 1e6
    if ms < 0.995:
        return f"{ms:.2f}"
    return f"{ms:.1f}" if ms < 99.95 else f"{ms:.0f}"


def in_s(ns: float) -> str:
    """Write a duration (ns) in s with at least three significant digits: 0.251, 12.00, 3600."""
    seconds = ns / 1e9
    if seconds < 9.9995:
        return f"{seconds:.3f}"
    return f"{seconds:.2f}" if seconds < 999.5 else f"{seconds:.0f}"


def duration(ns: float) -> str:
    """Write a duration (ns) with its unit: 8.2 ms, 1.02 s, 2 min 3 s, 3 h 12 min, 2 d 3 h."""
    seconds = ns / 1e9
    if seconds < 0.9995:
        return f"{in_ms(ns)} ms"
    if seconds < _MINUTE_S:
        return f"{seconds:.2f} s" if seconds < 9.995 else f"{seconds:.1f} s"
    whole = round(seconds)
    for unit_s, unit, next_s, next_unit in (
        (_DAY_S, "d", _HOUR_S, "h"),
        (_HOUR_S, "h", _MINUTE_S, "min"),
        (_MINUTE_S, "min", 1, "s"),
    ):
        if whole >= unit_s:
            rest = whole % unit_s // next_s
            return f"{whole // unit_s:,} {unit}" + (f" {rest} {next_unit}" if rest else "")
    return f"{whole} s"


def percent(share: float) -> str:
    """Write a share of 0 to 1 in percent: 34 %, 3.4 %. Only 1 gives 100 %, and only 0 gives 0 %."""
    if 0 < share < 0.001:
        return "<0.1 %"
    if 0.999 < share < 1:
        return ">99.9 %"
    hundredths = share * 100
    is_whole = share in (0, 1) or 10 <= hundredths < 99
    return f"{hundredths:.0f} %" if is_whole else f"{hundredths:.1f} %"


def clock_time(ts_ns: int) -> str:
    """Write the time of day in UTC, with milliseconds: `09:14:03.300`.

    Never raises: a capture may have any integer as its time.
    """
    seconds, milliseconds = divmod(ts_ns // 1_000_000, 1000)
    minutes, second = divmod(seconds % _DAY_S, 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}.{milliseconds:03d}"


def moment(ts_ns: int) -> str:
    """Write date and time in UTC, with milliseconds: `2026-11-21 09:14:03.300`.

    Times before 1980 are those of a clock that counts from 0, and get no date.
    """
    is_dated = not 0 <= ts_ns < _YEAR_1980_NS
    return f"{day(ts_ns)} {clock_time(ts_ns)}" if is_dated else clock_time(ts_ns)


def utc_time(ts_ns: int) -> datetime:
    """Return a time in UTC ns as datetime, rounded down to microseconds."""
    return _EPOCH + timedelta(microseconds=ts_ns // 1000)


def day(ts_ns: int) -> str:
    """Write the date in UTC: `2026-11-21`.

    Outside the years 1 to 9999 it is the number of days since 1970.
    """
    days = ts_ns // (_DAY_S * 1_000_000_000)
    try:
        return date.fromordinal(_EPOCH_DAY + days).isoformat()
    except (ValueError, OverflowError):
        return f"day {days}"


def host_of(address: str | None) -> str:
    """Return the host of an address: `fe80::1` for `[fe80::1]:502`, `10.0.0.9` for `10.0.0.9` and
    `10.0.0.9:502`; "" for None.
    """
    if address is None:
        return ""
    if address.startswith("["):
        return address[1:].partition("]")[0]
    return address.rpartition(":")[0] or address
