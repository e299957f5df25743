from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.connections import (
    MAX_PENDING,
    MAX_RECENT,
    ConnectionRules,
    is_foreign_message,
)
from mbtool.modbus.adu import Verdict
from tests.devices.checking.talk import MASTER, SLAVE, event, opened, transaction

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.named_transaction import NamedTransaction

FOREIGN_MESSAGE = bytes.fromhex("0001 0001 0006 01 03 0000 0001")


def found(
    *records: NamedTransaction | WireEvent, ports: frozenset[int] | None = None
) -> list[tuple[str, str]]:
    rules = ConnectionRules(ports)
    findings: list[Finding] = []
    for record in records:
        if isinstance(record, WireEvent):
            findings += rules.event(record)
        else:
            findings += rules.transaction(record)
    return [(one.code, one.message) for one in (*findings, *rules.close())]


def codes(*records: NamedTransaction | WireEvent, ports: frozenset[int] | None = None) -> list[str]:
    return [code for code, _ in found(*records, ports=ports)]


def test_two_open_requests_with_one_id_are_found() -> None:
    first = transaction(at_ms=0, latency_ms=20)
    second = transaction("04 0000 0001", "04 02 0007", at_ms=10, latency_ms=20)
    assert found(first, second) == [
        ("TCP-101", "read input 0: transaction id 0001H is also another open request's")
    ]


def test_ids_may_be_used_again_by_others_and_later() -> None:
    first = transaction(at_ms=0, latency_ms=20)
    assert codes(first, transaction(at_ms=10, latency_ms=20, number=2)) == []
    assert codes(first, transaction(at_ms=10, latency_ms=20, source="10.0.0.1:2")) == []
    assert codes(first, transaction(at_ms=20, latency_ms=20)) == []
    # The one that was given up is not open.
    assert codes(transaction(response=None), transaction(at_ms=10)) == []


def test_an_answer_with_another_id_is_found() -> None:
    odd = transaction(number=4, answer_number=5, verdicts=(Verdict.OTHER_TRANSACTION_ID,))
    assert found(odd) == [
        ("TCP-102", "read holding 0: answer with id 0005H to a request with id 0004H")
    ]


def test_another_protocol_id_is_found() -> None:
    assert found(event(EventKind.FOREIGN, raw=FOREIGN_MESSAGE)) == [
        ("TCP-103", "protocol id 0001H in a message of 12 bytes")
    ]
    assert not is_foreign_message(FOREIGN_MESSAGE + b"\0")
    assert not is_foreign_message(bytes.fromhex("0001 0000 0002 01 03"))
    assert not is_foreign_message(b"\x16\x03\x01")


def test_another_protocol_is_found_where_modbus_is_expected() -> None:
    tls = event(EventKind.FOREIGN, message="it is TLS", raw=b"\x16\x03\x01\x00\x10")
    assert found(tls) == [("TCP-201", "it is TLS")]
    assert codes(tls, ports=frozenset({502})) == ["TCP-201"]
    assert codes(tls, ports=frozenset({1502})) == []


def test_bytes_that_are_no_adu_are_found_when_the_capture_goes_on() -> None:
    junk = event(EventKind.SKIPPED, message="8 bytes", at_ms=10)
    later = transaction(at_ms=2000)
    assert found(transaction(), junk, later) == [("TCP-202", "8 bytes")]
    assert codes(opened(), junk, later) == ["TCP-202"]


def test_bytes_at_the_edges_of_a_capture_are_no_finding() -> None:
    junk = event(EventKind.SKIPPED, message="8 bytes", at_ms=10)
    later = transaction(at_ms=2000)
    assert codes(opened(joined=True), junk, later) == []
    assert codes(junk, later) == []
    assert codes(transaction(), junk, transaction(at_ms=500)) == []


@pytest.mark.parametrize("kind", [EventKind.GAP, EventKind.CUT, EventKind.DISCARDED])
@pytest.mark.parametrize("ends", [(MASTER, SLAVE), (SLAVE, MASTER)])
def test_bytes_beside_missing_bytes_are_no_finding(kind: EventKind, ends: tuple[str, str]) -> None:
    source, destination = ends
    lost = event(kind, at_ms=20, source=source, destination=destination)
    for at_ms in (10, 30):
        junk = event(EventKind.SKIPPED, at_ms=at_ms, source=source, destination=destination)
        records = sorted([junk, lost], key=lambda one: one.ts_ns)
        assert codes(opened(), transaction(), *records, transaction(at_ms=2000)) == []
    # Once a request was answered again, all is as before.
    after = event(EventKind.SKIPPED, at_ms=3000)
    again = (transaction(at_ms=2000), after, transaction(at_ms=5000))
    assert codes(opened(), transaction(), lost, *again) == ["TCP-202"]


def test_a_retransmission_that_differs_is_found() -> None:
    assert codes(event(EventKind.OVERLAP)) == ["TCP-203"]


def test_ordinary_events_are_no_finding() -> None:
    kinds = (EventKind.CLOSED, EventKind.REFUSED, EventKind.UNREADABLE, EventKind.GAP)
    assert codes(opened(), *map(event, kinds)) == []


def test_memory_is_bounded() -> None:
    rules = ConnectionRules(None)
    assert not [*rules.event(opened())]
    told = 0
    for number in range(2 * MAX_PENDING):
        assert not [*rules.transaction(transaction(number=number, at_ms=number / 1000))]
        told += len([*rules.event(event(EventKind.SKIPPED, at_ms=number / 1000))])
    assert told == MAX_PENDING
    (connection,) = rules._connections.values()
    assert len(connection.recent) == MAX_RECENT
