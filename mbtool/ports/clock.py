"""The clocks of live captures, taps and slaves: UTC in nanoseconds since 1970."""

from __future__ import annotations

import time
from time import monotonic_ns
from time import time_ns as now_ns  # noqa: TID251 - the clock for bytes that are captured live
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["monotonic_ns", "now_ns", "steady_clock"]


def steady_clock() -> Callable[[], int]:
    """Return a clock that starts at the present UTC and then follows the monotonic clock.

    It never steps back. A slave uses it to measure silences and delays, which must not change when
    somebody sets the system's clock.
    """
    anchor_ns = time.time_ns() - time.monotonic_ns()  # noqa: TID251 - this is a clock
    return lambda: anchor_ns + time.monotonic_ns()
