"""Decoding of one serial line or one TCP connection."""

from __future__ import annotations

from mbtool.core import Connection, Direction, Endpoint, EventKind, SerialFormat, WireEvent
from mbtool.decode.connections import Bus, ConnectionDecoder
from mbtool.decode.network_pairing import TIMEOUT_NS
from mbtool.decode.pairing import BUS_TIMEOUT_NS
from mbtool.modbus.adu import Adu, ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.pdu import exception_pdu
from mbtool.modbus.transaction import Outcome, Transaction
from tests.adversary.judgement import decode
from tests.feeding import START_NS, Line, feed_all
from tests.modbus.reading import adus, transactions, wire_events
from tests.packets.building import Talk

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
FORMAT = SerialFormat(19200)
MASTER, SLAVE = Endpoint("10.0.0.1", 40000), Endpoint("10.0.0.9", 502)
READ = bytes.fromhex("03 006B 0001")
ANSWER = bytes.fromhex("03 02 022B")


def connection(*, rtu: bool = False) -> ConnectionDecoder:
    return ConnectionDecoder(Connection(MASTER, SLAVE), rtu=rtu)


def test_each_adu_and_each_complete_transaction_is_returned() -> None:
    talk = connection()
    (request,) = talk.feed(REQUEST, mbap_adu(1, 5, READ), 100)
    response, transaction = talk.feed(RESPONSE, mbap_adu(1, 5, ANSWER), 200)
    assert isinstance(request, Adu)
    assert isinstance(response, Adu)
    assert isinstance(transaction, Transaction)
    assert (transaction.link, transaction.source, transaction.destination) == (
        "10.0.0.9", "10.0.0.1:40000", "10.0.0.9:502",
    )  # fmt: skip
    assert (transaction.request_ns, transaction.latency_ns) == (100, 100)
    assert transaction.request_raw == mbap_adu(1, 5, READ)


def test_a_connection_can_carry_rtu_over_tcp() -> None:
    talk = connection(rtu=True)
    decoded = talk.feed(REQUEST, rtu_adu(5, READ), 100)
    decoded += talk.feed(RESPONSE, rtu_adu(5, exception_pdu(3, 2)), 200)
    (transaction,) = transactions(decoded)
    assert (transaction.transport, transaction.outcome) == ("rtu-tcp", Outcome.EXCEPTION)
    assert transaction.transaction_id is None


def test_skipped_bytes_name_their_sender() -> None:
    talk = connection()
    decoded = talk.feed(RESPONSE, b"\xff" * 9, 100) + talk.close()
    assert b"".join(event.raw for event in wire_events(decoded)) == b"\xff" * 9
    first = wire_events(decoded)[0]
    assert (first.kind, first.link) == (EventKind.SKIPPED, "10.0.0.9")
    assert (first.source, first.destination) == ("10.0.0.9:502", "10.0.0.1:40000")
    assert first.message == "3 bytes: no Modbus/TCP header"


def test_a_gap_is_an_event_and_ends_the_incomplete_adu() -> None:
    talk = connection()
    talk.feed(REQUEST, mbap_adu(1, 5, READ)[:9], 100)
    talk.feed(RESPONSE, mbap_adu(1, 5, ANSWER)[:7], 100)
    decoded = talk.gap(REQUEST, 100, 200)
    (gap,) = wire_events(decoded)
    assert [one.raw for one in adus(decoded)] == [mbap_adu(1, 5, READ)[:9]]
    held, _ = wire_events(talk.gap(RESPONSE, 100, 200))
    assert held.raw == mbap_adu(1, 5, ANSWER)[:7]
    assert (gap.kind, gap.missing, gap.ts_ns) == (EventKind.GAP, 100, 200)
    assert gap.message == "100 bytes are missing from the capture"
    assert gap.source == "10.0.0.1:40000"
    decoded = talk.feed(REQUEST, mbap_adu(2, 5, READ), 300)
    assert len(adus(decoded)) == 1


def test_a_gap_in_one_direction_does_not_affect_the_other() -> None:
    talk = connection()
    for number in (1, 2):
        talk.feed(REQUEST, mbap_adu(number, 5, READ), 100)
    talk.gap(REQUEST, 12, 150)
    decoded = talk.feed(RESPONSE, mbap_adu(1, 5, ANSWER), 200)
    assert [one.outcome for one in transactions(decoded)] == [Outcome.OK]


def test_a_response_behind_a_lost_request_of_the_same_id_is_not_joined_to_an_earlier_one() -> None:
    talk = connection()
    talk.feed(REQUEST, mbap_adu(0, 5, READ), 100)
    talk.gap(REQUEST, 12, 150)
    (response,) = transactions(talk.feed(RESPONSE, mbap_adu(0, 5, ANSWER), 200))
    assert (response.outcome, response.request_raw) == (Outcome.NOT_CAPTURED, None)


