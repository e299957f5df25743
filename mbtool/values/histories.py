"""The words that a slave's registers had over time, as `judging.py` looks at them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.values.judging import WordHistory

if TYPE_CHECKING:
    from mbtool.devices.observed_slave import ObservedSlave


def histories_of(seen: ObservedSlave) -> list[WordHistory]:
    """Return the histories of a slave's registers; it must have been observed with values."""
    return [
        WordHistory(
            request.table,
            request.span.start,
            list(samples.times_ns),
            list(samples.rows),
            answers=samples.count,
            is_written=request.writes,
        )
        for request, samples in seen.samples.items()
        if request.table is not None
    ]
