"""The clock of the shells: UTC nanoseconds that never step back."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


def steady_clock() -> Callable[[], int]:
    """A clock anchored to UTC once, then driven by the monotonic one.

    Silences and delays are measured with it, so a corrected system clock must not move it.
    """
    anchor_ns = time.time_ns() - time.monotonic_ns()  # noqa: TID251 - a shell owns a clock
    return lambda: anchor_ns + time.monotonic_ns()
