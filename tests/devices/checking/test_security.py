"""Attacks and scans: each rule with its limit, what plants do, and bounded memory."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import CONNECTION_JOINED, CONNECTION_OPENED, EventKind, WireEvent
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.checker import Checker
from mbtool.devices.checking.security import SecurityRules
from mbtool.devices.checking.security_limits import SecurityLimits
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.adu import Verdict
from mbtool.modbus.transaction import Outcome
from tests.devices.checking.talk import assigned, event, transaction

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.devices.checking.finding import Finding

Record = NamedTransaction | WireEvent

A, B = "10.0.0.1", "10.0.0.9"
PLC = "10.0.0.2"
WRITE = ("06 0005 0001", "06 0005 0001")
IDENTIFY = ("2B 0E 01 00", "2B 0E 01 01 00 00 01 00 01 41")
SECOND = 1000.0
"""In ms, the unit of the times of these tests."""

limits = st.integers(2, 12), st.integers(1, 5)
"""The number of cases, and the time in s."""


def said(
    *of: Any, master: str = A, slave: str = PLC, port: int = 50000, **fields: Any
) -> NamedTransaction:
    one = transaction(*of, source=f"{master}:{port}", **fields)
    return msgspec.structs.replace(one, destination=f"{slave}:502", link=slave)


def on_line(*of: Any, **fields: Any) -> NamedTransaction:
    return transaction(*of, on_a_line=True, **fields)


def opens(slave: str, *, at_ms: float, master: str = B, port: int = 50000) -> WireEvent:
    return event(
        EventKind.OPENED,
        at_ms=at_ms,
        message=CONNECTION_OPENED,
        source=f"{master}:{port}",
        destination=f"{slave}:502",
    )


def found(records: Iterable[Record], *limits: str, profile: str | None = None) -> list[Finding]:
    """The findings about attacks and scans."""
    checker = Checker(CaptureContext(assigned(profile), limits=SecurityLimits.parse(limits)))
    findings = [one for record in records for one in checker.feed(record)]
    findings += checker.close()
    return [one for one in findings if one.code.startswith("SEC-")]


def messages(records: Iterable[Record], *limits: str) -> list[tuple[str, int, str]]:
    return [(one.code, one.count, one.message) for one in found(records, *limits)]


def polls(
    *, times: int = 70, every_ms: float = SECOND, master: str = A, slave: str = PLC
) -> Iterator[NamedTransaction]:
    for number in range(times):
        yield said(at_ms=number * every_ms, master=master, slave=slave)


# A second master.


def test_a_slave_may_have_more_masters_than_are_remembered() -> None:
    hosts = [f"10.0.1.{number}" for number in range(1, 40)]
    records = [
        said(at_ms=number * SECOND, master=host) for number, host in enumerate([*hosts, *hosts])
    ]
    assert messages(records) == []


def test_a_host_that_comes_later_and_writes_is_a_second_master() -> None:
    attack = [*polls(times=61), said(*WRITE, master=B, at_ms=60_500), *polls(times=61)]
    assert messages(attack) == [
        ("SEC-101", 1, f"{B} writes to {PLC}:502, which {A} asked before: write holding 5")
    ]


def test_a_host_whose_connection_began_before_the_capture_is_no_second_master() -> None:
    joined = replace(opens(PLC, at_ms=30_000), message=CONNECTION_JOINED)
    write = said(*WRITE, master=B, at_ms=60_500)
    assert found([*polls(times=61), joined, write, *polls(times=61)]) == []
    opened = opens(PLC, at_ms=60_400)
    assert len(found([*polls(times=61), opened, write, *polls(times=61)])) == 1


def test_reading_is_no_attack() -> None:
    assert found([*polls(), said(master=B, at_ms=65_000), *polls()]) == []


def test_the_only_writer_that_was_there_from_the_beginning_is_no_second_master() -> None:
    both = []
    for second in range(200):
        both.append(said(at_ms=second * SECOND))
        both.append(said(*WRITE, master=B, at_ms=second * SECOND + 300))
    assert found(both) == []


def test_of_two_writers_the_later_one_is_the_second() -> None:
    both = []
    for second in range(30):
        both.append(said(*WRITE, at_ms=second * SECOND))
        both.append(said(*WRITE, master=B, at_ms=second * SECOND + 300))
    (finding,) = found(both)
    assert (finding.code, finding.source, finding.count) == ("SEC-101", f"{B}:50000", 30)


def test_the_second_writer_may_write_first() -> None:
    three = [said(), said(*WRITE, master=B, at_ms=100), said(*WRITE, at_ms=200)]
    (finding,) = found(three)
    assert (finding.source, finding.count) == (f"{B}:50000", 1)


def test_two_writers_are_compared_within_the_time_of_the_limit() -> None:
    both = [said(), said(master=B, at_ms=1), said(*WRITE, at_ms=2)]
    assert len(found([*both, said(*WRITE, master=B, at_ms=10_002)])) == 1
    assert found([*both, said(*WRITE, master=B, at_ms=10_003)]) == []


def test_a_master_that_takes_over_from_one_that_is_gone_is_no_second_master() -> None:
    assert found([*polls(times=70), said(*WRITE, master=B, at_ms=140_000)]) == []


def test_masters_of_different_slaves_are_not_compared() -> None:
    assert found([*polls(), said(*WRITE, master=B, slave="10.0.0.3", at_ms=65_000)]) == []


def test_a_new_connection_is_no_new_master() -> None:
    assert found([*polls(), said(*WRITE, port=50001, at_ms=65_000)]) == []


@given(*limits)
def test_so_many_writes_of_a_second_master_are_a_finding(number: int, seconds: int) -> None:
    def attack(times: int, span_ms: float) -> list[NamedTransaction]:
        step = span_ms / max(number - 1, 1)
        late = [said(*WRITE, master=B, at_ms=70_000 + one * step) for one in range(times)]
        return [*polls(times=90), *late]

    limit = f"SEC-101={number}/{seconds}s"
    assert [one.count for one in found(attack(number, seconds * SECOND), limit)] == [number]
    assert found(attack(number - 1, seconds * SECOND), limit) == []
    assert found(attack(number, seconds * SECOND + number), limit) == []


# A write flood.


@given(*limits, st.booleans())
def test_so_many_writes_are_a_flood(number: int, seconds: int, is_serial: bool) -> None:
    say = on_line if is_serial else said

    def flood(times: int, span_ms: float) -> list[NamedTransaction]:
        step = span_ms / max(number - 1, 1)
        return [say(*WRITE, at_ms=one * step) for one in range(times)]

    limit = f"SEC-102={number}/{seconds}s"
    (finding,) = found(flood(number, seconds * SECOND), limit)
    assert (finding.code, finding.count) == ("SEC-102", number)
    assert finding.ts_ns == flood(1, 0)[0].start_ns
    assert found(flood(number - 1, seconds * SECOND), limit) == []
    assert found(flood(number, seconds * SECOND + number), limit) == []


def test_a_flood_says_who_writes_where() -> None:
    flood = [said(*WRITE, at_ms=number * 5) for number in range(1500)]
    assert messages(flood) == [
        ("SEC-102", 1500, f"{A} writes 1500 times to {PLC}:502, for example write holding 5")
    ]
    line = [on_line(*WRITE, at_ms=number * 20) for number in range(400)]
    assert messages(line)[0][2] == (
        "the master writes 400 times to the line rs485, for example write holding 5"
    )


def test_a_cycle_of_writes_every_twenty_milliseconds_is_no_flood() -> None:
    assert found(said(*WRITE, at_ms=number * 20) for number in range(3000)) == []


def test_reads_are_no_flood() -> None:
    assert found(said(at_ms=number) for number in range(3000)) == []


# Commands that stop a device.


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ("08 0001 0000", "restart communications (08/0001)"),
        ("08 0001 FF00", "restart communications (08/0001)"),
        ("08 0004 0000", "force listen only mode (08/0004)"),
        ("5A 01 41 FF 00", "stop (5AH/41)"),
        ("5A 01 40 FF 00", "start (5AH/40)"),
        ("5A 01 34 00", "load a part of a program (5AH/34)"),
        ("5A 01 99", "carry out an unknown command (5AH/99)"),
        ("5A 01", "do what function 5AH says without a command"),
    ],
)
@pytest.mark.parametrize("is_serial", [False, True])
@pytest.mark.parametrize("is_answered", [False, True])
def test_a_command_that_stops_a_device_is_found(
    request_: str, says: str, is_serial: bool, is_answered: bool
) -> None:
    refusal = f"{int(request_[:2], 16) | 0x80:02X} 01" if is_answered else None
    one = on_line(request_, refusal) if is_serial else said(request_, refusal)
    master, place = ("the master", "the line rs485") if is_serial else (A, f"{PLC}:502")
    assert messages([one]) == [("SEC-103", 1, f"{master} tells unit 1 of {place} to {says}")]


@pytest.mark.parametrize(
    "request_",
    ["08 0000 1234", "08 0002 0000", "08 000A 0000", "5A 01 02", "5A 01 22 00", "5A 01 12"],
)
def test_what_only_reads_is_no_command(request_: str) -> None:
    assert found([said(request_, request_)]) == []


def test_commands_of_one_master_are_one_finding() -> None:
    commands = [said("08 0001 0000", None, slave=f"10.0.0.{one}", at_ms=one) for one in range(9)]
    assert messages(commands)[0] == (
        "SEC-103",
        9,
        f"{A} tells unit 1 of 10.0.0.0:502 to restart communications (08/0001), unit 1 of "
        "10.0.0.1:502 to restart communications (08/0001), unit 1 of 10.0.0.2:502 to restart "
        "communications (08/0001), ...",
    )


@given(*limits)
def test_so_many_commands_are_a_finding(number: int, seconds: int) -> None:
    def commands(times: int, span_ms: float) -> list[NamedTransaction]:
        step = span_ms / max(number - 1, 1)
        return [said("08 0001 0000", None, at_ms=one * step) for one in range(times)]

    limit = f"SEC-103={number}/{seconds}s"
    assert [one.count for one in found(commands(number, seconds * SECOND), limit)] == [number]
    assert found(commands(number - 1, seconds * SECOND), limit) == []
    assert found(commands(number, seconds * SECOND + number), limit) == []


# Scans.


def scan_of_hosts(times: int, step_ms: float) -> list[Record]:
    return [
        said("03 0000 0001", None, master=B, slave=f"10.1.0.{one}", at_ms=one * step_ms)
        for one in range(times)
    ]


def scan_of_closed_ports(times: int, step_ms: float) -> list[Record]:
    return [opens(f"10.1.0.{one}", at_ms=one * step_ms) for one in range(times)]


def scan_of_units(times: int, step_ms: float) -> list[Record]:
    return [said("03 0000 0001", "83 0B", unit=one, at_ms=one * step_ms) for one in range(times)]


def scan_of_units_on_a_line(times: int, step_ms: float) -> list[Record]:
    return [
        on_line("03 0000 0001", None, unit=one + 1, at_ms=one * step_ms) for one in range(times)
    ]


def scan_of_functions(times: int, step_ms: float) -> list[Record]:
    return [
        said(f"{one + 1:02X} 00 00 00 01", f"{one + 0x81:02X} 01", at_ms=one * step_ms)
        for one in range(times)
    ]


def scan_of_silent_functions(times: int, step_ms: float) -> list[Record]:
    return [on_line(f"{one + 0x41:02X} 00", None, at_ms=one * step_ms) for one in range(times)]


def scan_of_registers(times: int, step_ms: float) -> list[Record]:
    return [
        said(f"03 {one:04X} 0001", f"83 0{2 + one % 2}", at_ms=one * step_ms)
        for one in range(times)
    ]


def scan_of_registers_on_a_line(times: int, step_ms: float) -> list[Record]:
    return [on_line(f"04 {one:04X} 0001", "84 02", at_ms=one * step_ms) for one in range(times)]


SCANS = (
    ("SEC-201", scan_of_hosts),
    ("SEC-201", scan_of_closed_ports),
    ("SEC-202", scan_of_units),
    ("SEC-202", scan_of_units_on_a_line),
    ("SEC-203", scan_of_functions),
    ("SEC-203", scan_of_silent_functions),
    ("SEC-204", scan_of_registers),
    ("SEC-204", scan_of_registers_on_a_line),
)
each_scan = pytest.mark.parametrize(
    ("code", "scan"), SCANS, ids=[scan.__name__ for _, scan in SCANS]
)


@each_scan
@given(*limits)
def test_so_many_in_the_time_are_a_scan(code: str, scan: Any, number: int, seconds: int) -> None:
    step_ms = seconds * SECOND / max(number - 1, 1)
    limit = f"{code}={number}/{seconds}s"
    (finding,) = found(scan(number, step_ms), limit)
    assert (finding.code, finding.count) == (code, number)
    assert finding.ts_ns == scan(1, 0)[0].start_ns if code != "SEC-201" else finding.ts_ns
    assert found(scan(number - 1, step_ms), limit) == []
    assert found(scan(number, step_ms + 1), limit) == []


@each_scan
def test_what_is_asked_again_is_polled(code: str, scan: Any) -> None:
    turns = [scan(24, 10) for _ in range(5)]
    assert found([record for turn in turns for record in turn]) == []
    assert [one.code for one in found(scan(24, 10))] == [code]


def test_a_scan_says_who_scans_and_gives_examples() -> None:
    assert messages(scan_of_hosts(40, 10)) == [
        ("SEC-201", 40, f"{B} asks 40 addresses and polls none of them: 10.1.0.0, 10.1.0.1, "
         "10.1.0.2, ...")
    ]  # fmt: skip
    assert messages(scan_of_units(40, 10)) == [
        ("SEC-202", 40, f"{A} asks 40 units of {PLC}:502 and polls none of them: 0, 1, 2, ...")
    ]
    assert messages(scan_of_units_on_a_line(40, 10)) == [
        ("SEC-202", 40, "the master asks 40 units of the line rs485 and polls none of them: "
         "1, 2, 3, ...")
    ]  # fmt: skip
    assert messages(scan_of_functions(40, 10)) == [
        ("SEC-203", 40, f"{A} asks unit 1 of {PLC}:502 for 40 functions that it does not have: "
         "01H, 02H, 03H, ...")
    ]  # fmt: skip
    assert messages(scan_of_registers(40, 10)) == [
        ("SEC-204", 40, f"unit 1 of {PLC}:502 refuses {A} 40 different registers: "
         "read holding 0, read holding 1, read holding 2, ...")
    ]  # fmt: skip


def test_scans_of_several_slaves_by_one_host_are_one_finding() -> None:
    scans = []
    for slave in ("10.0.0.2", "10.0.0.3"):
        scans += [
            said("03 0000 0001", None, slave=slave, unit=one, master=B, at_ms=one)
            for one in range(20)
        ]
    (finding,) = found(scans)
    assert (finding.code, finding.count) == ("SEC-202", 40)


def test_a_host_scan_may_ask_several_units_of_each_address() -> None:
    scan = [
        said("11", "91 01", master=B, slave=f"10.1.0.{one // 3}", unit=one % 3, at_ms=one)
        for one in range(60)
    ]
    assert [(one.code, one.count) for one in found(scan)] == [("SEC-201", 20)]


def turn_of(
    slaves: int, *, master: str = A, at_ms: float = 0, outcome: Outcome = Outcome.OK
) -> list[Record]:
    """A master asks so many slaves once, and all answer."""
    asked = [
        said(master=master, slave=f"10.1.0.{one}", at_ms=at_ms + one * 50) for one in range(slaves)
    ]
    return [msgspec.structs.replace(one, outcome=outcome) for one in asked]


@pytest.mark.parametrize("outcome", [Outcome.OK, Outcome.LATE, Outcome.NOT_CAPTURED])
def test_the_first_turn_of_a_plant_in_a_short_capture_is_no_scan(outcome: Outcome) -> None:
    assert found(turn_of(100, outcome=outcome)) == []
    assert found([*turn_of(100, outcome=outcome), said(at_ms=300_000)]) == []


def test_a_gateway_that_is_polled_once_a_minute_is_no_scan_in_a_capture_of_59_seconds() -> None:
    turn = [said(unit=unit, at_ms=unit * 4000) for unit in range(1, 13)]
    assert found(turn) == []
    absent = [said("03 0000 0001", "83 0B", unit=unit, at_ms=unit * 4000) for unit in (13, 14)]
    assert found([*turn, *absent]) == []


def test_slaves_that_are_asked_only_once_in_a_long_capture_are_scanned() -> None:
    (finding,) = found([*turn_of(12), *polls(times=310)])
    assert (finding.code, finding.count) == ("SEC-201", 12)


def visits(slaves: int, *request: str, master: str = B) -> list[Record]:
    """A host connects to so many slaves, 50 ms apart, and sends each one request."""
    return [
        record
        for one in range(slaves)
        for record in (
            opens(f"10.1.0.{one}", at_ms=one * 50, master=master),
            said(*request, master=master, slave=f"10.1.0.{one}", at_ms=one * 50 + 10),
        )
    ]


@pytest.mark.parametrize(
    ("request_", "quiet_s"), [((), 60), (IDENTIFY, 10), (("11", "11 02 01 FF"), 10)]
)
def test_a_scan_that_is_answered_is_found_when_the_scanner_does_not_come_back(
    request_: tuple[str, ...], quiet_s: int
) -> None:
    scan = visits(30, *request_)
    late_ms = 30 * 50 + quiet_s * SECOND
    assert [(one.code, one.count) for one in found([*scan, said(at_ms=late_ms)])] == [
        ("SEC-201", 30)
    ]
    assert found([*scan, said(at_ms=late_ms - 2 * SECOND)]) == []


def test_a_host_that_identifies_its_slaves_and_reads_them_once_is_no_scan_at_once() -> None:
    reads = turn_of(30, master=B, at_ms=5 * SECOND)
    assert found([*visits(30, *IDENTIFY), *reads, said(at_ms=30 * SECOND)]) == []
    assert len(found([*visits(30, *IDENTIFY), *reads, said(at_ms=67 * SECOND)])) == 1


def test_connections_joined_midway_are_no_scan() -> None:
    joined = [opens(f"10.1.0.{one}", at_ms=one) for one in range(30)]
    joined = [replace(one, message=CONNECTION_JOINED) for one in joined]
    assert found(joined) == []


def test_a_host_that_connects_to_many_slaves_after_others_have_polled_scans() -> None:
    plant = [one for at_ms in (0, 1000, 2000) for one in turn_of(15, at_ms=at_ms)]
    opened = [opens(f"10.1.0.{one}", at_ms=3000, master=B) for one in range(15)]
    scan = [*opened, *turn_of(15, master=B, at_ms=4000)]
    assert [one.code for one in found([*plant, *scan])] == ["SEC-201"]
    assert found([*plant, *turn_of(15, master=B, at_ms=4000)]) == []
    first = [opens(f"10.1.0.{one}", at_ms=0, master=B) for one in range(15)]
    later = [one for at_ms in (5000, 6000, 7000) for one in turn_of(15, at_ms=at_ms)]
    assert found([*first, *turn_of(15, master=B, at_ms=1), *later]) == []


def test_the_answers_of_a_device_that_ignores_the_unit_do_not_hide_a_scan() -> None:
    scan = [said(unit=unit, at_ms=unit * 10) for unit in range(248)]
    assert [(one.code, one.count) for one in found(scan)] == [("SEC-202", 248)]


def test_a_gateway_with_units_that_are_absent_is_no_scan() -> None:
    plant = []
    for turn in range(6):
        for unit in range(1, 32):
            answer = "03 02 1234" if unit % 2 else "83 0B"
            at_ms = turn * 3000 + unit * 90
            plant.append(said("03 0000 0001", answer, unit=unit, at_ms=at_ms))
    assert found(plant) == []


def test_a_master_that_reads_identifications_and_then_polls_many_slaves_is_no_scan() -> None:
    plant: list[Record] = []
    slaves = [f"10.0.1.{one}" for one in range(100)]
    for number, slave in enumerate(slaves):
        plant.append(opens(slave, at_ms=number, master=A))
        plant.append(said(*IDENTIFY, slave=slave, at_ms=number + 0.5))
    for turn in range(3):
        for number, slave in enumerate(slaves):
            for request in range(3):
                asked = f"03 {request * 100:04X} 0001"
                at_ms = 1000 + turn * 1000 + number * 5 + request
                plant.append(said(asked, slave=slave, at_ms=at_ms))
    assert found(plant) == []


def test_a_master_that_polls_registers_that_a_slave_lacks_is_no_scan() -> None:
    wrong = [said(f"03 {one:04X} 0001", "83 02", at_ms=one * 20) for one in range(40)]
    assert found([*wrong, *wrong]) == []


def test_functions_of_the_profile_are_no_scan() -> None:
    requests = [said(f"{0x41 + one:02X} 00", None, at_ms=one * 10) for one in range(4)]
    limit = "SEC-203=4/1s"
    assert [one.code for one in found(requests, limit)] == ["SEC-203"]
    assert found(requests, limit, profile="fa3-at1m8x") == []


def test_an_ambiguous_frame_is_no_attack() -> None:
    one = on_line("08 0004 0000", None, verdicts=(Verdict.AMBIGUOUS,))
    one = msgspec.structs.replace(one, verdicts=[Verdict.AMBIGUOUS])
    assert found([one]) == []


def test_a_response_without_a_request_is_no_attack() -> None:
    assert found([said("", "08 0004 0000")]) == []


# Identification.


@pytest.mark.parametrize(
    ("request_", "text"), [("2B 0E 01 00", "2B/0E"), ("11", "11H"), ("42 00", "42H")]
)
def test_a_new_host_that_reads_the_identification_is_found(request_: str, text: str) -> None:
    late = said(request_, None, master=B, at_ms=301_000)
    assert messages([said(), late]) == [
        ("SEC-205", 1, f"{B}, which was not heard in the first 300 s, reads {text} of {PLC}:502")
    ]


def test_a_host_of_the_first_minutes_may_read_the_identification() -> None:
    for first in (said(master=B, at_ms=299_000), opens(PLC, at_ms=299_000, master=B)):
        assert found([said(), first, said(*IDENTIFY, master=B, at_ms=900_000)]) == []


def test_other_objects_of_2b_are_no_identification() -> None:
    assert found([said(), said("2B 0D 00", None, master=B, at_ms=900_000)]) == []


@given(*limits)
def test_so_many_identifications_by_a_new_host_are_a_finding(number: int, seconds: int) -> None:
    def reads(times: int, since_ms: float) -> list[NamedTransaction]:
        late = [said(*IDENTIFY, master=B, at_ms=since_ms + one) for one in range(times)]
        return [said(), *late]

    limit, begin_ms = f"SEC-205={number}/{seconds}s", seconds * SECOND
    assert [one.count for one in found(reads(number, begin_ms + 1), limit)] == [number]
    assert found(reads(number - 1, begin_ms + 1), limit) == []
    assert found(reads(number, begin_ms), limit) == []


# Memory.


def test_a_scan_of_many_addresses_needs_little_memory() -> None:
    rules = SecurityRules(SecurityLimits())
    tracemalloc.start()
    for number in range(16_384):
        slave = f"10.1.{number >> 8}.{number & 255}"
        rules.event(opens(slave, at_ms=number))
        if number % 8 == 0:
            rules.transaction(said(master=B, slave=slave, at_ms=number), None)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    (finding,) = rules.close()
    assert (finding.code, finding.count) == ("SEC-201", 16_384)
    assert held < 12 << 20
