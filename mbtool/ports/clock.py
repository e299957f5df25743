"""The one clock of the live sources: UTC in nanoseconds."""

from __future__ import annotations

from time import time_ns as now_ns  # noqa: TID251 - a source is where time comes from

__all__ = ["now_ns"]
