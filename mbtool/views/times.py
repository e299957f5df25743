"""Writes the times of table rows: the time of day (UTC or local), or seconds since another row."""

from __future__ import annotations

import time

from mbtool.core.moments import clock_time, day
from mbtool.views.table_options import TimeStyle


class Times:
    """Writes the time of each row; the rows must come in the order in which they are shown."""

    def __init__(self, style: TimeStyle) -> None:
        self._style = style
        self._origin_ns: int | None = None

    def text(self, ts_ns: int) -> str:
        """Return the time of a row that starts at `ts_ns` (UTC ns), at least 12 characters.

        Call this once for each row, in order.
        """
        match self._style:
            case TimeStyle.UTC:
                return clock_time(ts_ns)
            case TimeStyle.LOCAL:
                return clock_time(ts_ns + _offset_ns(ts_ns))
        since_ns = ts_ns if self._origin_ns is None else self._origin_ns
        if self._origin_ns is None or self._style is TimeStyle.DELTA:
            self._origin_ns = ts_ns
        return f"{(ts_ns - since_ns) / 1e9:+12.6f}"

    def day_of(self, ts_ns: int) -> str:
        """Return the day of a row that starts at `ts_ns` (UTC ns), with the time zone.

        The text is "" if rows show seconds instead.
        """
        match self._style:
            case TimeStyle.UTC:
                return f"{day(ts_ns)} UTC"
            case TimeStyle.LOCAL:
                return f"{day(ts_ns + _offset_ns(ts_ns))} local time"
        return ""


def _offset_ns(ts_ns: int) -> int:
    """Return local time minus UTC in ns at the time `ts_ns`; 0 if the system does not know it."""
    try:
        return time.localtime(ts_ns // 1_000_000_000).tm_gmtoff * 1_000_000_000
    except (ValueError, OverflowError, OSError):
        return 0
