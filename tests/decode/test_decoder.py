"""Evidence of every kind, decoded."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    EventKind,
    Packet,
    Quiet,
    SerialFormat,
    SerialLink,
    WireEvent,
    parse_line,
)
from mbtool.decode import decoder as decoding
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, NamedTransaction, Namer, parse_assignment
from mbtool.logs import LogWriter
from mbtool.modbus import Outcome, Transport, ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.adu import Verdict
from mbtool.packets import CloseReason, StreamClosed, StreamEvent, StreamGap, StreamOpened
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.packets.building import SLAVE_PORT, End, Talk, in_fragments
from tests.records import without_origins
from tests.workflows.evidence import (
    CONNECTION,
    LINE,
    MS,
    READ,
    REFUSED,
    START_NS,
    VALUES,
    WRITE,
    captured,
    exchange,
    heard,
    of_link,
    relayed,
)

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from mbtool.decode.decoder import Evidence, Record

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


def _decoder(*devices: str) -> Decoder:
    return Decoder(
        Namer(Assignments(parse_assignment(one) for one in devices)),
        lines={LINE.name: LINE},
        ports=(502,),
    )


def _decoded(items: Iterable[Evidence], decoder: Decoder | None = None) -> list[Record]:
    decoder = decoder or _decoder()
    records = [record for item in items for record in decoder.feed(item)]
    return [*records, *decoder.close()]


def _outcomes(records: Iterable[Record]) -> list[str]:
    return [
        record.kind.value if isinstance(record, WireEvent) else record.outcome.value
        for record in records
    ]


def test_the_reads_of_a_serial_line_become_transactions() -> None:
    items = [*exchange(0), *exchange(100, READ, REFUSED), heard(200, WRITE), heard(220, WRITE)]
    first, second, third = _decoded(items)
    assert isinstance(first, NamedTransaction)
    assert (first.link, first.transport, first.response_values) == (
        "rs485",
        Transport.RTU,
        [0x1234, 0x5678],
    )
    assert first.reference == "holding 0..1"
    assert isinstance(second, NamedTransaction)
    assert second.exception == 2
    assert isinstance(third, NamedTransaction)
    assert third.request_values == [7]


def test_transactions_are_named_by_their_device() -> None:
    (one,) = _decoded(exchange(0), _decoder("1=idec-ft1a-touch"))
    assert isinstance(one, NamedTransaction)
    assert (one.device, one.reference) == ("idec-ft1a-touch", "HR400001..400002")


def test_a_serial_line_without_settings_is_rtu() -> None:
    (one,) = _decoded([heard(0, READ, link="other"), heard(20, VALUES, link="other")])
    assert (one.link, _outcomes([one])) == ("other", ["ok"])


def test_an_ascii_line_is_decoded_as_ascii() -> None:
    decoder = Decoder(
        Namer(), lines={"com": SerialLink("com", SerialFormat(9600, 7, "E", 1), ascii=True)}
    )
    data = ascii_adu(1, READ)
    (one,) = _decoded([Chunk(ts_ns=START_NS, link="com", data=data)], decoder)
    assert isinstance(one, NamedTransaction)
    assert (one.transport, one.outcome) == (Transport.ASCII, Outcome.NOT_CAPTURED)


def test_the_bytes_of_a_relay_become_transactions_however_they_are_cut() -> None:
    request = relayed(0, REQUEST, READ)
    answer = relayed(5, RESPONSE, VALUES)
    cut = [
        Chunk(
            ts_ns=answer.ts_ns,
            link=answer.link,
            data=answer.data[at : at + 1],
            direction=RESPONSE,
            connection=CONNECTION,
        )
        for at in range(len(answer.data))
    ]
    (whole,) = _decoded([request, answer])
    assert _decoded([request, *cut]) == [whole]
    assert isinstance(whole, NamedTransaction)
    assert (whole.source, whole.destination) == ("10.0.0.1:50211", "10.0.0.9:502")


def test_the_slaves_port_makes_a_relay_rtu_over_tcp() -> None:
    connection = Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 4001))
    decoder = Decoder(Namer(), rtu_ports=(4001,))
    items = [
        Chunk(
            ts_ns=START_NS + at * MS,
            link=connection.link,
            data=rtu_adu(1, pdu),
            direction=direction,
            connection=connection,
        )
        for at, direction, pdu in ((0, REQUEST, READ), (5, RESPONSE, VALUES))
    ]
    (one,) = _decoded(items, decoder)
    assert isinstance(one, NamedTransaction)
    assert one.transport is Transport.RTU_TCP


def test_packets_become_transactions_and_connection_events() -> None:
    records = _decoded(captured(2))
    assert _outcomes(records) == ["opened", "ok", "ok", "closed"]
    assert records[0].link == "10.0.0.2"


def test_packets_of_other_ports_are_ignored() -> None:
    decoder = Decoder(Namer(), ports=(1502,))
    assert _decoded(captured(2), decoder) == []


def test_two_connections_to_one_slave_are_kept_apart() -> None:
    other = Connection(Endpoint("10.0.0.2", 50300), CONNECTION.slave, 2)
    records = _decoded(
        [
            relayed(0, REQUEST, READ),
            relayed(1, REQUEST, WRITE, connection=other),
            relayed(2, RESPONSE, WRITE, connection=other),
            relayed(3, RESPONSE, VALUES),
        ]
    )
    assert [
        (one.source, one.function, one.outcome.value)
        for one in records
        if isinstance(one, NamedTransaction)
    ] == [("10.0.0.2:50300", 6, "ok"), ("10.0.0.1:50211", 3, "ok")]


def test_a_gap_of_a_relay_is_an_event_and_bytes_around_it_are_not_joined() -> None:
    half = relayed(0, REQUEST, READ)
    records = _decoded(
        [
            Chunk(
                ts_ns=half.ts_ns,
                link=half.link,
                data=half.data[:5],
                direction=REQUEST,
                connection=CONNECTION,
            ),
            StreamGap(START_NS + MS, CONNECTION, REQUEST, 7),
            relayed(10, REQUEST, READ, number=2),
            relayed(15, RESPONSE, VALUES, number=2),
        ]
    )
    assert _outcomes(records) == ["skipped", "gap", "ok"]


def test_the_end_of_a_connection_ends_its_open_requests() -> None:
    records = _decoded(
        [
            StreamOpened(START_NS, CONNECTION, joined=False),
            relayed(1, REQUEST, READ),
            StreamClosed(START_NS + 2 * MS, CONNECTION, CloseReason.RESET),
        ]
    )
    assert _outcomes(records) == ["opened", "no-answer", "closed"]


def test_a_connection_closed_by_a_limit_is_reported_as_discarded() -> None:
    (record,) = _decoded([StreamClosed(START_NS, CONNECTION, CloseReason.DISCARDED)])
    assert isinstance(record, WireEvent)
    assert record.kind == "discarded"
    assert "silent longest of more than 4096" in record.message


def test_a_foreign_connection_closed_by_a_limit_is_no_loss() -> None:
    said = Chunk(
        ts_ns=START_NS,
        link=CONNECTION.link,
        data=b"\xff" * 3000,
        direction=REQUEST,
        connection=CONNECTION,
    )
    records = _decoded([said, StreamClosed(START_NS, CONNECTION, CloseReason.DISCARDED)])
    assert _outcomes(records) == ["foreign", "closed"]


def test_a_loss_on_a_line_ends_its_incomplete_frame() -> None:
    first, second = heard(0, READ), heard(1, VALUES)
    lost = WireEvent(
        ts_ns=START_NS + MS // 2,
        link=LINE.name,
        kind=EventKind.DISCARDED,
        message="decoding fell behind",
        missing=100,
    )
    half = Chunk(ts_ns=first.ts_ns, link=LINE.name, data=first.data[:4])
    records = _decoded([half, lost, second, *exchange(100)])
    assert _outcomes(records)[:2] == ["skipped", "discarded"]
    assert _outcomes(records)[-1] == "ok"


def test_a_damaged_place_in_a_log_ends_everything_incomplete_on_all_links() -> None:
    damaged = WireEvent(ts_ns=START_NS + 2 * MS, link="", kind=EventKind.GAP, message="damaged")
    half = heard(0, READ)
    half = Chunk(ts_ns=half.ts_ns, link=LINE.name, data=half.data[:4])
    asked = relayed(1, REQUEST, READ)
    answered = relayed(3, RESPONSE, VALUES)
    records = _decoded([half, asked, damaged, heard(3, VALUES), answered, *exchange(100)])
    assert _outcomes(records[: records.index(damaged)]) == ["not-captured", "skipped"]
    assert sorted(_outcomes(records[records.index(damaged) :])) == [
        "gap", "not-captured", "not-captured", "ok",
    ]  # fmt: skip


def test_an_event_of_a_source_is_passed_on() -> None:
    event = WireEvent(ts_ns=START_NS, link="eth0", kind=EventKind.DISCARDED, message="", missing=3)
    assert _decoded([event]) == [event]


def test_silence_on_a_line_ends_a_frame() -> None:
    decoder = _decoder()
    for chunk in exchange(0):
        assert decoder.feed(chunk) == []
    records = decoder.feed(Quiet(START_NS + 40 * MS, LINE.name))
    assert _outcomes(records) == ["ok"]
    assert decoder.close() == []


def test_silence_on_one_line_does_not_affect_another() -> None:
    decoder = _decoder()
    for chunk in exchange(0):
        decoder.feed(chunk)
    assert decoder.feed(Quiet(START_NS + 40 * MS, "eth0")) == []


def test_closing_twice_returns_nothing_more() -> None:
    decoder = _decoder()
    decoder.feed(heard(0, READ))
    assert _outcomes(decoder.close()) == ["not-captured"]
    assert decoder.close() == []


def test_the_number_of_connections_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "MAX_CONNECTIONS", 3)
    decoder = _decoder()
    connections = [
        Connection(Endpoint("10.0.0.1", 50000 + number), CONNECTION.slave) for number in range(5)
    ]
    records = [
        record
        for at, connection in enumerate(connections)
        for record in decoder.feed(relayed(at, REQUEST, READ, connection=connection))
    ]
    # The two that were silent longest made room.
    assert [one.source for one in records if isinstance(one, NamedTransaction)] == [
        "10.0.0.1:50000",
        "10.0.0.1:50001",
    ]
    assert _outcomes(decoder.close()) == ["not-captured"] * 3


def test_the_connection_silent_for_longest_is_closed_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "MAX_CONNECTIONS", 2)
    other, third = (
        Connection(Endpoint("10.0.0.2", port), CONNECTION.slave) for port in (50300, 50301)
    )
    records = _decoded(
        [
            relayed(0, REQUEST, READ),
            relayed(1, REQUEST, READ, connection=other),
            relayed(2, REQUEST, READ, number=2),
            relayed(3, REQUEST, READ, connection=third),
            relayed(4, RESPONSE, VALUES),
        ]
    )
    assert _outcomes(records).count("ok") == 1


_frames = st.lists(
    st.tuples(
        st.sampled_from([READ, VALUES, WRITE, REFUSED, b"\x41\x00", b"\x03"]),
        st.integers(1, 3),
        st.integers(1, 7000),
        st.booleans(),
        st.booleans(),
    ),
    max_size=12,
)


@settings(max_examples=60)
@given(_frames)
def test_a_line_gives_the_same_live_and_from_its_bytes(
    frames: list[tuple[bytes, int, int, bool, bool]],
) -> None:
    at_ms = 0
    evidence: list[Evidence] = []
    live: list[Evidence] = []
    for pdu, unit, pause_ms, is_told, is_broken in frames:
        if is_told and evidence:
            # A millisecond before the frame begins; at 19200 baud it takes at most 6 ms.
            live.append(Quiet(START_NS + (at_ms + pause_ms) * MS, LINE.name))
        at_ms += pause_ms + 10
        chunk = heard(at_ms, pdu, unit)
        if is_broken:
            chunk = Chunk(ts_ns=chunk.ts_ns, link=chunk.link, data=chunk.data[:-1] + b"\xee")
        evidence.append(chunk)
        live.append(chunk)
    # How long the line was silent at the end of the capture is evidence, too.
    for items in (live, evidence):
        items.append(Quiet(START_NS + (at_ms + 20_000) * MS, LINE.name))
    assert _decoded(live) == _decoded(evidence)


_pieces = st.lists(
    st.tuples(
        st.sampled_from([READ, WRITE, VALUES, REFUSED, b"\x41\x00"]),
        st.sampled_from([REQUEST, RESPONSE]),
        st.integers(0, 2),
        st.integers(1, 70_000),
        st.booleans(),
    ),
    max_size=12,
)


@settings(max_examples=60)
@given(_pieces, st.integers(1, 20))
def test_a_relay_gives_the_same_live_and_from_its_bytes(
    pieces: list[tuple[bytes, Direction, int, int, bool]], size: int
) -> None:
    at_ms = 0
    evidence: list[Evidence] = []
    live: list[Evidence] = []
    for pdu, direction, number, pause_ms, is_told in pieces:
        at_ms += pause_ms
        if is_told:
            live.append(Quiet(START_NS + at_ms * MS - 1, CONNECTION.link))
        chunk = relayed(at_ms, direction, pdu, number=number)
        evidence.append(chunk)
        live += [
            Chunk(
                ts_ns=chunk.ts_ns,
                link=chunk.link,
                data=chunk.data[at : at + size],
                direction=direction,
                connection=CONNECTION,
            )
            for at in range(0, len(chunk.data), size)
        ]
    assert _decoded(live) == _decoded(evidence)


@given(
    st.lists(
        st.one_of(
            st.builds(
                Chunk,
                ts_ns=st.integers(0, 2**62),
                link=st.sampled_from([LINE.name, "b", CONNECTION.link]),
                data=st.binary(max_size=30),
                direction=st.sampled_from([REQUEST, RESPONSE]),
                connection=st.sampled_from([None, CONNECTION]),
            ),
            st.builds(Quiet, st.integers(0, 2**62), st.sampled_from([LINE.name, "b"])),
            st.builds(
                Packet,
                ts_ns=st.integers(0, 2**62),
                link=st.just("eth0"),
                link_type=st.sampled_from([1, 101, 999]),
                data=st.binary(max_size=80),
                original_length=st.integers(0, 2000),
            ),
            st.builds(
                StreamGap,
                st.integers(0, 2**62),
                st.just(CONNECTION),
                st.sampled_from([REQUEST, RESPONSE]),
                st.integers(0, 100),
            ),
        ),
        max_size=12,
    )
)
def test_no_evidence_raises(items: list[Evidence]) -> None:
    _decoded(items)


def test_a_log_decodes_to_what_was_decoded_live(tmp_path: Path) -> None:
    items: list[Evidence] = [
        *exchange(0),
        relayed(30, REQUEST, READ),
        Quiet(START_NS + 60 * MS, LINE.name),
        relayed(70, RESPONSE, VALUES),
        *captured(2),
        *exchange(200, READ, REFUSED),
        heard(300, READ),
        Quiet(START_NS + 9000 * MS, LINE.name),
        relayed(9100, REQUEST, WRITE, number=9),
    ]
    decoder = _decoder("1=idec-ft1a-touch")
    path = tmp_path / "a.mcap"
    live: list[Record] = []
    with LogWriter(path, capture={}) as log:
        log.add_link(LINE.name, {"spec": str(LINE)})
        for item in items:
            if isinstance(item, Chunk | Packet):
                log.write(item)
            for record in decoder.feed(item):
                live.append(record)
                log.write(record)
        for record in decoder.close():
            live.append(record)
            log.write(record)
    devices = Assignments([parse_assignment("1=idec-ft1a-touch")])
    logged = list(Reading([str(path)], ReadingOptions()).records())
    again = list(Reading([str(path)], ReadingOptions(raw=True, assignments=devices)).records())
    assert without_origins(logged) == without_origins(live)
    for link in (LINE.name, CONNECTION.link, "10.0.0.2"):
        assert without_origins(of_link(again, link)) == without_origins(of_link(live, link))
    assert len(again) == len(live)
    assert mbap_adu(0, 1, READ) in {
        one.request_raw for one in again if isinstance(one, NamedTransaction)
    }


def _packets(link_type: int, *adus: bytes) -> list[Packet]:
    """The bytes of a serial line in packets, each 20 ms after the one before."""
    header = bytes(8) + b"\x02\0\0\0" if link_type == 250 else b""
    return [
        Packet(
            ts_ns=START_NS + number * 20 * MS,
            link="com1",
            link_type=link_type,
            data=header + adu,
            original_length=len(header + adu),
        )
        for number, adu in enumerate(adus)
    ]


def test_packets_with_bytes_of_a_serial_line_are_decoded_as_a_line() -> None:
    chunks = exchange(0)
    plain = Decoder(Namer(Assignments()), lines={LINE.name: LINE})
    wanted = [record for chunk in chunks for record in plain.feed(chunk)] + plain.close()
    for link_type in (147, 250):
        decoder = Decoder(Namer(Assignments()))
        packets = _packets(link_type, *(chunk.data for chunk in chunks))
        records = [record for packet in packets for record in decoder.feed(packet)]
        records += decoder.close()
        (one,) = records
        assert isinstance(one, NamedTransaction)
        assert (one.link, one.outcome, one.transport) == ("com1", Outcome.OK, Transport.RTU)
        (other,) = wanted
        assert isinstance(other, NamedTransaction)
        assert one.latency_ns == other.latency_ns


def test_the_users_line_settings_hold_for_unknown_lines() -> None:
    decoder = Decoder(Namer(Assignments()), line=parse_line("ascii@9600-7E1"))
    packets = _packets(147, ascii_adu(1, READ), ascii_adu(1, VALUES))
    (one,) = [record for packet in packets for record in decoder.feed(packet)]
    assert isinstance(one, NamedTransaction)
    assert one.transport is Transport.ASCII


def test_other_user_link_types_are_a_line_if_the_user_gives_its_settings() -> None:
    packets = _packets(150, *(chunk.data for chunk in exchange(0)))
    decoder = Decoder(Namer(Assignments()))
    (event,) = [record for packet in packets for record in decoder.feed(packet)]
    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.UNREADABLE
    decoder = Decoder(Namer(Assignments()), line=parse_line("rtu@19200"))
    records = [record for packet in packets for record in decoder.feed(packet)]
    records += decoder.close()
    (one,) = records
    assert isinstance(one, NamedTransaction)


def test_a_truncated_packet_ends_the_incomplete_frame() -> None:
    decoder = Decoder(Namer(Assignments()))
    (whole,) = _packets(147, rtu_adu(1, READ))
    short = Packet(
        ts_ns=whole.ts_ns,
        link=whole.link,
        link_type=147,
        data=whole.data[:-3],
        original_length=len(whole.data),
    )
    skipped, cut = decoder.feed(short)
    assert isinstance(skipped, WireEvent)
    assert skipped.raw == short.data
    assert isinstance(cut, WireEvent)
    assert (cut.kind, cut.missing) == (EventKind.CUT, 3)


def test_a_line_that_ended_does_not_affect_the_next_line_of_its_name() -> None:
    decoder = Decoder(Namer(Assignments()))
    request, response = exchange(0)
    decoder.begin_line(SerialLink(request.link, SerialFormat()))
    assert decoder.feed(request) == []
    (interrupted,) = decoder.end_line(request.link)
    assert isinstance(interrupted, NamedTransaction)
    assert interrupted.outcome is Outcome.NOT_CAPTURED
    records = [*decoder.feed(response), *decoder.close()]
    assert [one.outcome for one in records if isinstance(one, NamedTransaction)] == [
        Outcome.NOT_CAPTURED
    ]
    assert decoder.end_line("never seen") == []


ELSEWHERE = Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 1502), 1)
TLS = bytes.fromhex("16 0301 0200 01 0001fc 0303")


def test_at_any_port_a_connection_is_reported_once_it_is_modbus() -> None:
    decoder = Decoder(Namer(), any_port=True)
    opened = StreamOpened(START_NS, ELSEWHERE, joined=False)
    request = relayed(0, REQUEST, READ, connection=ELSEWHERE)
    answer = relayed(5, RESPONSE, VALUES, connection=ELSEWHERE)
    assert decoder.feed(opened) + decoder.feed(request) == []
    records = decoder.feed(answer)
    closed = StreamClosed(START_NS + 9 * MS, ELSEWHERE, CloseReason.FINISHED)
    assert _outcomes([*records, *decoder.feed(closed)]) == ["opened", "ok", "closed"]


@pytest.mark.parametrize(
    ("ports", "slave"),
    [((1502, 50211), "10.0.0.9:1502"), ((1502,), "10.0.0.9:1502"), ((50211,), "10.0.0.1:50211")],
)
def test_at_any_port_the_end_whose_port_is_named_is_the_slave(
    ports: tuple[int, ...], slave: str
) -> None:
    decoder = Decoder(Namer(), any_port=True, ports=ports)
    ways = (REQUEST, RESPONSE) if slave == str(ELSEWHERE.slave) else (RESPONSE, REQUEST)
    records = decoder.feed(StreamOpened(START_NS, ELSEWHERE, joined=False))
    for at, (way, pdu) in enumerate(zip(ways, (READ, VALUES), strict=True)):
        records += decoder.feed(relayed(at, way, pdu, connection=ELSEWHERE))
    (transaction,) = [one for one in records if isinstance(one, NamedTransaction)]
    assert (transaction.outcome, transaction.destination) == (Outcome.OK, slave)


def test_a_note_about_a_connection_is_part_of_its_opening() -> None:
    opened = StreamOpened(START_NS, ELSEWHERE, joined=False, note="master TLS 1.3, CN=master")
    (told,) = _decoder().feed(opened)
    assert isinstance(told, WireEvent)
    assert told.message == "connection opened: master TLS 1.3, CN=master"


def test_at_any_port_foreign_connections_are_reported_once_for_each_slave() -> None:
    decoder = Decoder(Namer(), any_port=True)
    records: list[Record] = []
    for number in range(3):
        connection = Connection(ELSEWHERE.master, ELSEWHERE.slave, number)
        chunk = relayed(0, REQUEST, READ, connection=connection)
        records += decoder.feed(StreamOpened(START_NS, connection, joined=False))
        records += decoder.feed(
            Chunk(
                ts_ns=START_NS,
                link=chunk.link,
                data=TLS,
                direction=REQUEST,
                connection=connection,
            )
        )
        records += decoder.feed(StreamClosed(START_NS, connection, CloseReason.FINISHED))
    assert _outcomes(records) == ["foreign"]


@pytest.mark.parametrize("port", [9000, 60000], ids=["slave lower", "master lower"])
def test_at_any_port_foreign_connections_without_beginning_are_reported_once_for_each_slave(
    port: int,
) -> None:
    decoder = Decoder(Namer(), any_port=True)
    records: list[Record] = []
    for number in range(20):
        talk = Talk(End("10.0.0.1", 20000 + number, 1000), End("10.0.0.2", port, 5000))
        for packet in (talk.request(b"\xff" * 900), talk.response(b"\xff" * 900)):
            records += decoder.feed(packet)
    assert _outcomes([*records, *decoder.close()]) == ["foreign"]


def test_each_foreign_connection_to_a_named_port_is_one_event() -> None:
    decoder = _decoder()
    records = decoder.feed(StreamOpened(START_NS, CONNECTION, joined=False))
    for way in (REQUEST, RESPONSE, REQUEST, RESPONSE):
        data = Chunk(
            ts_ns=START_NS, link=CONNECTION.link, data=TLS, direction=way, connection=CONNECTION
        )
        records += decoder.feed(data)
    assert _outcomes([*records, *decoder.close()]) == ["opened", "foreign"]


def _of_port(port: int) -> Talk:
    return Talk(slave=End("10.0.0.2", port, 5000))


@pytest.mark.parametrize("joined", [False, True])
def test_tls_in_packets_is_one_event(joined: bool) -> None:
    """Application data, as most of a connection is that was captured in the middle."""
    data = bytes.fromhex("17 0303 0022") + bytes(range(0x80, 0xA2))
    talk = _of_port(802)
    begun = [] if joined else [*talk.handshake(), talk.request(TLS), talk.response(TLS)]
    polls = [one for _ in range(9) for one in (talk.request(data), talk.response(data))]
    records = _decoded([*begun, *polls, *talk.goodbye()], Decoder(Namer(), ports=(802,)))
    assert _outcomes(records) == ["opened", "foreign", "closed"]
    foreign = records[1]
    assert isinstance(foreign, WireEvent)
    assert foreign.message.startswith("the connection is TLS: only its ends can read it; a tap")


def _twice(packet: Packet, old: bytes, new: bytes) -> list[Packet]:
    """A packet, and a second copy of it in which bytes differ."""
    assert old in packet.data
    return [packet, replace(packet, data=packet.data.replace(old, new))]


@pytest.mark.parametrize("in_parts", [False, True], ids=["segments", "fragments"])
@pytest.mark.parametrize("joined", [False, True])
def test_at_any_port_differing_retransmissions_of_modbus_are_reported(
    in_parts: bool, joined: bool
) -> None:
    talk = _of_port(1502)
    begun = [] if joined else talk.handshake()
    first, second = _twice(talk.request(mbap_adu(1, 1, READ)), READ, WRITE)
    copies = (
        [in_fragments(first, 24)[1], *in_fragments(second, 24)[::-1]]
        if in_parts
        else [first, second]
    )
    answer = talk.response(mbap_adu(1, 1, VALUES))
    more = [talk.request(mbap_adu(2, 1, READ)), talk.response(mbap_adu(2, 1, VALUES))]
    records = _decoded(
        [*begun, *copies, answer, *more, *talk.goodbye()], Decoder(Namer(), any_port=True)
    )
    assert sorted(_outcomes(records)) == ["closed", "ok", "ok", "opened", "overlap"]
    (overlap,) = [one for one in records if isinstance(one, WireEvent) and one.kind == "overlap"]
    assert overlap.source == "10.0.0.1:49152"


@pytest.mark.parametrize("in_parts", [False, True], ids=["segments", "fragments"])
def test_at_any_port_differing_retransmissions_of_other_protocols_are_not_reported(
    in_parts: bool,
) -> None:
    talk = _of_port(443)
    begun = [*talk.handshake(), talk.request(TLS), talk.response(TLS)]
    first, second = _twice(talk.request(bytes(30) + b"secret"), b"secret", b"forged")
    copies = (
        [in_fragments(first, 24)[1], *in_fragments(second, 24)[::-1]]
        if in_parts
        else [first, second]
    )
    unfinished = in_fragments(talk.request(bytes(100)), 24)[:1]
    items = [*begun, *copies, *unfinished, *talk.goodbye()]
    assert _outcomes(_decoded(items, Decoder(Namer(), any_port=True))) == ["foreign"]
    named = _outcomes(_decoded(items, Decoder(Namer(), ports=(443,))))
    assert {"overlap", "unreadable"} <= set(named)


def test_swapped_roles_do_not_change_the_sender_of_bytes() -> None:
    """Joined in the middle, with the master at the port that was taken for the slave's."""
    talk = Talk(End("10.0.0.1", 1024, 1000), End("10.0.0.2", 50000, 5000))
    answer = talk.response(mbap_adu(0, 1, VALUES))  # The first segment: its sender seems to ask.
    first, second = _twice(talk.request(mbap_adu(1, 1, READ)), READ, WRITE)
    items = [answer, first, second, talk.response(mbap_adu(1, 1, VALUES))]
    records = _decoded(items, Decoder(Namer(), any_port=True))
    (opened,) = [one for one in records if isinstance(one, WireEvent) and one.kind == "opened"]
    (overlap,) = [one for one in records if isinstance(one, WireEvent) and one.kind == "overlap"]
    assert (opened.source, opened.destination) == ("10.0.0.1:1024", "10.0.0.2:50000")
    assert (overlap.source, overlap.destination) == ("10.0.0.1:1024", "10.0.0.2:50000")
    assert overlap.link == "10.0.0.2:50000"


