"""The clock of the slaves."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from mbtool.ports.clock import steady_clock

if TYPE_CHECKING:
    import pytest


def test_tells_utc_and_never_steps_back() -> None:
    clock = steady_clock()
    before = time.time_ns()
    times = [clock() for _ in range(1000)]
    assert times == sorted(times)
    assert abs(times[0] - before) < 1_000_000_000


def test_does_not_follow_a_clock_that_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = steady_clock()
    before = clock()
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    assert 0 <= clock() - before < 10_000_000_000
