"""Writes the figures of statistics as text: durations, shares, rates, counts and polls."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus import short_name

if TYPE_CHECKING:
    from mbtool.ledger.poll_statistics import PollStatistics

_MINUTE_S, _HOUR_S, _DAY_S = 60, 3600, 86_400


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


def per_second(rate: float | None) -> str:
    """Write a rate per second: 39.1, 0.25, 0.0012; `-` for None."""
    if rate is None:
        return "-"
    if rate >= 99.95:
        return f"{rate:.0f}"
    return f"{rate:.1f}" if rate >= 0.995 else f"{rate:.2g}"


def counted(number: int) -> str:
    """Write a count for a cell of a table; a 0 gives an empty cell."""
    return f"{number:,}" if number else ""


def poll_text(poll: PollStatistics) -> str:
    """Return unit, function code and reference of a repeated request: `1 03 HR400001..400004`."""
    return f"{poll.key.unit} {request_text(poll)}"


def request_text(poll: PollStatistics) -> str:
    """Return function code and reference of a repeated request: `03 HR400001..400004`."""
    key = poll.key
    what = poll.reference or short_name(key.function, poll.function_name)
    if not poll.reference and key.sub_function is not None:
        what = f"{what} {key.sub_function:02X}"
    return f"{key.function:02X} {what}"
