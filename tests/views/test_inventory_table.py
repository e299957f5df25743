"""The table of an inventory."""

from __future__ import annotations

import io
from typing import Any

import pytest
from msgspec.structs import replace
from rich.console import Console

from mbtool.devices import load_profile
from mbtool.ledger.account import Account
from mbtool.ledger.inventory import inventory
from mbtool.ledger.inventory_rows import InventoryDocument, MasterRow, ProfileFit, SlaveRow
from mbtool.modbus import Outcome
from mbtool.views.inventory_table import print_inventory, seen_text, slave_lines
from tests.ledger.plant import GATEWAY, START_NS, asked, inventory_of, named, plant


def printed(
    document: InventoryDocument, *, width: int = 80, terminal: bool = False, **options: Any
) -> list[str]:
    out = io.StringIO()
    console = Console(file=out, width=width, force_terminal=terminal, color_system=None)
    print_inventory(console, document, **options)
    return [line.rstrip() for line in out.getvalue().splitlines()]


def test_a_unit_has_a_row_and_what_is_known_of_it_under_it() -> None:
    assert printed(inventory_of(plant())) == [
        "host       unit  role",
        "10.0.0.10     1  slave",
        "      seen 2023-11-14 22:13:20 .. 22:13:30, 31 transactions",
        '      says vendor "ACME"',
        "      03 read holding 0..99; 10 times by 10.0.0.1",
        "      03 read holding 0..9; 10 times by 10.0.0.2",
        "      2B encapsulated; once by 10.0.0.1",
        "      10 write registers 10..11; 10 times by 10.0.0.1",
        "10.0.0.20     3  gateway",
        "      seen 2023-11-14 22:13:20 .. 22:13:29, 10 transactions",
        "      04 read input 0..7; 10 times by 10.0.0.1",
        "10.0.0.20     4  gateway",
        "      seen 2023-11-14 22:13:20 .. 22:13:29, 10 transactions",
        "      04 read input 0..7; 10 times by 10.0.0.1",
        "",
        "master    asks  writes to  requests  seen",
        "10.0.0.1     3          1        41  2023-11-14 22:13:20 .. 22:13:30",
        "10.0.0.2     1          0        10  2023-11-14 22:13:20 .. 22:13:29",
    ]


def test_what_never_answered_is_one_line_for_each_master() -> None:
    scan = [
        asked(3, 0, 1, slave=f"10.0.5.{last}", outcome=Outcome.NO_ANSWER) for last in range(1, 9)
    ]
    document = inventory_of(scan)
    assert printed(document)[0] == (
        "  no answer from 8 hosts: 10.0.5.1, 10.0.5.2, 10.0.5.3, 10.0.5.4, 10.0.5.5, 10.0.5.6 and "
        "2 more, asked by 10.0.0.1"
    )
    assert len([line for line in printed(document, everything=True) if "silent" in line]) == 8


def test_hosts_that_are_alike_are_folded_where_there_are_many() -> None:
    many = inventory_of(asked(3, 0, 1, slave=f"10.0.5.{last}") for last in range(1, 101))
    lines = printed(many)
    assert lines[4] == (
        "      and so 99 hosts more: 10.0.5.2, 10.0.5.3, 10.0.5.4, 10.0.5.5, 10.0.5.6, 10.0.5.7 "
        "and 93 more"
    )
    assert len(lines) < 10
    assert len(printed(many, everything=True)) > 300


def test_functions_that_it_does_not_have_are_one_line() -> None:
    probes = [asked(code, exception=1) for code in (1, 2, 5, 0x41, 0x42)]
    lines = printed(inventory_of([asked(3, 0, 1), *probes]))
    assert (
        "      functions that it refuses as unknown: 01..02, 05, 41..42; asked by 10.0.0.1" in lines
    )


@pytest.mark.parametrize("width", [80, 120])
def test_a_terminal_s_lines_are_no_longer_than_it_is_wide(width: int) -> None:
    scattered = [asked(3, 100 * at, 5) for at in range(40)]
    lines = printed(inventory_of([*plant(), *scattered]), width=width, terminal=True)
    assert max(map(len, lines)) <= width


def test_a_long_list_of_ranges_is_whole_only_if_everything_is_wanted() -> None:
    document = inventory_of(asked(3, 10 * at, 1) for at in range(40))
    assert any("and 28 more" in line for line in printed(document))
    assert any("380, 390;" in line for line in printed(document, everything=True))


