"""A recording made from transactions."""

from __future__ import annotations

import msgspec
import pytest

from mbtool.modbus import Table, Transport
from mbtool.replay.recording import RecordedAnswer, Recording
from mbtool.replay.timeline import TimeRange
from tests.replay.recorded import LATENCY_NS, MS, answered, to_all, unanswered, unasked

HOLDING = Table.HOLDING_REGISTERS
READ = "03 0000 0001"
READ_PDU = bytes.fromhex(READ)


def _value(recording: Recording, address: int, at_ms: int, unit: int = 1) -> int | None:
    found = recording.timeline(unit, HOLDING).at(address, at_ms * MS)
    return None if found is None else found[0]


@pytest.mark.parametrize("transport", list(Transport))
def test_keeps_the_answers_of_a_request_in_order(transport: Transport) -> None:
    recording = Recording.of(
        [
            answered(0, READ, "03 02 0001", transport=transport),
            answered(100, READ, "03 02 0002", transport=transport, latency_ns=7 * MS),
        ]
    )
    assert recording.answers == {
        (1, READ_PDU): [
            RecordedAnswer(b"\x03\x02\x00\x01", LATENCY_NS, LATENCY_NS),
            RecordedAnswer(b"\x03\x02\x00\x02", 107 * MS, 7 * MS, 100 * MS),
        ]
    }


def test_equal_requests_share_one_object() -> None:
    recording = Recording.of([answered(at, READ, "03 02 0001") for at in (0, 10)])
    (first, _), (second, _) = recording.order
    assert first is second


def test_orders_by_the_time_of_the_request() -> None:
    # What got no answer comes out of the decoder late.
    recording = Recording.of([answered(100, READ, "03 02 0001"), unanswered(0, READ)])
    assert [answer.pdu for answer in recording.answers[1, READ_PDU]] == [
        None,
        b"\x03\x02\x00\x01",
    ]
    assert recording.begin_ns == 0


@pytest.mark.parametrize(
    ("unit", "pdu", "has"),
    [
        (1, "03 0000 0001", True),
        (1, "03 0000 0002", False),
        (2, "03 0000 0001", False),
        (1, "06 0005 0001", True),
        (1, "06 0005 1234", True),
        (1, "06 0006 0001", False),
        (1, "08 0000 1234", True),
        (1, "08 0000 1235", False),
        (1, "03 0000", False),
    ],
)
def test_a_request_was_recorded_if_one_asks_for_the_same_whatever_it_writes(
    unit: int, pdu: str, has: bool
) -> None:
    recording = Recording.of(
        [
            answered(0, READ, "03 02 0001"),
            answered(10, "06 0005 0001", "06 0005 0001"),
            answered(20, "08 0000 1234", "08 0000 1234"),
        ]
    )
    assert recording.has(unit, bytes.fromhex(pdu)) is has


def test_unsolicited_responses_are_left_out() -> None:
    recording = Recording.of([unasked(0, "03 02 0001")])
    assert recording.answers == {}
    assert recording.units == set()


def test_values_come_from_reads_and_from_acknowledged_writes() -> None:
    recording = Recording.of(
        [
            answered(0, "03 0000 0002", "03 04 0001 0002"),
            answered(100, "06 0001 0009", "06 0001 0009"),
            answered(200, "10 0002 0002 04 0003 0004", "10 0002 0002"),
            answered(300, "06 0000 0007", "86 04"),  # refused
            unanswered(400, "06 0000 0008"),
        ]
    )
    assert [_value(recording, address, 500) for address in range(5)] == [1, 9, 3, 4, None]
    assert _value(recording, 1, 50) == 2


def test_values_come_from_masks_and_from_reads_with_writes() -> None:
    recording = Recording.of(
        [
            answered(0, "16 0000 00F2 0025", "16 0000 00F2 0025"),  # of a value not known yet
            answered(100, "17 0000 0002 0001 0001 02 0055", "17 04 0012 0055"),
            answered(200, "16 0000 00F2 0025", "16 0000 00F2 0025"),
        ]
    )
    assert _value(recording, 0, 150) == 0x12
    assert _value(recording, 1, 150) == 0x55
    assert _value(recording, 0, 300) == 0x17


def test_padding_bits_after_the_quantity_are_no_values() -> None:
    recording = Recording.of([answered(0, "01 0000 0003", "01 01 05")])
    coils = recording.timeline(1, Table.COILS)
    assert [coils.at(address, MS) for address in range(4)] == [
        (1, 0),
        (0, 0),
        (1, 0),
        None,
    ]


def test_a_malformed_answer_gives_no_values() -> None:
    recording = Recording.of([answered(0, "03 0000 0002", "03 02 0001")])
    assert _value(recording, 0, 100) is None
    assert len(recording.answers) == 1


def test_a_broadcast_write_counts_for_every_unit() -> None:
    recording = Recording.of(
        [
            answered(0, READ, "03 02 0001", unit=1),
            answered(100, READ, "03 02 0002", unit=2),
            to_all(200, "06 0000 0009"),
        ]
    )
    assert recording.units == {1, 2}
    assert [_value(recording, 0, 300, unit) for unit in (0, 1, 2)] == [None, 9, 9]
    assert recording.answers[0, bytes.fromhex("06 0000 0009")][0].pdu is None


def test_tells_the_median_latency_of_unit_and_function() -> None:
    recording = Recording.of(
        [
            *(answered(at, READ, "03 02 0001", latency_ns=at) for at in (1, 2, 900)),
            answered(4, "04 0000 0001", "84 02", latency_ns=50),
            unanswered(5, "01 0000 0001"),
        ]
    )
    assert recording.latency_ns(1, 0x03) == 2
    assert recording.latency_ns(1, 0x04) == 50
    assert recording.latency_ns(1, 0x01) == 2  # Of all answers: 1, 2, 50 and 900.
    assert recording.latency_ns(2, 0x03) == 0


@pytest.mark.parametrize("transport", list(Transport))
def test_an_adu_that_is_cut_short_is_left_out(transport: Transport) -> None:
    whole = answered(0, READ, "03 02 0001", transport=transport)
    assert whole.request_raw is not None
    for size in range(4):
        cut = msgspec.structs.replace(whole, request_raw=whole.request_raw[:size])
        assert Recording.of([cut]).answers == {}


def test_a_time_range_has_its_own_answers_and_all_values() -> None:
    transactions = [
        answered(at, READ, f"03 02 000{at // 100}", latency_ns=0) for at in (0, 100, 200, 300)
    ]
    recording = Recording.of(transactions, TimeRange(100 * MS, 300 * MS))
    assert [answer.asked_ns for _, answer in recording.order] == [100 * MS, 200 * MS]
    assert (recording.begin_ns, recording.length_ns) == (100 * MS, 200 * MS)
    assert [_value(recording, 0, at) for at in (0, 150, 400)] == [0, 1, 3]
    until_the_end = Recording.of(transactions, TimeRange(100 * MS))
    assert until_the_end.length_ns == 200 * MS
    assert [recording.next_ns(at * MS) for at in (0, 100, 200)] == [100 * MS, 200 * MS, None]


def test_tells_all_latencies_of_unit_and_function() -> None:
    recording = Recording.of(
        [
            *(answered(at, READ, "03 02 0001", latency_ns=at) for at in (3, 1, 2)),
            answered(4, "04 0000 0001", "84 02", latency_ns=50),
        ]
    )
    assert list(recording.latencies(1, 0x03)) == [1, 2, 3]
    assert list(recording.latencies(1, 0x10)) == [1, 2, 3, 50]
    assert list(recording.latencies(2, 0x03)) == []