def test_at_any_port_data_lost_to_a_limit_is_reported_for_an_unrecognised_connection() -> None:
    decoder = Decoder(Namer(), any_port=True)
    lost, twice = (
        StreamEvent(ELSEWHERE, WireEvent(ts_ns=START_NS, link="if0", kind=kind, message=""))
        for kind in (EventKind.DISCARDED, EventKind.OVERLAP)
    )
    assert _outcomes(decoder.feed(lost) + decoder.feed(twice)) == ["discarded"]


def test_the_end_of_a_connection_reports_the_number_of_keep_alive_probes() -> None:
    talk = Talk()
    packets = talk.handshake()
    packets += [talk.request(mbap_adu(1, 1, READ)), talk.response(mbap_adu(1, 1, VALUES))]
    for _ in range(3):  # RFC 1122, 4.2.3.6: no byte, at the place before the next expected.
        packets.append(talk.at(talk.slave, talk.slave.sequence - 1))
        packets.append(talk.at(talk.master, talk.master.sequence))
    *_, closed = _decoded([*packets, *talk.goodbye()])
    assert isinstance(closed, WireEvent)
    assert closed.message == "connection closed: finished by the master, 3 keep-alive probes"
    *_, quiet = _decoded(captured(1))
    assert isinstance(quiet, WireEvent)
    assert quiet.message == "connection closed: finished by the master"


