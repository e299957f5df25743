"""Each illness of a network is named by its code, and healthy networks have none."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.rules import Severity
from mbtool.ledger.account import Account
from mbtool.modbus import Outcome, Transport
from mbtool.troubles.judge import Judge
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.reading import ReadingOptions
from tests.captures import public_folder
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import request, unanswered

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.troubles.judge import Judgement
    from mbtool.troubles.trouble import Trouble

MASTER, SLAVE = "10.0.0.1", "10.0.0.2"
CAPTURES = sorted(
    path
    for path in public_folder().rglob("*")
    if path.name.endswith((".pcap", ".pcapng", ".gz", ".sr"))
    and path.stat().st_size <= 1_500_000
    and "cutfile" not in path.name
)


def on(*, master: str = MASTER, slave: str = SLAVE, **fields: Any) -> dict[str, Any]:
    return {
        "link": slave, "source": f"{master}:50000", "destination": f"{slave}:502",
        "transport": Transport.TCP, **fields,
    }  # fmt: skip


def asked(at_ms: float, address: int = 0, latency_ms: float = 5, **fields: Any) -> Any:
    latency_ns = round(latency_ms * MS)
    return request(
        at_ms, address, latency_ns=latency_ns,
        response_ns=START_NS + round(at_ms * MS) + latency_ns, **on(**fields),
    )  # fmt: skip


def missing(at_ms: float, **fields: Any) -> Any:
    return unanswered(at_ms, **on(**fields))


def judged(records: Iterable[NamedTransaction | WireEvent]) -> Judgement:
    judge = Judge(Account())
    for record in records:
        judge.count(record)
    judge.ledger.settle()
    return judge.judgement()


def serious(told: Judgement) -> list[str]:
    return [one.code for one in told.troubles if one.severity is not Severity.NOTE]


def of_code(told: Judgement, code: str) -> Trouble:
    (trouble,) = (one for one in told.troubles if one.code == code)
    return trouble


def test_a_healthy_network_has_no_trouble() -> None:
    records = [asked(100 * at + 10 * unit, unit=unit) for at in range(100) for unit in (1, 2, 3)]
    told = judged(records)
    assert (told.level, [*told.troubles]) == ("well", [])


def test_a_unit_that_holds_up_the_line_of_a_gateway_is_the_cause() -> None:
    records: list[Any] = []
    for at in range(60):
        records.append(asked(1000 * at, unit=1, latency_ms=20))
        if at % 5:
            records.append(asked(1000 * at + 100, unit=2, latency_ms=20))
        else:
            records += [
                missing(1000 * at + 90, unit=3),
                missing(1000 * at + 100, unit=2, master="10.0.0.9"),
            ]
    told = judged(records)
    trouble = of_code(told, "NET-BLOCKED")
    assert (trouble.unit, trouble.victims, trouble.count) == (3, (2,), 12)
    assert "UNIT-MISSING" not in serious(told)
    assert ("UNIT-SILENT", 3) in [(one.code, one.unit) for one in told.troubles]


def test_each_time_names_the_unit_whose_answer_the_others_wait_for() -> None:
    records: list[Any] = []
    for at in range(120):
        start_ms = 2000 * at
        silent, other = (3, 2) if at < 50 else (2, 3)
        if at % 5 or 40 <= at < 70:
            records += [asked(start_ms + 90 * unit, unit=unit, latency_ms=60) for unit in (1, 2, 3)]
            continue
        records += [
            missing(start_ms, unit=silent),
            asked(start_ms + 50, unit=other, latency_ms=1100),
            asked(start_ms + 700, unit=1, latency_ms=520, master="10.0.0.9"),
            asked(start_ms + 750, 8, unit=other, latency_ms=540, master="10.0.0.8"),
        ]
    told = [one for one in judged(records).troubles if one.code == "NET-BLOCKED"]
    assert {(one.unit, one.victims) for one in told} == {(3, (1, 2)), (2, (1, 3))}
    first, second = sorted(told, key=lambda one: one.evidence[0].ts_ns)
    assert (first.since_ns, second.until_ns) == (None, None)
    assert first.until_ns is not None
    assert second.since_ns is not None
    assert first.until_ns < second.since_ns
    assert "holds up the line behind its gateway for 1.15 s each time" in first.cause


def test_what_is_answered_before_a_slow_request_did_not_wait_for_it() -> None:
    records = [asked(3000 * at, unit=1, latency_ms=2000) for at in range(40)]
    records += [asked(3000 * at + 500, unit=2, latency_ms=400) for at in range(40)]
    assert "NET-BLOCKED" not in [one.code for one in judged(records).troubles]


def test_two_units_that_are_slow_by_themselves_block_nobody() -> None:
    records = [
        asked(2000 * at + 1000 * (unit - 1), unit=unit, latency_ms=400)
        for at in range(50)
        for unit in (1, 2)
    ]
    assert "NET-BLOCKED" not in [one.code for one in judged(records).troubles]


def test_answers_after_the_masters_next_request_are_late() -> None:
    records = [asked(1000 * at) for at in range(60)]
    records += [asked(1000 * at + 100, 9, latency_ms=620) for at in (5, 15, 25, 35)]
    records += [asked(1000 * at + 600, 9) for at in (5, 15, 25, 35)]
    trouble = of_code(judged(records), "NET-LATE")
    assert (trouble.unit, trouble.count) == (1, 4)
    assert "answers after 620 ms, the master sends its next request after 500 ms" in trouble.cause


def test_a_master_that_pipelines_gives_nothing_up() -> None:
    records = [asked(100 * at, latency_ms=450) for at in range(100)]
    assert "NET-LATE" not in [one.code for one in judged(records).troubles]


def test_polls_that_wait_for_a_delayed_acknowledgement_are_a_note() -> None:
    records = [asked(500 * at, latency_ms=3) for at in range(60)]
    records += [
        asked(500 * at + 200, 9, latency_ms=200 + at % 3 if at % 10 else 20) for at in range(30)
    ]
    trouble = of_code(judged(records), "NET-DELAYED-ACK")
    assert trouble.severity is Severity.NOTE
    assert trouble.cause.startswith("1 poll of unit 1 takes 2")
    assert serious(judged(records)) == []


def test_messages_in_two_parts_that_wait_for_an_acknowledgement_are_a_note() -> None:
    answers = [asked(500 * at, latency_ms=3) for at in range(60)]
    answers[:20] = [
        msgspec.structs.replace(one, response_ns=one.response_ns + 200 * MS) for one in answers[:20]
    ]
    trouble = of_code(judged(answers), "NET-DELAYED-ACK")
    assert (trouble.unit, trouble.count, trouble.of) == (1, 20, 60)
    assert trouble.cause.startswith(
        "20 answers of unit 1 come in two segments, the second 200 ms after the first"
    )
    requests = [asked(500 * at, request_parts_ns=40 * MS) for at in range(60)]
    trouble = of_code(judged(requests), "NET-DELAYED-ACK")
    assert (trouble.master, trouble.count) == (MASTER, 60)
    odd = [asked(500 * at, request_parts_ns=(31 + 7 * at) * MS) for at in range(60)]
    assert "NET-DELAYED-ACK" not in [one.code for one in judged(odd).troubles]


def in_turn(number: int, *, is_serial: bool) -> list[Any]:
    """Requests of two masters, at odd times. A serial server serves them one after the other."""
    random, records, free_ms = Random(7), [], 0.0
    asking = sorted(
        (1000 * at + random.uniform(0, 700), master)
        for at in range(number)
        for master in (MASTER, "10.0.0.9")
    )
    for at_ms, master in asking:
        served_ms = random.uniform(150, 350)
        end_ms = (max(at_ms, free_ms) if is_serial else at_ms) + served_ms
        free_ms = end_ms
        records.append(asked(at_ms, master=master, latency_ms=end_ms - at_ms))
    return records


def test_masters_that_wait_for_each_other_at_a_gateway_are_told() -> None:
    trouble = of_code(judged(in_turn(100, is_serial=True)), "NET-SHARED")
    assert trouble.cause.startswith(f"{MASTER} and 10.0.0.9 ask {SLAVE} at once")
    assert trouble.evidence


def test_requests_with_equal_times_are_judged() -> None:
    waits = in_turn(100, is_serial=True)
    equal = [one for one in waits for _ in range(2)]
    equal += [msgspec.structs.replace(one, address=None) for one in waits]
    equal += [
        missing(1000 * at, unit=3, master=each) for at in range(60) for each in (MASTER, "10.0.0.9")
    ]
    judged(equal)


def test_a_slave_that_serves_two_masters_at_once_is_not_shared() -> None:
    told = judged(in_turn(100, is_serial=False))
    assert "NET-SHARED" not in [one.code for one in told.troubles]


def sent_again(at_ms: float, *, by_slave: bool = False) -> WireEvent:
    ends = f"{MASTER}:50000", f"{SLAVE}:502"
    source, destination = ends[::-1] if by_slave else ends
    return WireEvent(
        ts_ns=START_NS + round(at_ms * MS), link=SLAVE, kind=EventKind.SENT_AGAIN,
        message="", source=source, destination=destination,
    )  # fmt: skip


def test_a_path_that_loses_packets_is_told() -> None:
    records: list[Any] = []
    for at in range(100):
        if at % 10 == 0:
            records += [sent_again(100 * at + 1), sent_again(100 * at + 2, by_slave=True)]
        records.append(asked(100 * at))
    trouble = of_code(judged(records), "NET-LOSSY")
    assert (trouble.count, trouble.of, trouble.severity) == (20, 200, Severity.WARNING)
    assert trouble.cause.startswith(f"20 of 200 messages between {MASTER} and {SLAVE} are sent")


def test_a_single_loss_that_holds_answers_up_is_a_note() -> None:
    records: list[Any] = [asked(500 * at) for at in range(60)]
    records[20:20] = [sent_again(10_300), sent_again(11_500), asked(10_010, 9, latency_ms=3700)]
    trouble = of_code(judged(records), "NET-LOSSY")
    assert (trouble.count, trouble.severity, len(trouble.evidence)) == (2, Severity.NOTE, 2)
    assert "are sent again, an answer took 3.70 s then" in trouble.cause


def test_what_is_sent_again_to_a_dead_host_is_no_loss() -> None:
    records: list[Any] = [asked(100 * at) for at in range(100)]
    for at in range(20):
        records += [missing(20_000 + 1000 * at), sent_again(20_300 + 1000 * at)]
    assert "NET-LOSSY" not in [one.code for one in judged(records).troubles]


def test_a_slave_that_always_takes_long_is_not_told_of_acknowledgements() -> None:
    records = [asked(500 * at, 9, latency_ms=200) for at in range(60)]
    assert "NET-DELAYED-ACK" not in [one.code for one in judged(records).troubles]


@pytest.mark.parametrize("side", ["requests", "responses"])
def test_one_direction_blames_no_unit(side: str) -> None:
    lacking: dict[str, Any] = {"outcome": Outcome.NOT_CAPTURED, "latency_ns": None}
    if side == "requests":
        lacking |= {"response_ns": None, "response_raw": None}
    else:
        lacking |= {"request_ns": None, "request_raw": None}
    records = [request(100 * at, **on(), **lacking) for at in range(50)]
    told = judged([*records, *([missing(6000)] if side == "requests" else [])])
    assert serious(told) == ["NET-ONE-SIDE"]
    assert f"only {side} of {SLAVE}" in told.troubles[0].cause


def test_a_capture_that_cuts_packets_is_not_one_direction() -> None:
    cut = WireEvent(
        ts_ns=START_NS, link=SLAVE, kind=EventKind.CUT, message="", source=SLAVE, destination=MASTER
    )
    lacking: dict[str, Any] = {
        "outcome": Outcome.NOT_CAPTURED, "latency_ns": None, "response_ns": None,
        "response_raw": None,
    }  # fmt: skip
    records = [request(100 * at, **on(), **lacking) for at in range(50)]
    assert serious(judged([*records, *[cut] * 50])) == []


def test_two_addresses_of_one_host_in_its_own_network_are_told() -> None:
    own, other = "00:00:00:00:00:01", "00:00:00:00:00:66"
    records = [
        asked(100 * at, source_mac="00:00:00:00:00:aa", destination_mac=other if at % 3 else own)
        for at in range(60)
    ]
    trouble = of_code(judged(records), "NET-TWO-MACS")
    assert trouble.who == SLAVE
    assert own in trouble.cause
    assert other in trouble.cause


def test_a_host_whose_answers_come_from_another_address_than_is_asked_is_told() -> None:
    own, other = "00:00:00:00:00:01", "00:00:00:00:00:66"
    records = [asked(100 * at, destination_mac=other, response_mac=own) for at in range(60)]
    trouble = of_code(judged(records), "NET-TWO-MACS")
    assert (trouble.who, trouble.count, trouble.of) == (SLAVE, 60, 120)


def test_a_router_and_a_replaced_device_are_no_second_device() -> None:
    own, router = "00:00:00:00:00:01", "00:00:00:00:00:66"
    far = [
        asked(100 * at, master="192.168.7.1", source_mac=router if at % 2 else own)
        for at in range(60)
    ]
    assert serious(judged(far)) == []
    replaced = [
        asked(100 * at, destination_mac=own if at < 30 else "00:00:00:00:00:77") for at in range(60)
    ]
    assert serious(judged(replaced)) == []


def test_a_slave_that_asks_later_is_told_and_a_concentrator_is_not() -> None:
    polled = [asked(1000 * at) for at in range(100)]
    later = [asked(1000 * at, master=SLAVE, slave="10.0.0.3") for at in range(60, 100)]
    trouble = of_code(judged([*polled, *later]), "NET-ROLE")
    assert (trouble.who, trouble.count) == (SLAVE, 40)
    always = [asked(1000 * at, master=SLAVE, slave="10.0.0.3") for at in range(100)]
    assert serious(judged([*polled, *always])) == []


def closed(at_ms: float, reason: str) -> WireEvent:
    return WireEvent(
        ts_ns=START_NS + round(at_ms * MS), link=SLAVE, kind=EventKind.CLOSED,
        message=f"connection closed: {reason}",
        source=f"{MASTER}:50000", destination=f"{SLAVE}:502",
    )  # fmt: skip


def opened(at_ms: float) -> WireEvent:
    return WireEvent(
        ts_ns=START_NS + round(at_ms * MS), link=SLAVE, kind=EventKind.OPENED,
        message="connection opened", source=f"{MASTER}:50000", destination=f"{SLAVE}:502",
    )  # fmt: skip


def test_lost_connections_are_told_with_how_they_ended() -> None:
    records = [asked(100 * at) for at in range(100)]
    events = [
        each for at in range(5) for each in (opened(2000 * at), closed(2000 * at + 9, "reset"))
    ]
    ends = [each for at in range(9) for each in (opened(at), closed(at, "finished"))]
    trouble = of_code(judged([*records, *events, *ends]), "NET-LOST")
    assert trouble.cause == f"5 connections of {MASTER} to {SLAVE} lost: 5 reset"
    assert len(trouble.evidence) == 5
    assert serious(judged([*records, *ends])) == []


@pytest.mark.public_captures
@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("ITI__ICS-Security-Tools/Modbus__modbus_test.pcap", "NET-BLOCKED"),
        ("kb221svs__modbus-anomaly-detection/modbus.pcap", "NET-TWO-MACS"),
        ("antoine-lemay__Modbus_dataset/send_a_fake_command_modbus_6RTU_with_operate.pcap",
         "NET-ROLE"),
        ("ITI__ICS-Security-Tools/mb2.pcap", "NET-DELAYED-ACK"),
        ("ITI__ICS-Security-Tools/Modbus__modbus_test.pcap", "NET-SHARED"),
    ],
)  # fmt: skip
def test_illnesses_in_captures_of_others_are_named(name: str, code: str) -> None:
    path = public_folder() / name
    if not path.exists():
        pytest.skip("no captures of others")
    assert code in [one.code for one in troubles_of(path)]


@pytest.mark.public_captures
@pytest.mark.parametrize("path", CAPTURES, ids=lambda path: path.name)
def test_each_trouble_of_captures_of_others_has_evidence(path: Path) -> None:
    told = [one for trouble in troubles_of(path) for one in trouble.all]
    assert [(one.code, one.who) for one in told if not one.evidence] == []


def test_figures_come_with_the_transactions_that_they_count() -> None:
    records: list[Any] = [asked(500 * at, unit=unit) for at in range(60) for unit in (1, 2, 3)]
    records[90:90] = [asked(15_100, latency_ms=400), asked(15_600, latency_ms=150)]
    records += [asked(500 * at + 50, unit=4, latency_ms=90 + at) for at in range(30)]
    late = of_code(judged(records), "POLL-LATE")
    assert [one.text for one in late.evidence] == ["answered after 400 ms", "answered after 150 ms"]
    slow = of_code(judged(records), "UNIT-SLOW")
    assert [one.text for one in slow.evidence[-2:]] == [
        "answered after 118 ms", "answered after 119 ms",
    ]  # fmt: skip


def troubles_of(path: Path) -> Sequence[Trouble]:
    run = CheckRun([str(path)], ReadingOptions())
    for _ in run.findings():
        pass
    return run.judgement().troubles


@pytest.mark.public_captures
def test_each_unit_that_holds_up_a_real_gateway_is_named_with_its_time() -> None:
    path = public_folder() / "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap"
    if not path.exists():
        pytest.skip("no captures of others")
    told = [one for one in troubles_of(path) if one.code == "NET-BLOCKED"]
    assert sorted((one.unit, one.when) for one in told) == [
        (2, " since 14:13:26"), (3, " from 14:12:38 to 14:13:11"),
    ]  # fmt: skip