def test_profiles_are_named_with_how_sure_that_is_or_are_unknown() -> None:
    def row(unit: int, **fields: Any) -> SlaveRow:
        return SlaveRow(host="10.0.0.7", port=502, unit=unit, **fields)

    document = InventoryDocument(
        format="",
        slaves=[
            row(1, fit=ProfileFit(profile="wago-750", score=91, why="its answers")),
            row(2, fit=ProfileFit(score=33, nearest="wago-750", why="3 contradict it")),
            row(3, device="pump"),
            row(4, device="pump", fit=ProfileFit(why="1 request is too few")),
            row(5, fit=ProfileFit(nearest="fa3-at1", why="fa3-at1m8x is another")),
            row(6, fit=ProfileFit(nearest="pump", why="pump is not it", why_names_nearest=True)),
        ],
    )
    lines = printed(document)
    assert lines[1].split() == ["10.0.0.7", "1", "slave", "wago-750", "91"]
    assert "      fits wago-750, by its answers" in lines
    assert lines[4].split() == ["10.0.0.7", "2", "slave", "unknown"]
    why = "3 contradict it; the most alike is wago-750, score 33 of 100"
    assert f"      profile is not known: {why}" in lines
    named = next(at for at, line in enumerate(lines) if "(named)" in line)
    assert lines[named].split() == ["10.0.0.7", "3", "slave", "pump", "(named)"]
    alone = "by its traffic alone its profile is not known: 1 request is too few"
    assert f"      {alone}" in lines
    other = "fa3-at1m8x is another; the most alike is fa3-at1, score 0 of 100"
    assert f"      profile is not known: {other}" in lines
    assert lines[-1] == "      profile is not known: pump is not it"


def test_addresses_stand_beside_what_the_profile_of_a_named_unit_calls_them() -> None:
    profile = load_profile("fa3-at1m8x")
    account = Account(observes=True)
    for one in (
        asked(2, 16, 8),
        asked(3, 16, 2, exception=2, outcome=Outcome.EXCEPTION),
        asked(4, 2, 8),
        asked(4, 5000, 1),
        asked(0x42),
    ):
        account.add(replace(one, device=profile.name))
    named_unit = inventory(account, profiles={profile.name: profile})
    lines = [line.partition(";")[0].strip() for line in printed(named_unit)]
    assert "02 read discrete 16..23 (X10..X17)" in lines
    assert "04 read input 2..9, 5000 (RWr2..RWr9, RWr1388)" in lines
    assert "      03 read holding; refused 16..17; once by 10.0.0.1" not in printed(named_unit)
    assert any("refused 16..17 (RWw10..RWw11)" in line for line in printed(named_unit))
    assert not any("(" in line for line in printed(inventory(account))[2:])


def test_macs_stand_with_their_makers() -> None:
    slave = SlaveRow(host="10.0.0.7", unit=1, macs=["00:30:de:01:02:03"], makers=["WAGO"])
    master = MasterRow(host="10.0.0.1", macs=["00:0c:29:01:02:03"], makers=["VMware"])
    lines = printed(InventoryDocument(format="", slaves=[slave], masters=[master]))
    assert "      MAC 00:30:de:01:02:03 WAGO" in lines
    assert lines[-1] == "      MAC 00:0c:29:01:02:03 VMware"


def test_nothing_of_the_wire_is_obeyed() -> None:
    evil = "[red]\x1b[31m\r"
    rows = [asked(3, 0, 1, slave=f"{evil}10.0.0.7", function_name=evil), named(evil)]
    text = "\n".join(printed(inventory_of(rows), terminal=True))
    assert "\x1b" not in text.replace("\x1b[1m", "")
    assert "\r" not in text
    assert "[red]?[31m?10.0.0.7" in text


def test_the_day_is_said_once() -> None:
    assert seen_text(START_NS, START_NS + 1) == "2023-11-14 22:13:20"
    assert seen_text(START_NS, START_NS + 10**9) == "2023-11-14 22:13:20 .. 22:13:21"
    assert seen_text(START_NS, START_NS + 86400 * 10**9) == (
        "2023-11-14 22:13:20 .. 2023-11-15 22:13:20"
    )


def test_a_unit_of_a_gateway_with_silent_neighbours_is_named_by_its_unit() -> None:
    silent = [
        asked(3, 0, 1, slave=GATEWAY, unit=unit, outcome=Outcome.NO_ANSWER) for unit in (8, 9)
    ]
    assert f"  no answer from {GATEWAY} units 8, 9, asked by 10.0.0.1" in printed(
        inventory_of([*plant(), *silent])
    )


def test_what_a_gateway_could_not_deliver_is_not_called_unanswered() -> None:
    row = SlaveRow(host="10.0.0.7", unit=9, transactions=9, answered=4, unanswered=5, unreached=3)
    assert slave_lines(row)[0].endswith(
        "9 transactions, 2 without answer, 3 that its gateway could not deliver"
    )
    row = SlaveRow(host="10.0.0.7", unit=9, transactions=9, answered=6, unanswered=3, unreached=3)
    assert "without answer" not in slave_lines(row)[0]
