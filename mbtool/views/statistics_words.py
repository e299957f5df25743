"""Writes the figures of statistics as text: rates, counts and polls."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus import short_name

if TYPE_CHECKING:
    from mbtool.ledger.poll_statistics import PollStatistics


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
