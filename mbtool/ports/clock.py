"""The clocks of whatever is live: UTC in nanoseconds since 1970."""

from __future__ import annotations

import time
from time import time_ns as now_ns  # noqa: TID251 - live bytes get their time here
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["now_ns", "steady_clock"]


def steady_clock() -> Callable[[], int]:
    """A clock that never steps back: UTC when this is called, from then on the monotonic clock.

    A slave measures silences and delays with it, so setting the system's clock must not move it.
    """
    anchor_ns = time.time_ns() - time.monotonic_ns()  # noqa: TID251 - this is a clock
    return lambda: anchor_ns + time.monotonic_ns()
