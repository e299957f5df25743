"""What is new since an older inventory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest

from mbtool.ledger.baseline import ChangeKind, changes
from mbtool.ledger.inventory_rows import InventoryDocument
from mbtool.modbus import Outcome
from tests.ledger.plant import (
    DRIVE,
    GATEWAY,
    PANEL,
    SCADA,
    asked,
    inventory_of,
    macs,
    named,
    plant,
)

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

Found = tuple[ChangeKind, str, str]


def found(old: list[NamedTransaction], new: list[NamedTransaction]) -> list[Found]:
    compared = changes(inventory_of(old), inventory_of(new))
    return [(one.kind, one.where, one.text) for one in compared]


def silenced(unit: int) -> list[NamedTransaction]:
    """The plant, in which a unit of the gateway does not answer."""
    return [
        msgspec.structs.replace(one, outcome=Outcome.NO_ANSWER, response_ns=None)
        if one.unit == unit
        else one
        for one in plant()
    ]


INJECTED: dict[str, tuple[list[NamedTransaction], Found]] = {
    "a new host": (
        [*plant(), asked(3, 0, 4, slave="10.0.0.77")],
        (ChangeKind.HOST, "10.0.0.77 unit 1", f"asked by {SCADA}"),
    ),
    "a new unit": (
        [*plant(), asked(4, 0, 8, slave=GATEWAY, unit=5)],
        (ChangeKind.UNIT, f"{GATEWAY} unit 5", f"asked by {SCADA}"),
    ),
    "a second writer": (
        [*plant(), asked(16, 10, 2, master=PANEL)],
        (ChangeKind.WRITER, f"{DRIVE} unit 1", f"{PANEL}: 10 write registers writes 10..11"),
    ),
    "a second writer that is a new host": (
        [*plant(), asked(6, 500, 1, master="10.0.0.66")],
        (
            ChangeKind.WRITER,
            f"{DRIVE} unit 1",
            "10.0.0.66 (a new host): 06 write register writes 500",
        ),
    ),
    "a second reader": (
        [*plant(), asked(3, 500, 1, master="10.0.0.66")],
        (ChangeKind.MASTER, f"{DRIVE} unit 1", "10.0.0.66 (a new host): 03 read holding reads 500"),
    ),
    "a new function": (
        [*plant(), asked(4, 0, 2)],
        (ChangeKind.FUNCTION, f"{DRIVE} unit 1", f"04 read input reads 0..1 by {SCADA}"),
    ),
    "a wider range": (
        [*plant(), asked(3, 50, 60, master=PANEL)],
        (
            ChangeKind.RANGE,
            f"{DRIVE} unit 1",
            f"03 read holding registers reads 100..109 by {PANEL}",
        ),
    ),
    "another identity": (
        [*plant()[:-1], named("OTHER", at_s=10)],
        (ChangeKind.IDENTITY, f"{DRIVE} unit 1", 'vendor: "ACME" -> "OTHER"'),
    ),
    "a unit gone silent": (
        silenced(4),
        (ChangeKind.SILENT, f"{GATEWAY} unit 4", "asked 10 times, and never answered"),
    ),
    "a unit that is not asked": (
        [one for one in plant() if one.unit != 4],
        (ChangeKind.SILENT, f"{GATEWAY} unit 4", "neither asked nor heard"),
    ),
    "a host that is not asked": (
        [one for one in plant() if one.link != GATEWAY],
        (ChangeKind.SILENT, GATEWAY, "units 3, 4: neither asked nor heard"),
    ),
}


def test_another_mac_address_is_told_once_for_all_units_of_a_host() -> None:
    here, there = "00:90:e8:00:00:01", "00:0c:29:00:00:02"
    old = [macs(one, "00:30:de:00:00:01", here) for one in plant()]
    new = [
        macs(one, "00:30:de:00:00:01", there if one.link == GATEWAY else here) for one in plant()
    ]
    assert found(old, new) == [(ChangeKind.MAC, GATEWAY, f"{here} -> {there}")]
    assert found(plant(), new) == []  # Nothing is known of the addresses before.


def test_the_same_plant_is_unchanged() -> None:
    assert found(plant(), plant()) == []


@pytest.mark.parametrize("name", list(INJECTED))
def test_an_injected_change_is_told_and_nothing_else(name: str) -> None:
    new, expected = INJECTED[name]
    assert found(plant(), new) == [expected]


def test_many_changes_at_once_are_each_told_once() -> None:
    injected = [
        one
        for new, _ in (INJECTED["a new host"], INJECTED["a new unit"], INJECTED["a new function"])
        for one in new[51:]
    ]
    kinds = [kind for kind, _, _ in found(plant(), [*plant(), *injected])]
    assert kinds == [ChangeKind.HOST, ChangeKind.UNIT, ChangeKind.FUNCTION]


def test_a_scan_is_one_change() -> None:
    scan = [
        asked(3, 0, 1, master="10.0.0.66", slave=f"10.0.5.{last}", outcome=Outcome.NO_ANSWER)
        for last in range(1, 200)
    ]
    ((kind, _, text),) = found(plant(), [*plant(), *scan])
    assert kind is ChangeKind.HOST
    assert text.endswith("and 191 more asked by 10.0.0.66, never answered")


def test_a_function_that_is_new_tells_no_wider_range_beside() -> None:
    new = [*plant(), asked(5, 7, 1)]
    assert [kind for kind, _, _ in found(plant(), new)] == [ChangeKind.FUNCTION]


def test_a_text_that_is_given_for_the_first_time_is_told_if_it_was_asked_before() -> None:
    refused = asked(0x2B, exception=1)
    assert found([*plant()[:-1], refused], plant()) == [
        (ChangeKind.IDENTITY, f"{DRIVE} unit 1", 'vendor: not given before -> "ACME"')
    ]


def test_the_only_line_of_each_is_the_same_whatever_its_name() -> None:
    old = [asked(3, 0, 1, slave=None, link="/dev/ttyUSB0")]
    new = [
        asked(3, 0, 1, slave=None, link="site.mcap"),
        asked(3, 0, 1, slave=None, link="site.mcap", unit=2),
    ]
    assert found(old, new) == [(ChangeKind.UNIT, "site.mcap unit 2", "heard for the first time")]


def test_an_inventory_that_was_stored_gives_the_same_changes() -> None:
    old = inventory_of(plant())
    stored = msgspec.json.decode(msgspec.json.encode(old), type=InventoryDocument)
    assert stored == old
    new = inventory_of(INJECTED["a wider range"][0])
    assert changes(stored, new) == changes(old, new)
