"""Values of a capture, for a slave that repeats them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.core import CutError, InputError, Quiet, UsageError
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer, load_profile
from mbtool.logs import LogWriter
from mbtool.modbus import Table
from mbtool.slave.device import FromCapture
from mbtool.workflows.shared.recorded_values import recorded_values
from tests.workflows.evidence import LINE, MS, capture_file, heard

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from mbtool.decode.decoder import Evidence

TOUCH = load_profile("idec-ft1a-touch")
READ = bytes.fromhex("03 0000 0002")
S = 1_000_000_000


def _log(path: Path, units: Iterable[int] = (1,), links: Iterable[str] = (LINE.name,)) -> Path:
    """A read of two registers in each of four seconds; the second one counts up from 10."""
    with LogWriter(path, capture={}) as log:
        for link in links:
            log.add_link(link, {"spec": str(LINE)})
            decoder = Decoder(Namer(), lines={link: LINE})
            for second in range(4):
                for unit in units:
                    values = bytes.fromhex(f"03 04 1234 {second + 10:04X}")
                    at_ms = 1000 * second + 200 * unit
                    chunks = [
                        heard(at_ms, READ, unit, link),
                        heard(at_ms + 20, values, unit, link),
                    ]
                    items: list[Evidence] = [*chunks, Quiet(chunks[1].ts_ns + 100 * MS, link)]
                    for item in items:
                        for record in decoder.feed(item):
                            log.write(record)
    return path


def _wanted(path: Path) -> FromCapture:
    return FromCapture(path, Table.HOLDING_REGISTERS, 1, 1, None, None, 1.0, True)


def test_a_value_is_what_was_last_seen_at_that_moment(tmp_path: Path) -> None:
    course = recorded_values(TOUCH)(_wanted(_log(tmp_path / "a.mcap")))
    assert [course(round(second * S)) for second in (0, 0.9, 1.1, 2.5, 3)] == [
        [10],
        [10],
        [11],
        [12],
        [12],
    ]


def test_it_begins_again_or_stays_and_goes_faster(tmp_path: Path) -> None:
    wanted = _wanted(_log(tmp_path / "a.mcap"))
    recall = recorded_values(TOUCH)
    assert recall(wanted)(4 * S) == [10]
    assert recall(replace(wanted, loop=False))(1000 * S) == [13]
    assert recall(replace(wanted, speed=2.0))(round(1.25 * S)) == [12]


def test_several_registers_are_taken_together(tmp_path: Path) -> None:
    wanted = replace(_wanted(_log(tmp_path / "a.mcap")), address=0, words=2)
    assert recorded_values(TOUCH)(wanted)(2 * S + 500 * MS) == [0x1234, 12]


def test_which_unit_and_which_link_must_be_said_where_there_are_several(tmp_path: Path) -> None:
    wanted = _wanted(_log(tmp_path / "a.mcap", (1, 2), ("left", "right")))
    recall = recorded_values(TOUCH)
    with pytest.raises(UsageError, match=r"a\.mcap has the units 1, 2; write one, as unit = 1"):
        recall(wanted)
    with pytest.raises(UsageError, match="has unit 2 on left, right; write one, as link = 'left'"):
        recall(replace(wanted, unit=2))
    assert recall(replace(wanted, unit=2, link="right"))(0) == [10]


def test_what_a_capture_does_not_hold_is_refused(tmp_path: Path) -> None:
    wanted = _wanted(_log(tmp_path / "a.mcap"))
    recall = recorded_values(TOUCH)
    with pytest.raises(UsageError, match=r"a\.mcap holds no value of HR400008 of unit 1"):
        recall(replace(wanted, address=7))
    with pytest.raises(UsageError, match="holds no value of HR400002 of unit 9"):
        recall(replace(wanted, unit=9))
    with pytest.raises(InputError, match="absent"):
        recall(replace(wanted, path=tmp_path / "absent.mcap"))


def test_of_a_cut_capture_what_is_there_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcap"
    path.write_bytes(capture_file()[:-1])
    told: list[str] = []
    course = recorded_values(TOUCH, told.append)(_wanted(path))
    assert course(0) == [0x5678]
    assert len(told) == 1
    assert told[0].endswith("; taking what is there")
    assert issubclass(CutError, InputError)
