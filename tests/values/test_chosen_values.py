from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices import PointValue, load_profile
from mbtool.values.chosen_values import MAX_CHOSEN, ChosenValues
from mbtool.workflows.plot import _parse_addresses
from tests.values.test_values import seen

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, Profile

FA3 = load_profile("fa3-at1m8x")
CH1 = PointValue(name="CH1 digital value", reference="RWr2", value=27.5, text="27.5", unit="V")
CH2 = PointValue(name="CH2 digital value", reference="RWr3", value=3, text="3", unit="V")


def chosen(
    *texts: str, records: list[NamedTransaction], profile: Profile | None = None
) -> dict[str, list[float]]:
    values = ChosenValues(texts, _parse_addresses, lambda _: profile)
    for one in records:
        values.add(one)
    return {one.name: [sample.value for sample in one.samples] for one in values.series.values()}


def test_registers_are_followed_by_address_in_reads_and_writes() -> None:
    records = [seen(1, 3, [7, 8, 9]), seen(2, 16, [5]), seen(3, 4, [1])]
    assert chosen("holding 10..11", "hr 12", records=records) == {
        "holding 10": [7, 5],
        "holding 11": [8],
        "holding 12": [9],
    }


def test_points_are_found_by_name_beginning_reference_and_range() -> None:
    records = [seen(1, 4, [1, 2, 9], address=2, points=[CH1, CH2])]
    both = {"CH1 digital value": [27.5], "CH2 digital value": [3]}
    one = {"CH1 digital value": [27.5]}
    assert chosen("ch1", records=records, profile=FA3) == one
    assert chosen("CH1 digital value", records=records, profile=FA3) == one
    assert chosen("rwr2", records=records, profile=FA3) == one
    assert chosen("RWr2..RWr3", records=records, profile=FA3) == both
    assert chosen("input 3..4", records=records, profile=FA3) == {
        "CH2 digital value": [3],
        "RWr4": [9],
    }


def test_nothing_else_is_followed() -> None:
    refused = seen(1, 3, [7])
    assert chosen("input 10", "CH", "nonsense", records=[refused]) == {}


def test_the_number_of_values_is_bounded() -> None:
    values = ChosenValues(["holding 0..999"], _parse_addresses, lambda _: None)
    values.add(seen(1, 3, list(range(MAX_CHOSEN + 3)), address=0))
    assert (len(values.series), len(values.left_out)) == (MAX_CHOSEN, 3)
