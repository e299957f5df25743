"""Types and values of devices whose makers or users published what their registers hold."""

from __future__ import annotations

import json
import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import parse_line
from mbtool.devices.point_types import PointType, WordOrder
from mbtool.values.draft import draft_profile
from mbtool.values.judging import judge
from mbtool.values.sightings import parse_seen, wanted_of
from mbtool.values.value_series import histories_of
from mbtool.values.word_readings import Order
from mbtool.workflows.find import Finder
from mbtool.workflows.shared.observed_slaves import ObservedSlaves
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.adversary.values.sure import METER as METER_FILE
from tests.adversary.values.sure import captures, slaves_of, sure_values
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


SHOWN = {
    "Current_AC_Phase_1": 290, "Current_AC_Phase_2": 304, "Current_AC_Phase_3": 318,
    "Frequency_Phase_Average": 272,
    "PowerApparent_S_Phase_1": 294, "PowerApparent_S_Phase_2": 308,
    "PowerApparent_S_Phase_3": 322, "PowerApparent_S_Sum": 264,
    "PowerFactor_Phase_1": 298, "PowerFactor_Phase_2": 312, "PowerFactor_Phase_3": 326,
    "PowerFactor_Sum": 268,
    "PowerReactive_Q_Phase_1": 296, "PowerReactive_Q_Phase_2": 310,
    "PowerReactive_Q_Phase_3": 324, "PowerReactive_Q_Sum": 266,
    "PowerReal_P_Phase_1": 292, "PowerReal_P_Phase_2": 306, "PowerReal_P_Phase_3": 320,
    "PowerReal_P_Sum": 262,
    "Voltage_AC_PhaseToPhase_12": 286, "Voltage_AC_PhaseToPhase_23": 300,
    "Voltage_AC_PhaseToPhase_31": 314,
    "Voltage_AC_Phase_1": 288, "Voltage_AC_Phase_2": 302, "Voltage_AC_Phase_3": 316,
}  # fmt: skip
"""The numbers of the inverter's own JSON that one pair of registers holds, and its address."""


@pytest.mark.parametrize("order", ["as in the JSON", "mixed"])
def test_the_numbers_that_the_inverter_told_are_found(
    public_captures: Path, tmp_path: Path, order: str
) -> None:
    told = json.loads((public_captures / METER).with_name("20230228_fronius_api.json").read_text())
    data = told["Body"]["Data"]
    names = list(SHOWN)
    if order == "mixed":
        random.Random(5).shuffle(names)
    finder = Finder()
    options = ReadingOptions(line=parse_line("rtu@19200-8E1"))
    finder.add(Reading([str(meter(public_captures, tmp_path))], options).records())
    seen = [parse_seen(f"{name}={data[name]:.6g}") for name in names]
    places = finder.places(wanted_of(seen, finder.first_ns))
    ranks = []
    for name, own in zip(names, places, strict=True):
        addresses = list(dict.fromkeys(place.address for place in own))
        ranks.append(addresses.index(SHOWN[name]) + 1 if SHOWN[name] in addresses else 99)
    assert sum(rank == 1 for rank in ranks) >= 20
    assert sum(rank <= 3 for rank in ranks) >= (26 if order != "mixed" else 25)


PLC4X = {
    3: (PointType.UINT32, 2), 5: (PointType.UINT64, 4), 13: (PointType.INT32, 2),
    15: (PointType.UINT32, 2), 17: (PointType.INT64, 4), 21: (PointType.UINT64, 4),
    25: (PointType.FLOAT32, 2), 27: (PointType.FLOAT64, 4),
}  # fmt: skip
"""What holding registers of PLC4X's manual test hold, by its public source."""


def test_nothing_is_sure_that_the_map_of_the_test_plc_contradicts(public_captures: Path) -> None:
    slaves = ObservedSlaves(with_values=True)
    capture = public_captures / "apache__plc4x" / "modbus__tcp__manual-test-capture.pcapng"
    slaves.add(Reading([str(capture)], ReadingOptions()).records())
    inside = {
        at: first for first, (_, words) in PLC4X.items() for at in range(first, first + words)
    }
    for one in judge(histories_of(slaves.only("--unit"))):
        if one.is_sure and one.address in inside:
            type_, words = PLC4X[inside[one.address]]
            assert (inside[one.address], one.words) == (one.address, words), one
            assert one.reading.type in (type_, PointType("u" + type_) if type_[0] == "i" else type_)


MAPS = {
    METER_FILE: {
        (address, PointType.INT32, Order.CDAB)
        for address in (*range(258, 274, 2), *range(286, 328, 2), *range(1024, 1040, 2))
    },
    # Manual of red-y smart: flow, temperature, total, set point, analogue input, valve; texts.
    "flowmeter_": {
        *((address, PointType.FLOAT32, Order.ABCD) for address in range(0, 12, 2)),
        *((address, PointType.STRING, Order.ABCD) for address in (35, 4100)),
    },
}
"""By the beginning of a capture's name: the values of the device, by its published map."""


def test_nothing_is_called_sure_that_a_published_map_contradicts(
    public_captures: Path, tmp_path: Path
) -> None:
    seen = 0
    for name, known in MAPS.items():
        for path in captures():
            if not path.name.startswith(name) or path.suffix not in (".sr", ".txt"):
                continue
            for slave in slaves_of(path, tmp_path):
                for one, _ in sure_values(slave):
                    is_known = (one.address, one.reading.type, one.reading.order) in known
                    assert is_known, (path.name, one)
                    seen += 1
    assert seen >= 20
