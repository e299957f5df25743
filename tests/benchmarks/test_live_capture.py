"""The live capture's benchmark, run for a moment where namespaces may be made."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.benchmarks.live_capture import Result, measure, report
from tests.end_to_end.namespaces import cable, why_not

if TYPE_CHECKING:
    from pathlib import Path


def test_a_loss_is_exact_where_it_was_told() -> None:
    told = Result("mbtool", 10, sent=100, sent_s=10.0, captured=90, told=10)
    silent = Result("mbtool", 20, sent=100, sent_s=10.0, captured=90, told=0)
    assert (told.is_exact, told.is_reached) == (True, True)
    assert (silent.is_exact, silent.is_reached) == (False, False)
    lines = report([told, silent]).splitlines()
    assert lines[1].endswith("exactly")
    assert lines[2].endswith("WRONGLY; the sender was slower")


def test_every_packet_is_in_the_log_or_told_as_lost(tmp_path: Path) -> None:
    reason = why_not()
    if reason is not None:
        pytest.skip(reason)
    with cable() as ends:
        result = measure(ends, "mbtool", 2000, 0.5, tmp_path)
    assert result.sent == 1000
    assert result.is_exact
