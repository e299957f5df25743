"""Which links and connections a decoder keeps, when it ends them, and what it tells of them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    EventKind,
    Quiet,
    SerialFormat,
    SerialLink,
    Stamp,
    WireEvent,
)
from mbtool.decode import decoder as decoding
from mbtool.decode.decoder import Decoder, closing_event, opening_event
from mbtool.decode.line_timing import LineTiming
from mbtool.decode.network_pairing import TIMEOUT_NS
from mbtool.decode.pairing import BUS_TIMEOUT_NS
from mbtool.decode.unfinished import USUAL_NS
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Outcome, mbap_adu, rtu_adu
from mbtool.packets import CloseReason, StreamClosed, StreamEvent, StreamGap, StreamOpened
from tests.packets.building import MASTER_PORT, SLAVE, SLAVE_PORT, Talk, packet
from tests.workflows.evidence import (
    CONNECTION,
    LINE,
    MS,
    READ,
    START_NS,
    VALUES,
    captured,
    exchange,
    heard,
    relayed,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mbtool.decode.decoder import Evidence, Record

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
ELSEWHERE = Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 1502), 1)
OTHER = Connection(Endpoint("10.0.0.3", 50300), Endpoint("10.0.0.8", 502), 2)
NOISE = b"\xff" * 3000
UNFINISHED, NO_ANSWER = Outcome.NOT_CAPTURED, Outcome.NO_ANSWER


def plain() -> Decoder:
    return Decoder(Namer(), lines={LINE.name: LINE}, ports=(502,))


def anywhere(*ports: int, rtu_ports: tuple[int, ...] = ()) -> Decoder:
    return Decoder(Namer(), any_port=True, ports=ports, rtu_ports=rtu_ports)


def decoded(decoder: Decoder, *items: Evidence) -> list[Record]:
    return [record for item in items for record in decoder.feed(item)]


def told(records: Iterable[Record]) -> list[str]:
    return [
        record.kind.value if isinstance(record, WireEvent) else record.outcome.value
        for record in records
    ]


def said(data: bytes, connection: Connection = ELSEWHERE, way: Direction = REQUEST) -> Chunk:
    return Chunk(
        ts_ns=START_NS, link=connection.link, data=data, direction=way, connection=connection
    )


def event(kind: EventKind, link: str, at_ns: int = START_NS) -> WireEvent:
    return WireEvent(ts_ns=at_ns, link=link, kind=kind, message="")


LAST: dict[str, Callable[[int], Evidence]] = {
    "a silence": lambda ts_ns: Quiet(ts_ns, "other"),
    "a relayed ADU": lambda ts_ns: replace(
        relayed(0, REQUEST, READ, connection=OTHER), ts_ns=ts_ns
    ),
    "bytes of a line": lambda ts_ns: Chunk(ts_ns=ts_ns, link="other line", data=b"\x01"),
    "an event": lambda ts_ns: event(EventKind.OVERLAP, "other", ts_ns),
    "a packet": lambda ts_ns: packet(b"", ts_ns),
}


@pytest.mark.parametrize("last", LAST)
@pytest.mark.parametrize(("waited_ns", "outcome"), [(-1, UNFINISHED), (0, NO_ANSWER)])
def test_a_capture_ends_with_the_latest_time_of_anything(
    last: str, waited_ns: int, outcome: Outcome
) -> None:
    for asked, link in ((heard(0, READ), LINE.name), (relayed(0, REQUEST, READ), CONNECTION.link)):
        decoder = plain()
        end_ns = START_NS + USUAL_NS + waited_ns
        decoded(decoder, asked, LAST[last](end_ns), LAST[last](end_ns - 1000))
        assert told(one for one in decoder.close() if one.link == link) == [outcome.value]


def test_a_capture_also_ends_with_the_time_of_packets_that_were_read_elsewhere() -> None:
    for waited_ns, outcome in ((-1, UNFINISHED), (0, NO_ANSWER)):
        decoder = plain()
        decoder.feed(relayed(0, REQUEST, READ))
        decoder.note_time(START_NS + USUAL_NS + waited_ns)
        decoder.note_time(START_NS)
        assert told(decoder.close()) == [outcome.value]


@pytest.mark.parametrize(
    ("reason", "outcome"),
    [
        (CloseReason.FINISHED, NO_ANSWER),
        (CloseReason.RESET, NO_ANSWER),
        (CloseReason.IDLE, NO_ANSWER),
        (CloseReason.CAPTURE_END, UNFINISHED),
        (CloseReason.DISCARDED, UNFINISHED),
    ],
)
def test_who_ends_a_connection_decides_if_its_last_request_had_an_answer(
    reason: CloseReason, outcome: Outcome
) -> None:
    records = decoded(
        plain(), relayed(0, REQUEST, READ), StreamClosed(START_NS + MS, CONNECTION, reason)
    )
    kind = "discarded" if reason is CloseReason.DISCARDED else "closed"
    assert told(records) == [outcome.value, kind]
    silence = Quiet(START_NS + USUAL_NS, "other")
    closed = StreamClosed(START_NS + MS, CONNECTION, reason)
    records = decoded(plain(), relayed(0, REQUEST, READ), silence, closed)
    assert told(records) == ["no-answer", kind]


def test_the_end_of_a_connection_tells_its_probes_and_its_ends() -> None:
    closed = StreamClosed(START_NS, CONNECTION, CloseReason.RESET, Direction.RESPONSE, 3, 2)
    (one,) = decoded(plain(), closed)
    assert one == WireEvent(
        ts_ns=START_NS,
        link="10.0.0.9",
        kind=EventKind.CLOSED,
        message="connection closed: reset by the slave, 3 keep-alive probes, the last 2 unanswered",
        source="10.0.0.1:50211",
        destination="10.0.0.9:502",
    )


def test_events_of_plain_connections_are_those_of_the_decoder() -> None:
    opened = StreamOpened(START_NS, CONNECTION, joined=False)
    by = Direction.REQUEST
    closed = StreamClosed(START_NS + MS, CONNECTION, CloseReason.FINISHED, by)
    assert decoded(plain(), opened, closed) == [
        opening_event(START_NS, CONNECTION), closing_event(START_NS + MS, CONNECTION, by),
    ]  # fmt: skip
    (joined,) = decoded(plain(), StreamOpened(START_NS, CONNECTION, joined=True))
    assert isinstance(joined, WireEvent)
    assert joined.message != opening_event(START_NS, CONNECTION).message
    assert (joined.kind, joined.ts_ns) == (EventKind.OPENED, START_NS)


@pytest.mark.parametrize(
    ("kind", "ends_the_line"),
    [
        (EventKind.DISCARDED, True),
        (EventKind.GAP, True),
        (EventKind.CUT, True),
        (EventKind.OVERLAP, False),
        (EventKind.CLOSED, False),
    ],
)
@pytest.mark.parametrize("link", [LINE.name, "other"])
def test_only_lost_bytes_of_its_own_link_end_a_line(
    kind: EventKind, ends_the_line: bool, link: str
) -> None:
    lost = event(kind, link, START_NS + MS)
    records = decoded(plain(), heard(0, READ), lost, heard(20, VALUES))
    records += decoded(plain(), Quiet(0, link))
    is_ended = ends_the_line and link == LINE.name
    assert told(records) == (["not-captured"] if is_ended else []) + [kind.value]


def test_breaking_lines_leaves_connections_alone() -> None:
    decoder = plain()
    decoded(decoder, heard(0, READ), relayed(0, REQUEST, READ))
    assert [one.link for one in decoder.break_lines()] == [LINE.name]
    records = [*decoder.feed(relayed(5, RESPONSE, VALUES)), *decoder.close()]
    assert told(records) == ["ok"]


def test_a_gap_without_a_link_ends_connections_and_lines_and_keeps_its_place() -> None:
    decoder = plain()
    decoded(decoder, heard(0, READ), relayed(0, REQUEST, READ))
    gap = event(EventKind.GAP, "", START_NS + USUAL_NS)
    *ended, last = decoder.feed(gap)
    assert last == gap
    # What is lost came before the event, so nobody waited until then.
    assert told(ended) == ["not-captured", "not-captured"]
    assert told(decoder.feed(relayed(5, RESPONSE, VALUES))) == ["not-captured"]


@pytest.mark.parametrize("quiet", ["its own link", "another link"])
def test_silence_of_a_tap_concerns_the_connections_of_its_link(quiet: str) -> None:
    decoder = plain()
    decoder.feed(relayed(0, REQUEST, READ))
    late_ns = START_NS + TIMEOUT_NS + 1
    link = CONNECTION.link if quiet == "its own link" else "10.0.0.8"
    records = decoder.feed(Quiet(late_ns, link))
    assert told(records) == (["no-answer"] if quiet == "its own link" else [])


def test_silence_of_an_interface_concerns_the_connections_of_other_links() -> None:
    decoder = plain()
    talk = Talk()
    decoded(decoder, *talk.handshake(), talk.request(mbap_adu(1, 1, READ)))
    assert decoder.feed(Quiet(talk.ts_ns + TIMEOUT_NS, "if0")) == []
    assert decoder.feed(Quiet(talk.ts_ns + TIMEOUT_NS + 1, SLAVE)) != []
    decoder = plain()
    talk = Talk()
    decoded(decoder, *talk.handshake(), talk.request(mbap_adu(1, 1, READ)))
    assert told(decoder.feed(Quiet(talk.ts_ns + TIMEOUT_NS + 1, "if0"))) == ["no-answer"]


def test_silence_of_an_interface_gives_out_what_waits_for_missing_packets() -> None:
    decoder = plain()
    talk = Talk()
    decoded(decoder, *talk.handshake())
    talk.request(mbap_adu(1, 1, READ))  # Not captured.
    decoded(decoder, talk.request(mbap_adu(2, 1, READ)))
    assert told(decoder.feed(Quiet(talk.ts_ns + 60_000 * MS, "if0"))) == ["gap"]


def test_silence_of_a_line_gives_up_its_request() -> None:
    decoder = plain()
    decoder.feed(heard(0, READ))
    assert decoder.feed(Quiet(START_NS + BUS_TIMEOUT_NS, LINE.name)) == []
    assert told(decoder.feed(Quiet(START_NS + BUS_TIMEOUT_NS + 1, LINE.name))) == ["no-answer"]


def test_a_gap_behind_the_end_of_a_connection_does_not_open_it_again() -> None:
    decoder = plain()
    closed = StreamClosed(START_NS, CONNECTION, CloseReason.RESET)
    gap = StreamGap(START_NS, CONNECTION, RESPONSE, 7, EventKind.CUT)
    (one,) = decoded(decoder, relayed(0, REQUEST, READ), closed, gap)[2:]
    assert isinstance(one, WireEvent)
    assert (one.kind, one.missing, one.source) == (EventKind.CUT, 7, "10.0.0.9:502")
    assert told(decoder.feed(relayed(5, RESPONSE, VALUES))) == ["not-captured"]
    assert len(decoder._detectors) == 1


def test_the_number_of_foreign_endpoints_told_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "MAX_FOREIGN_REPORTED", 2)
    decoder = anywhere()
    records: list[Record] = []
    for number in (1, 2, 2, 3):
        slave = Endpoint(f"10.0.0.{number}", 9000)
        connection = Connection(ELSEWHERE.master, slave, len(records))
        opened = StreamOpened(START_NS, connection, joined=False)
        records += decoded(decoder, opened, said(NOISE, connection))
        records += decoder.feed(StreamClosed(START_NS, connection, CloseReason.RESET))
    assert [one.destination for one in records if isinstance(one, WireEvent)] == [
        "10.0.0.1:9000", "10.0.0.2:9000",
    ]  # fmt: skip


def test_a_foreign_connection_whose_beginning_is_known_speaks_for_its_slave_only() -> None:
    decoder = anywhere()
    records: list[Record] = []
    back = Connection(ELSEWHERE.slave, ELSEWHERE.master, 2)
    for connection in (ELSEWHERE, back):
        opened = StreamOpened(START_NS, connection, joined=False)
        records += decoded(decoder, opened, said(NOISE, connection))
    assert told(records) == ["foreign", "foreign"]


@pytest.mark.parametrize(
    ("ports", "rtu_ports", "transport", "slave"),
    [
        ((), (), "tcp", "10.0.0.9:1502"),
        ((), (1502,), "rtu-tcp", "10.0.0.9:1502"),
        ((50211,), (), "tcp", "10.0.0.1:50211"),
        ((), (50211,), "rtu-tcp", "10.0.0.1:50211"),
        ((50211,), (1502,), "rtu-tcp", "10.0.0.9:1502"),
    ],
)
def test_ports_decide_who_is_the_slave_and_what_it_speaks(
    ports: tuple[int, ...], rtu_ports: tuple[int, ...], transport: str, slave: str
) -> None:
    decoder = anywhere(*ports, rtu_ports=rtu_ports)
    ways = (REQUEST, RESPONSE) if slave == str(ELSEWHERE.slave) else (RESPONSE, REQUEST)
    opened = StreamOpened(START_NS, ELSEWHERE, joined=False)
    records = decoder.feed(opened)
    for way, pdu in zip(ways, (READ, VALUES), strict=True):
        adu = rtu_adu(1, pdu) if transport == "rtu-tcp" else mbap_adu(1, 1, pdu)
        records += decoder.feed(said(adu, way=way))
    (one,) = [each for each in records if isinstance(each, NamedTransaction)]
    assert (one.transport, one.destination, one.outcome) == (transport, slave, "ok")


def test_the_user_named_ports_are_the_only_ones_unless_any_port_is_decoded() -> None:
    def has_ok(decoder: Decoder, port: int) -> bool:
        talk = Talk()
        talk.slave.port = port
        packets = [*talk.handshake(), talk.request(mbap_adu(1, 1, READ))]
        packets.append(talk.response(mbap_adu(1, 1, VALUES)))
        return "ok" in told(decoded(decoder, *packets))

    assert has_ok(Decoder(Namer(), any_port=True), 502)
    assert not has_ok(Decoder(Namer()), 502)
    assert has_ok(Decoder(Namer(), ports=(1502,)), 1502)
    assert not has_ok(Decoder(Namer(), ports=(1502,)), 502)
    for port in (1, 0xFFFF):
        assert has_ok(Decoder(Namer(), any_port=True), port)


@pytest.mark.parametrize("state", ["undecided", "modbus", "foreign", "unknown"])
@pytest.mark.parametrize("kind", [EventKind.OVERLAP, EventKind.DISCARDED])
def test_an_event_of_a_connection_at_any_port_is_told_if_it_is_modbus(
    state: str, kind: EventKind
) -> None:
    decoder = anywhere()
    opened = StreamOpened(START_NS, ELSEWHERE, joined=False)
    pair = [said(mbap_adu(1, 1, READ)), said(mbap_adu(1, 1, VALUES), way=RESPONSE)]
    before: dict[str, list[Evidence]] = {
        "undecided": [opened], "modbus": [opened, *pair], "foreign": [opened, said(NOISE)],
        "unknown": [],
    }  # fmt: skip
    decoded(decoder, *before[state])
    happened = StreamEvent(ELSEWHERE, event(kind, "if0"))
    is_told = state == "modbus" or (state == "unknown" and kind is EventKind.DISCARDED)
    assert told(decoder.feed(happened)) == ([kind.value] if is_told else [])
    if state == "undecided":
        assert told(decoded(decoder, *pair)) == ["opened", kind.value, "ok"]


def test_which_connection_opens_modbus_tcp() -> None:
    ends = (b"\x0a\0\0\2", SLAVE_PORT, b"\x0a\0\0\1", MASTER_PORT)
    assert plain().opens_modbus_tcp(ends)
    assert Decoder(Namer(), rtu_ports=(4001,)).opens_modbus_tcp(ends)
    for port in (MASTER_PORT, SLAVE_PORT):
        assert not Decoder(Namer(), rtu_ports=(port,)).opens_modbus_tcp(ends)
    talk, decoder = Talk(), Decoder(Namer(), ports=(502,), across=True)
    decoded(decoder, *talk.handshake())
    assert not decoder.opens_modbus_tcp(ends)
    decoded(decoder, *talk.goodbye())
    assert decoder.opens_modbus_tcp(ends)


def test_the_settings_of_a_line_are_the_users_then_the_profiles_and_unknown_without_times() -> None:
    own = SerialLink("b", SerialFormat(9600))
    decoder = Decoder(Namer(), lines={"b": own}, timing=LineTiming())
    assert decoder.line_of("b") == own
    assert decoder.line_of("c").name == "c"
    later = SerialLink("c", SerialFormat(4800))
    decoder.begin_line(later)
    assert decoder.line_of("c") == later
    assert decoder.format_of("c") is not None
    untimed = Chunk(ts_ns=0, link="d", data=rtu_adu(1, READ), stamp=Stamp.UNKNOWN)
    timed = Chunk(ts_ns=0, link="b", data=rtu_adu(1, READ))
    decoded(decoder, untimed, timed)
    assert decoder.format_of("d") is None
    assert decoder.format_of("b") == own.format


def test_a_connection_is_at_rest_while_nothing_of_it_is_open() -> None:
    ends = (b"\x0a\0\0\2", SLAVE_PORT, b"\x0a\0\0\1", MASTER_PORT)
    talk, decoder = Talk(), Decoder(Namer(), ports=(502,), across=True)
    assert decoder.at_rest(ends, 0) is None
    decoded(decoder, *talk.handshake())
    assert decoder.at_rest(ends, talk.ts_ns) is None  # It is not known to be Modbus.
    request, response = mbap_adu(1, 1, READ), mbap_adu(1, 1, VALUES)
    for data, send, is_at_rest in (
        (request[:5], talk.request, False),
        (request[5:], talk.request, False),
        (response[:8], talk.response, False),
        (response[8:], talk.response, True),
        (mbap_adu(2, 1, READ), talk.request, False),
    ):
        decoder.feed(send(data))
        resting = decoder.at_rest(ends, talk.ts_ns)
        assert (resting is not None) is is_at_rest
        if resting is not None:
            place = resting.place
            assert place.response_position - place.request_position == len(response) - len(request)
            assert decoder.at_rest(ends, talk.ts_ns - 1) is None
    decoder.feed(talk.response(mbap_adu(2, 1, VALUES)))
    assert decoder.at_rest(ends, talk.ts_ns) is not None
    # A request that nobody answered may be repeated later.
    decoded(decoder, talk.request(mbap_adu(3, 1, READ)), Quiet(talk.ts_ns + TIMEOUT_NS + 1, SLAVE))
    resting = decoder.at_rest(ends, talk.ts_ns + TIMEOUT_NS + 1)
    assert resting is not None
    assert resting.decoder.limits().requests == {b"\1" + READ}


def test_a_decoder_that_is_closed_keeps_nothing() -> None:
    decoder = plain()
    decoded(decoder, *exchange(0), *captured(1)[:5], relayed(0, REQUEST, READ))
    assert decoder.close() != []
    assert decoder.close() == []
    assert (decoder._detectors, decoder._buses) == ({}, {})


def test_an_answer_with_an_odd_number_of_bytes_is_the_slaves() -> None:
    """It is as long as a request, but reads more registers than the standard allows."""
    chunks = [one for at in range(0, 500, 100) for one in exchange(at)]
    odd = heard(500, READ), heard(520, bytes.fromhex("03 03 123400"))
    records = decoded(plain(), *chunks, *odd, *exchange(600))
    assert told(records)[:6] == [*["ok"] * 5, "malformed"]