def _seen_by(link: str, packets: Iterable[Packet], later_ns: int = 0) -> list[Packet]:
    return [replace(one, link=link, ts_ns=one.ts_ns + later_ns) for one in packets]


def _in_time(packets: Iterable[Packet]) -> list[Packet]:
    return sorted(packets, key=lambda one: one.ts_ns)


def test_a_connection_on_two_interfaces_is_decoded_twice() -> None:
    both = _in_time([*_seen_by("eth0", captured(2)), *_seen_by("eth1", captured(2), 1000)])
    records = _decoded(both)
    assert _outcomes(records) == [
        *("opened", "opened", "ok", "ok", "ok", "ok", "closed", "closed"),
    ]


def test_across_interfaces_a_connection_on_two_interfaces_is_decoded_once() -> None:
    both = _in_time([*_seen_by("eth0", captured(2)), *_seen_by("eth1", captured(2), 1000)])
    assert _decoded(both, _across()) == _decoded(_seen_by("eth0", captured(2)))


def test_across_interfaces_each_interface_may_have_one_direction() -> None:
    """As a network tap has it, with a monitor port for each direction."""
    ways = [
        replace(one, link="eth0" if one.data[36:38] == SLAVE_PORT.to_bytes(2) else "eth1")
        for one in captured(2)
    ]
    assert _decoded(ways, _across()) == _decoded(captured(2))
    assert "ok" not in _outcomes(_decoded(ways))


