"""Who is in a capture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.ledger import account, observation
from mbtool.ledger.inventory_rows import Role, SlaveRow
from mbtool.modbus import Outcome, mbap_adu
from tests.ledger.plant import (
    DRIVE,
    GATEWAY,
    PANEL,
    SCADA,
    SECOND,
    START_NS,
    asked,
    inventory_of,
    macs,
    named,
    plant,
)

if TYPE_CHECKING:
    import pytest


def only(*transactions: Any) -> SlaveRow:
    (row,) = inventory_of(transactions).slaves
    return row


def test_each_unit_of_each_host_has_a_row_in_the_order_of_their_numbers() -> None:
    rows = inventory_of([*plant(), asked(3, 0, 1, slave="10.0.0.9")]).slaves
    places = [(row.host, row.port, row.unit, row.role) for row in rows]
    assert places == [
        ("10.0.0.9", 502, 1, Role.SLAVE),
        (DRIVE, 502, 1, Role.SLAVE),
        (GATEWAY, 502, 3, Role.GATEWAY),
        (GATEWAY, 502, 4, Role.GATEWAY),
    ]


def test_masters_have_rows_with_what_they_ask_and_write() -> None:
    masters = inventory_of(plant()).masters
    assert [(row.host, row.requests, row.slaves, row.written) for row in masters] == [
        (SCADA, 41, 3, 1),
        (PANEL, 10, 1, 0),
    ]


def test_functions_have_their_ranges_and_who_asked() -> None:
    row = inventory_of(plant()).slaves[0]
    assert [
        (use.function, use.master, use.writes, use.ranges, use.requests) for use in row.uses
    ] == [
        (3, SCADA, False, [(0, 99)], 10),
        (3, PANEL, False, [(0, 9)], 10),
        (0x2B, SCADA, False, [], 1),
        (16, SCADA, True, [(10, 11)], 10),
    ]
    assert row.masters() == [SCADA, PANEL]
    assert row.masters(writing=True) == [SCADA]


def test_refused_addresses_are_kept_apart_unless_they_were_accepted_too() -> None:
    refused: dict[str, Any] = {"exception": 2}
    row = only(asked(3, 0, 10), asked(3, 5, 10, **refused), asked(3, 0, 1, **refused))
    (use,) = row.uses
    assert (use.ranges, use.refused, use.all_ranges) == ([(0, 9)], [(10, 14)], [(0, 14)])
    assert row.exceptions == {2: 2}


def test_function_17h_reads_and_writes() -> None:
    row = only(asked(0x17, 0, 4, write_address=20, write_quantity=2))
    assert [(use.writes, use.ranges) for use in row.uses] == [
        (False, [(0, 3)]),
        (True, [(20, 21)]),
    ]


def test_the_first_and_the_last_time_are_those_of_its_transactions() -> None:
    row = inventory_of(plant()).slaves[0]
    assert (row.first_ns, row.last_ns) == (START_NS, START_NS + 10 * SECOND + 5_000_000)


def test_who_never_answered_is_silent_and_a_gateway_s_answer_is_none_of_the_unit() -> None:
    rows = inventory_of(
        [
            asked(3, 0, 1, slave="10.0.0.30", outcome=Outcome.NO_ANSWER),
            asked(3, 0, 1, slave=GATEWAY, unit=9, exception=0x0B),
            asked(3, 0, 1, slave="10.0.0.31", outcome=Outcome.NOT_CAPTURED),
        ]
    ).slaves
    assert [(row.role, row.answered, row.unanswered, row.unreached) for row in rows] == [
        (Role.SILENT, 0, 1, 1),
        (Role.SILENT, 0, 1, 0),
        (Role.UNHEARD, 0, 0, 0),
    ]


def test_one_host_with_units_0_and_255_is_no_gateway() -> None:
    rows = inventory_of([asked(3, 0, 1, unit=unit) for unit in (0, 1, 255)]).slaves
    assert {row.role for row in rows} == {Role.SLAVE}


def test_unit_0_of_a_line_is_a_broadcast() -> None:
    row = only(asked(6, 0, 1, slave=None, unit=0, outcome=Outcome.BROADCAST))
    assert (row.host, row.port, row.role, row.masters()) == (
        "/dev/ttyUSB0",
        None,
        Role.BROADCAST,
        [],
    )


def test_a_host_with_two_ports_is_two_devices() -> None:
    rows = inventory_of([asked(3, 0, 1), asked(3, 0, 1, port=1502)]).slaves
    assert [row.where for row in rows] == [DRIVE, f"{DRIVE}:1502"]


def test_addresses_of_ipv6_have_no_brackets() -> None:
    document = inventory_of([asked(3, 0, 1, slave="[fd00::2]", master="[fd00::1]")])
    assert (document.slaves[0].host, document.masters[0].host) == ("fd00::2", "fd00::1")
    assert document.slaves[0].uses[0].master == "fd00::1"


def test_what_it_says_of_itself_is_kept_also_where_it_changes() -> None:
    model = asked(0x42, response_raw=mbap_adu(0, 1, bytes.fromhex("42 0016")))
    server = asked(0x11, response_raw=mbap_adu(0, 1, bytes.fromhex("11 05 50 4c 43 00 ff")))
    row = only(named("ACME"), named("ACME"), named("OTHER"), model, server)
    assert [(one.function, one.name, one.text) for one in row.identity] == [
        (0x2B, "vendor", "ACME"),
        (0x2B, "vendor", "OTHER"),
        (0x42, "model code", "0016H"),
        (0x11, "server id", "PLC"),
        (0x11, "run indicator", "off"),
        (0x11, "additional data", "ff"),
    ]


def test_a_function_that_it_does_not_have_is_counted() -> None:
    row = only(asked(5, 0, exception=1), asked(3, 0, 1))
    assert [(use.function, use.unsupported) for use in row.uses] == [(3, 0), (5, 1)]


def test_more_slaves_than_there_is_room_for_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(account, "MAX_UNITS", 10)
    document = inventory_of(asked(3, 0, 1, slave=f"10.0.1.{last}") for last in range(25))
    assert len(document.slaves) == 10
    assert document.left_out == {"transactions are of slaves or functions without a row": 15}


def test_more_requests_than_there_is_room_for_are_not_compared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(observation, "MAX_REQUESTS", 10)
    monkeypatch.setattr(account, "MAX_POLLS", 5)
    document = inventory_of(asked(3, address, 1) for address in range(25))
    assert document.slaves[0].uses[0].ranges == [(0, 24)]
    assert document.left_out == {"requests were not compared with profiles": 15}


def test_more_masters_and_functions_than_there_is_room_for_are_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    transactions = [asked(3, 0, 1, master=f"10.0.2.{last}") for last in range(5)]
    monkeypatch.setattr(account, "MAX_MASTERS", 2)
    document = inventory_of(transactions)
    assert (len(document.masters), len(document.slaves[0].uses)) == (2, 5)
    assert document.left_out == {"transactions are of masters without a row": 3}
    monkeypatch.setattr(account, "MAX_USES", 2)
    document = inventory_of(transactions)
    assert len(document.masters) == len(document.slaves[0].uses) == 2
    assert document.left_out == {"transactions are of slaves or functions without a row": 3}


def test_macs_are_those_of_master_and_slave_with_their_makers() -> None:
    rows = [macs(one, "aa:00", "bb:00") for one in (asked(3, 0, 1), asked(3, 0, 1))]
    other = macs(asked(3, 0, 1), "aa:00", "cc:00")
    document = inventory_of([*rows, other], maker={"aa:00": "A", "bb:00": "B", "cc:00": "B"}.get)
    (slave,), (master,) = document.slaves, document.masters
    assert (slave.macs, slave.makers) == (["bb:00", "cc:00"], ["B"])
    assert (master.macs, master.makers) == (["aa:00"], ["A"])
