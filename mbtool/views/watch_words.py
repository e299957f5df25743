"""Writes short texts for live tables: ages, counts, latencies, sparklines, exceptions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.modbus.functions import ExceptionCode
from mbtool.views.cells import short_exception

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

FRESH_NS = 1_000_000_000
"""A value that changed less than this ago, in ns, is shown most clearly."""
RECENT_NS = 5_000_000_000
"""A value that changed less than this ago, in ns, is still shown as changed."""
OVERDUE = 3
"""A poll (repeated request) is overdue if it was not sent for this many of its periods."""
_BARS = "▁▂▃▄▅▆▇█"
_STANDARD_CODES = frozenset(ExceptionCode)
MISSING = "x"
"""A sparkline shows this character for a request without a response."""


def age(ns: int) -> str:
    """Write the time since something (ns) in at most 4 characters: 0.4s, 59s, 12m, 3h, 2d."""
    seconds = max(ns, 0) / 1e9
    if seconds < 9.95:
        return f"{seconds:.1f}s"
    if seconds < 99.5:
        return f"{seconds:.0f}s"
    minutes = seconds / 60
    if minutes < 99.5:
        return f"{minutes:.0f}m"
    hours = minutes / 60
    return f"{hours:.0f}h" if hours < 99.5 else f"{hours / 24:.0f}d"


def period(ns: int) -> str:
    """Write a period (ns) in at most 5 characters: 8ms, 250ms, 1.50s, 12.0s, 20m; `-` for 0."""
    if not ns:
        return "-"
    if ns < 999_500_000:
        return f"{ns / 1e6:.0f}ms"
    seconds = ns / 1e9
    if seconds < 9.995:
        return f"{seconds:.2f}s"
    return f"{seconds:.1f}s" if seconds < 99.95 else age(ns)


def count(number: int) -> str:
    """Write a count in at most 5 characters: 99999, 123k, 12.3M; empty for 0."""
    if not number:
        return ""
    if number < 100_000:
        return str(number)
    if number < 1_000_000:
        return f"{number // 1000}k"
    millions = number / 1e6
    return f"{millions:.1f}M" if millions < 99.95 else f"{millions:.0f}M"


def in_table_words(one: NamedTransaction) -> NamedTransaction:
    """Return a transaction with the words that live tables use.

    An exception code of the standard has the standard's short name, whatever the profile of the
    slave calls it, so that a code has one name in all rows. The number of equal requests before it
    is left out, as it also counts those of a slave that is polled at its usual period.
    """
    code = one.exception
    if not one.retries and code is None:
        return one
    is_known = code is not None and code in _STANDARD_CODES
    name = short_exception(code) if code is not None and is_known else one.exception_name
    return replace(one, retries=0, exception_name=name)


def sparkline(values: Sequence[float | None], width: int) -> str:
    """Draw the last `width` values as bars: a low one for the least, a high one for the greatest.

    An x stands for None, which is a request without a response, and for a number that is not
    finite.
    """
    shown = [*values][-width:]
    numbers = [one for one in shown if one is not None and one == one and abs(one) != float("inf")]
    low, high = (min(numbers), max(numbers)) if numbers else (0, 0)
    text = ""
    for one in shown:
        if one is None or one != one or abs(one) == float("inf"):
            text += MISSING
        elif high == low:
            text += _BARS[0]
        else:
            text += _BARS[min(int((one - low) / (high - low) * len(_BARS)), len(_BARS) - 1)]
    return text


def change_style(changed_ns: int, now_ns: int) -> str:
    """Return the style for a value by the time since it changed: the colour fades within seconds.

    Times are in ns since 1970; `changed_ns` 0 means that it never changed.
    """
    if not changed_ns:
        return ""
    since_ns = now_ns - changed_ns
    if since_ns < FRESH_NS:
        return "bold reverse"
    return "bold yellow" if since_ns < RECENT_NS else ""