def test_fragments_of_two_interfaces_are_reassembled_separately() -> None:
    talk = Talk()
    begun = talk.handshake()
    whole = in_fragments(talk.request(mbap_adu(1, 1, READ)), 24)
    items = [*begun, whole[0], *_seen_by("eth1", whole[1:])]
    assert _outcomes(_decoded(items, _across())) == ["opened", "not-captured", "closed"]
    assert "not-captured" not in _outcomes(_decoded(items))


def _across() -> Decoder:
    return Decoder(Namer(), ports=(502,), across=True)


@pytest.mark.parametrize(
    ("waiting", "outcomes"),
    [
        ([(7, 1)], ["ok"]),
        ([(6, 1)], ["no-answer", "unsolicited"]),  # Neither the id nor the unit is the request's.
        ([(7, 1), (7, 3)], ["no-answer", "no-answer", "unsolicited"]),
    ],
)
def test_an_answer_of_another_unit_belongs_to_the_only_request_with_its_id(
    waiting: list[tuple[int, int]], outcomes: list[str]
) -> None:
    """FA3 modules take any module ID; the answers in their manual (10.5) always have 00H."""
    talk = Talk()
    asked = bytes.fromhex("02 0009 0001"), bytes.fromhex("02 01 01")
    packets = talk.handshake()
    for number in range(3):  # This slave repeats ids.
        packets += [
            talk.request(mbap_adu(number, 0, asked[0])),
            talk.response(mbap_adu(number, 0, asked[1])),
        ]
    packets += [talk.request(mbap_adu(number, unit, asked[0])) for number, unit in waiting]
    packets += [talk.response(mbap_adu(7, 0, asked[1])), *talk.goodbye()]
    records = _decoded(packets)
    assert sorted(_outcomes(records)[4:-1]) == outcomes
    paired = [one for one in records if not isinstance(one, WireEvent) and one.response_raw]
    assert (Verdict.OTHER_UNIT in paired[-1].verdicts) == (outcomes == ["ok"])


