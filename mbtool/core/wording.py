"""Writes counts, durations, shares and times as text, for messages and tables."""

from __future__ import annotations

from datetime import date

_EPOCH = date(1970, 1, 1).toordinal()
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


def day(ts_ns: int) -> str:
    """Write the date in UTC: `2026-11-21`.

    Outside the years 1 to 9999 it is the number of days since 1970.
    """
    days = ts_ns // (_DAY_S * 1_000_000_000)
    try:
        return date.fromordinal(_EPOCH + days).isoformat()
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
