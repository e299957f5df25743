"""Types and values of devices whose makers or users published what their registers hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import parse_line
from mbtool.devices.point_types import PointType, WordOrder
from mbtool.values.draft import draft_profile
from mbtool.workflows.shared.observed_slaves import ObservedSlaves
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.printed_frames import as_byte_times

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.public_captures

METER = "ZZ_text_logs/otti__FroniusModbusRtu/20230228_record.txt"


def meter(public_captures: Path, tmp_path: Path) -> Path:
    """The recording of an energy meter, as CSV with the times of its bytes."""
    path = tmp_path / "meter.csv"
    path.write_text(as_byte_times((public_captures / METER).read_text()))
    return path


def test_the_draft_of_the_energy_meter_has_its_37_numbers_of_32_bits(
    public_captures: Path, tmp_path: Path
) -> None:
    slaves = ObservedSlaves(with_values=True)
    options = ReadingOptions(line=parse_line("rtu@19200-8E1"))
    slaves.add(Reading([str(meter(public_captures, tmp_path))], options).records())
    profile = draft_profile(slaves.only("--unit"), "meter", "meter.csv").profile
    addresses = [*range(258, 274, 2), *range(286, 328, 2), *range(1024, 1040, 2)]
    assert [(one.address, one.type, one.word_order) for one in profile.points] == [
        (address, PointType.INT32, WordOrder.LOW_FIRST) for address in addresses
    ]