@pytest.mark.parametrize("ids_vary", [True, False])
@pytest.mark.parametrize("has_handshake", [True, False])
def test_a_slave_that_is_asked_as_255_and_answers_as_1_answers(
    *, has_handshake: bool, ids_vary: bool
) -> None:
    talk = Talk()
    packets = talk.handshake() if has_handshake else []
    for number in range(4):
        id_ = number if ids_vary else 7
        packets += [
            talk.request(mbap_adu(id_, 255, READ)),
            talk.response(mbap_adu(id_, 1, VALUES)),
        ]
    outcomes = [one.outcome.value for one in _decoded(packets) if not isinstance(one, WireEvent)]
    if has_handshake:
        assert outcomes == ["ok"] * 4
    elif ids_vary:  # The first response may be to a request before the capture.
        assert sorted(outcomes) == ["not-captured"] * 2 + ["ok"] * 3
    else:
        assert set(outcomes) == {"not-captured"}


@pytest.mark.parametrize("is_answered", [True, False])
def test_a_first_message_with_another_protocol_id_does_not_discard_the_connection(
    is_answered: bool,
) -> None:
    """FA3 modules send no response to it (their manual, 10.4); other slaves may."""
    talk = Talk()
    ask, answer = mbap_adu(1, 0, READ), mbap_adu(1, 0, VALUES)
    other = [one[:2] + b"\0\1" + one[4:] for one in (ask, answer)]
    packets = [*talk.handshake(), talk.request(other[0])]
    if is_answered:
        packets.append(talk.response(other[1]))
    packets += [talk.request(ask), talk.response(answer), *talk.goodbye()]
    told = ["opened", *["foreign"] * (1 + is_answered), "ok", "closed"]
    assert _outcomes(_decoded(packets)) == told