def test_an_acknowledgement_tells_when_a_request_was_sent_that_the_capture_lacks() -> None:
    """The first request of a master with one id is not captured and was never answered."""
    talk = Talk()
    packets = talk.handshake()
    lost = talk.request(mbap_adu(0, 17, READ))
    packets.append(talk.send(talk.slave))  # The slave acknowledges it, and says nothing.
    talk.ts_ns = lost.ts_ns + 500_000_000
    for number in range(4):
        packets.append(talk.request(mbap_adu(0, 17, READ)))
        packets.append(talk.response(mbap_adu(0, 17, bytes([3, 2, 0, number]))))
        talk.ts_ns += 50_000_000
    found = decode(packets)
    assert [one.outcome for one in found] == [Outcome.OK] * 4
    assert {one.latency_ns for one in found} == {1_000_000}


def test_open_request_stays_unanswered_when_the_connection_ends_or_time_passes() -> None:
    talk = connection()
    talk.feed(REQUEST, mbap_adu(1, 5, READ), 100)
    assert [one.outcome for one in transactions(talk.close())] == [Outcome.NO_ANSWER]
    talk.feed(REQUEST, mbap_adu(1, 5, READ), 100)
    assert talk.advance(100 + TIMEOUT_NS) == []
    decoded = talk.advance(101 + TIMEOUT_NS)
    assert [one.outcome for one in transactions(decoded)] == [Outcome.NO_ANSWER]


def test_a_bus_pairs_requests_and_responses_of_one_tap() -> None:
    sent = Line(FORMAT).send(rtu_adu(5, READ)).frame(rtu_adu(5, ANSWER), before_ns=8_000_000)
    decoded = feed_all(Bus("rs485", FORMAT), sent.reads())
    (transaction,) = transactions(decoded)
    assert [type(one) for one in decoded] == [Adu, Adu, Transaction]
    assert (transaction.link, transaction.source) == ("rs485", None)
    assert transaction.latency_ns == 8_000_000


def test_a_bus_can_be_ascii() -> None:
    line = SerialFormat(9600, 7, "E", 1)
    sent = Line(line).send(ascii_adu(5, READ)).frame(ascii_adu(5, ANSWER))
    decoded = feed_all(Bus("rs485", line, ascii=True), sent.reads())
    assert [(one.transport, one.outcome) for one in transactions(decoded)] == [
        ("ascii", Outcome.OK),
    ]  # fmt: skip


def test_a_bus_reports_skipped_bytes() -> None:
    sent = Line(FORMAT).send(b"\xff" * 9)
    (event,) = feed_all(Bus("rs485", FORMAT), sent.reads())
    assert isinstance(event, WireEvent)
    assert (event.link, event.source, event.raw) == ("rs485", "", b"\xff" * 9)
    assert event.message == "9 bytes: no frame with a correct CRC begins here"


def test_silence_ends_a_frame_and_later_the_pending_request() -> None:
    bus = Bus("rs485", FORMAT)
    assert bus.feed(rtu_adu(5, READ), START_NS) == []
    assert [type(one) for one in bus.advance(START_NS + FORMAT.t3_5_ns)] == [Adu]
    assert bus.advance(START_NS + BUS_TIMEOUT_NS) == []
    (transaction,) = transactions(bus.advance(START_NS + BUS_TIMEOUT_NS + 1))
    assert transaction.outcome is Outcome.NO_ANSWER


def test_request_does_not_time_out_while_its_response_is_on_the_wire() -> None:
    bus = Bus("rs485", FORMAT)
    response = rtu_adu(5, ANSWER)
    bus.feed(rtu_adu(5, READ), START_NS)
    bus.feed(response, START_NS + BUS_TIMEOUT_NS - 1)
    assert bus.advance(START_NS + BUS_TIMEOUT_NS + 1) == []
    decoded = bus.advance(START_NS + BUS_TIMEOUT_NS + FORMAT.t3_5_ns)
    assert [one.outcome for one in transactions(decoded)] == [Outcome.OK]


def test_skipped_bytes_can_time_out_the_pending_request() -> None:
    bus = Bus("rs485", FORMAT)
    bus.feed(rtu_adu(5, READ), START_NS)
    noise_ns = START_NS + 2 * BUS_TIMEOUT_NS
    decoded = bus.feed(b"\xff" * 9, noise_ns) + bus.close()
    assert [type(one) for one in decoded] == [Adu, Transaction, WireEvent]
