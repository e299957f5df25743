"""Transactions rendered to bytes and decoded again: what comes out is what went in."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Connection, Direction, Endpoint, SerialFormat
from mbtool.decode.connections import Bus, ConnectionDecoder, Decoded
from mbtool.modbus import Outcome, Transaction, ascii_adu, mbap_adu, rtu_adu
from mbtool.serial_line.bus_state import MAX_PENDING_NS
from tests.feeding import START_NS, Line, feed_all
from tests.modbus.reading import transactions, wire_events
from tests.strategies import SIZES, Exchange, exchanges

FORMAT = SerialFormat(19200, 8, "E", 1)
CONNECTION = Connection(Endpoint("10.0.0.1", 40000), Endpoint("10.0.0.9", 502))
LATENCY_NS = 7_000_000


@given(st.lists(exchanges(broadcasts=True), max_size=8), SIZES, st.booleans())
def test_bus_gives_the_transactions_that_were_on_it(
    script: list[Exchange], sizes: list[int], ascii_line: bool
) -> None:
    framed = ascii_adu if ascii_line else rtu_adu
    line = Line(FORMAT)
    for exchange in script:
        # A master that got no answer waits longer than any answer takes.
        line.frame(framed(exchange.unit, exchange.request), before_ns=2 * MAX_PENDING_NS)
        if exchange.response is not None:
            line.frame(framed(exchange.unit, exchange.response), before_ns=LATENCY_NS)
    decoded = feed_all(Bus("rs485", FORMAT, ascii=ascii_line), line.reads(sizes))
    assert wire_events(decoded) == []
    done = sorted(transactions(decoded), key=lambda one: one.start_ns)
    _are_the_same(done, script)


@given(st.lists(exchanges(), max_size=8), SIZES, st.booleans())
def test_conversation_gives_the_transactions_that_were_in_it(
    script: list[Exchange], sizes: list[int], in_step: bool
) -> None:
    conversation = ConnectionDecoder(CONNECTION)
    decoded: list[Decoded] = []
    now_ns = START_NS
    for number, exchange in enumerate(script):
        for direction, pdu in (
            (Direction.REQUEST, exchange.request),
            (Direction.RESPONSE, exchange.response),
        ):
            if pdu is not None:
                now_ns += LATENCY_NS
                adu = mbap_adu(number if in_step else 0, exchange.unit, pdu)
                decoded += conversation.feed(direction, adu[:5], now_ns)
                decoded += conversation.feed(direction, adu[5:], now_ns)
        if exchange.response is None and not in_step:
            # With equal ids the answer to an equal request would go to the older one.
            decoded += conversation.close()
    decoded += conversation.close()
    assert wire_events(decoded) == []
    done = sorted(transactions(decoded), key=lambda one: one.request_ns or 0)
    _are_the_same(done, script)


@given(st.lists(exchanges().filter(lambda each: each.response is not None), max_size=8), st.data())
def test_pipelined_answers_in_any_order_find_their_requests(
    script: list[Exchange], data: st.DataObject
) -> None:
    conversation = ConnectionDecoder(CONNECTION)
    decoded: list[Decoded] = []
    for number, exchange in enumerate(script):
        adu = mbap_adu(number, exchange.unit, exchange.request)
        decoded += conversation.feed(Direction.REQUEST, adu, START_NS + number)
    order = data.draw(st.permutations(range(len(script))))
    for number in order:
        response = script[number].response
        assert response is not None
        adu = mbap_adu(number, script[number].unit, response)
        decoded += conversation.feed(Direction.RESPONSE, adu, START_NS + LATENCY_NS)
    assert conversation.close() == []
    done = transactions(decoded)
    assert [one.transaction_id for one in done] == order
    _are_the_same(sorted(done, key=lambda one: one.transaction_id or 0), script)


def _are_the_same(done: list[Transaction], script: list[Exchange]) -> None:
    assert [(one.unit, one.outcome) for one in done] == [
        (exchange.unit, exchange.outcome) for exchange in script
    ]
    for one, exchange in zip(done, script, strict=True):
        assert {name: getattr(one, name) for name in exchange.says} == exchange.says
        if exchange.outcome in (Outcome.OK, Outcome.EXCEPTION):
            assert one.latency_ns is not None
            assert one.latency_ns >= 0
