"""The whole loop on this machine."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError, UsageError, WireEvent
from mbtool.modbus import Outcome
from mbtool.workflows.demo import MODULE_UNIT, TOUCH_UNIT, Demo, module_requests, touch_requests
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.records import without_origins

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.decode.decoder import Record


ASKED = len(touch_requests()) + len(module_requests())


def _recorded(folder: Path) -> tuple[Demo, list[Record], Path]:
    """A run in which each request was answered when it was first asked.

    A virtual line keeps to real time: if a busy machine stops it in the middle of a frame for
    longer than a slave waits for the rest, the request is lost, as on a real line, and asked again.
    """
    for number in range(5):
        path = folder / f"{number}.mcap"
        run = Demo(str(path))
        with suppress(LinkError):
            records = list(run.record())
            if sum(not isinstance(one, WireEvent) for one in records) == ASKED:
                return run, records, path
    pytest.fail("a request was lost in each of five runs")


def test_the_log_answers_as_the_devices_did(tmp_path: Path) -> None:
    run, records, path = _recorded(tmp_path)
    transactions = [one for one in records if not isinstance(one, WireEvent)]
    assert {one.device for one in transactions} == {"idec-ft1a-touch", "fa3-at1m8x"}
    assert [one.unit for one in transactions].count(TOUCH_UNIT) == len(touch_requests())
    assert [one.unit for one in transactions].count(MODULE_UNIT) == len(module_requests())
    refused = [one for one in transactions if one.outcome is not Outcome.OK]
    assert [(one.exception, one.findings) for one in refused] == [
        (2, ["FA3-A3"]),
        (2, ["FT1A-Q16"]),
    ]
    assert without_origins(Reading([str(path)], ReadingOptions()).records()) == records
    agreement = run.replay()
    assert (agreement.asked, agreement.differences) == (ASKED, ())


def test_a_log_that_is_there_stays(tmp_path: Path) -> None:
    path = tmp_path / "demo.mcap"
    path.write_text("mine")
    with pytest.raises(UsageError, match="the file exists"):
        list(Demo(str(path)).record())
    assert path.read_text() == "mine"
