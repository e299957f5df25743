"""Detection of Modbus and of other protocols on TCP connections."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Connection, Direction, Endpoint, EventKind, WireEvent
from mbtool.decode.protocol_detection import (
    ENOUGH_ADUS,
    GAP_BYTES,
    MAX_NOISE,
    MAX_UNDECIDED_BYTES,
    ProtocolDetector,
    ProtocolState,
    ProvenSlaves,
)
from mbtool.modbus.adu import Transport, Verdict, mbap_adu, rtu_adu
from mbtool.modbus.transaction import Outcome
from tests.modbus.reading import adus, transactions, wire_events

if TYPE_CHECKING:
    from mbtool.decode.connections import Decoded

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
CONNECTION = Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 1502), 1)

READ = bytes.fromhex("03 0000 0002")  # read holding registers, address 0, quantity 2
VALUES = bytes.fromhex("03 04 1234 5678")  # four bytes, two registers
WRITE_ONE = bytes.fromhex("06 0010 1234")  # write single register, address 16
LONG_READ = bytes.fromhex("03 0000 0002 00")  # a byte more than the function has
OWN_FUNCTION = bytes.fromhex("41 01")  # a function that no table knows

TLS_DATA = bytes.fromhex("17 0303 0022") + bytes(range(0x80, 0xA2))
TLS = bytes.fromhex("16 0301 0200 01 0001fc 0303")  # a record, version 3.1, with a ClientHello
LDAP_BIND = bytes.fromhex(
    "30 84 0000000f"  # a SEQUENCE of 15 bytes: protocol id 0 and length 15 to Modbus
    "02 01 01"  # message 1: unit 2, function 01
    "60 84 00000006"  # a bind request
    "02 01 03 04 00 80"
)
LDAP_ANSWER = bytes.fromhex("30 84 0000000f 02 01 01 61 84 00000006 0a 01 00 04 00 80")

Piece = tuple[Direction, bytes]


class Port(Protocol):
    def __call__(self, *, joined: bool = False) -> ProtocolDetector: ...


TCP_PAIR: list[Piece] = [(REQUEST, mbap_adu(1, 1, READ)), (RESPONSE, mbap_adu(1, 1, VALUES))]
RTU_PAIR: list[Piece] = [(REQUEST, rtu_adu(1, READ)), (RESPONSE, rtu_adu(1, VALUES))]


def expected(*, joined: bool = False) -> ProtocolDetector:
    """A connection to a port that the user named."""
    return ProtocolDetector(CONNECTION, joined=joined)


def at_its_own_port(*, joined: bool = False) -> ProtocolDetector:
    """A connection to a port of Modbus/TCP, where any other port may be one of RTU."""
    return ProtocolDetector(CONNECTION, joined=joined, rtu=True)


def anywhere(*, joined: bool = False) -> ProtocolDetector:
    """A connection to any port."""
    return ProtocolDetector(CONNECTION, joined=joined, expected=False, rtu=True)


def fed(detector: ProtocolDetector, pieces: list[Piece]) -> list[Decoded]:
    return [
        one
        for place, (direction, data) in enumerate(pieces)
        for one in detector.feed(direction, data, place)
    ]


def in_pieces(pieces: list[Piece], size: int) -> list[Piece]:
    return [
        (direction, data[at : at + size])
        for direction, data in pieces
        for at in range(0, len(data), size)
    ]


def is_one_event(decoded: list[Decoded]) -> bool:
    return [one.kind for one in decoded if isinstance(one, WireEvent)] == [EventKind.FOREIGN] and (
        len(decoded) == 1
    )


def test_an_expected_connection_is_modbus_with_its_first_adu() -> None:
    detector = expected()
    assert len(adus(fed(detector, TCP_PAIR[:1]))) == 1
    assert detector.state is ProtocolState.MODBUS


def test_an_unknown_function_at_an_expected_port_is_modbus() -> None:
    assert len(adus(fed(expected(), [(REQUEST, mbap_adu(1, 1, OWN_FUNCTION))]))) == 1


@pytest.mark.parametrize("pair", [TCP_PAIR, RTU_PAIR], ids=["tcp", "rtu"])
def test_elsewhere_a_request_is_held_until_its_response(pair: list[Piece]) -> None:
    detector = anywhere()
    assert fed(detector, pair[:1]) == []
    decoded = fed(detector, pair[1:])
    assert len(adus(decoded)) == 2
    (one,) = transactions(decoded)
    assert one.response_values == [0x1234, 0x5678]
    assert len(transactions(fed(detector, pair))) == 1


@pytest.mark.parametrize("kind", [mbap_adu(1, 1, READ), rtu_adu(1, READ)], ids=["tcp", "rtu"])
def test_elsewhere_enough_requests_in_a_row_are_modbus(kind: bytes) -> None:
    detector = anywhere()
    assert fed(detector, [(REQUEST, kind)] * (ENOUGH_ADUS - 1)) == []
    assert len(adus(fed(detector, [(REQUEST, kind)]))) == ENOUGH_ADUS


def test_elsewhere_unknown_functions_prove_nothing() -> None:
    detector = anywhere()
    assert fed(detector, [(REQUEST, mbap_adu(1, 1, OWN_FUNCTION))] * 9) == []
    assert detector.close() != []
    assert detector.state is ProtocolState.FOREIGN


@pytest.mark.parametrize(
    ("pieces", "name"),
    [
        ([(REQUEST, TLS), (RESPONSE, TLS)], "TLS"),
        ([(REQUEST, b"GET / HTTP/1.1\r\n"), (RESPONSE, b"HTTP/1.1 200 OK\r\n")], "HTTP"),
        ([(RESPONSE, b"SSH-2.0-OpenSSH\r\n"), (REQUEST, b"SSH-2.0-scan\r\n")], "SSH"),
        ([(REQUEST, LDAP_BIND), (RESPONSE, LDAP_ANSWER)], "LDAP"),
        ([(REQUEST, b"\x03\x00\x00\x13\x0e\xe0" + bytes(13)), (RESPONSE, b"\xff" * 9)], "TPKT"),
    ],
)
@pytest.mark.parametrize("port", [expected, anywhere])
def test_another_protocol_is_one_event_that_names_it(
    pieces: list[Piece],
    name: str,
    port: Port,
) -> None:
    detector = port()
    decoded = [*fed(detector, pieces), *fed(detector, pieces * 9), *detector.close()]
    assert is_one_event(decoded)
    assert name in wire_events(decoded)[0].message


def test_another_protocol_without_its_beginning_is_one_event_too() -> None:
    detector = expected(joined=True)
    decoded = [*fed(detector, [(REQUEST, TLS)] * 200), *detector.close()]
    assert is_one_event(decoded)


@pytest.mark.parametrize("size", [1, 3, 500])
def test_tls_without_its_beginning_is_detected_by_the_first_record_of_each_side(size: int) -> None:
    detector = expected(joined=True)
    said = in_pieces([(REQUEST, TLS_DATA)] * 3, size)
    assert fed(detector, said) == []
    decoded = fed(detector, in_pieces([(RESPONSE, TLS_DATA), (REQUEST, TLS_DATA)], size))
    assert is_one_event(decoded)
    assert wire_events(decoded)[0].message == (
        "the connection is TLS: only its ends can read it; "
        "a tap with --tls-cert and --tls-target-ca records it in clear"
    )


def test_tls_that_lost_a_segment_is_still_tls() -> None:
    detector = expected(joined=True)
    assert fed(detector, [(REQUEST, TLS_DATA)]) == []
    assert detector.gap(RESPONSE, 500, 0) == []
    assert is_one_event([*fed(detector, [(RESPONSE, TLS_DATA)]), *detector.close()])


def test_rtu_that_looks_like_tls_records_is_rtu() -> None:
    request = rtu_adu(0x17, bytes.fromhex("03 0100 0001"))
    answer = rtu_adu(0x17, bytes.fromhex("03 02 1234"))
    detector = ProtocolDetector(CONNECTION, joined=True, tcp=False, rtu=True)
    begun: list[Piece] = [(REQUEST, request[:5]), (RESPONSE, answer[:5])]
    decoded = fed(detector, [*begun, (REQUEST, request[5:]), (RESPONSE, answer[5:])])
    assert [one.unit for one in adus(decoded)] == [0x17, 0x17]


def test_a_connection_with_one_silent_side_is_one_event_at_its_end() -> None:
    detector = expected()
    assert fed(detector, [(REQUEST, TLS)]) == []
    assert is_one_event(detector.close())


def test_if_modbus_is_expected_one_side_alone_is_enough() -> None:
    noise: Piece = (REQUEST, b"\x00\x01\x00\x00\x88\x04\x05\x07")
    decoded = fed(expected(), [noise, TCP_PAIR[1]])
    assert [one.pdu for one in adus(decoded)] == [VALUES]


def test_if_modbus_is_expected_malformed_adus_are_returned_at_the_end_at_the_latest() -> None:
    long: Piece = (REQUEST, mbap_adu(1, 1, LONG_READ))
    detector = expected()
    assert fed(detector, [long]) == []
    assert len(adus(detector.close())) == 1
    assert len(adus(fed(expected(), [long] * 3))) == 3


def test_if_modbus_is_expected_a_gap_does_not_speak_against_it() -> None:
    detector = expected()
    (gap,) = detector.gap(REQUEST, 12, 0)
    assert isinstance(gap, WireEvent)
    assert (gap.kind, detector.state) == (EventKind.GAP, ProtocolState.MODBUS)


@pytest.mark.parametrize("address", ["0000", "0300"])
def test_rtu_at_a_modbus_tcp_port_is_decoded_as_what_it_is(address: str) -> None:
    # With address 0 and quantity 2 the request is an ADU of Modbus/TCP, too.
    request, response = bytes.fromhex(f"03 {address} 0002"), bytes.fromhex("03 04 0007 0008")
    pair: list[Piece] = [(REQUEST, rtu_adu(1, request)), (RESPONSE, rtu_adu(1, response))]
    for size in (1, 5, 99):
        (one,) = transactions(fed(expected(), in_pieces(pair, size)))
        assert (one.transport, one.unit, one.response_values) == (Transport.RTU_TCP, 1, [7, 8])


def test_rtu_that_begins_in_the_middle_at_a_modbus_tcp_port_is_named_with_its_option() -> None:
    answer = rtu_adu(1, bytes.fromhex("03 04 0007 0008"))
    detector = expected()
    decoded = [*fed(detector, [(RESPONSE, answer)]), *detector.close()]
    assert is_one_event(decoded)
    assert "--rtu-port" in wire_events(decoded)[0].message


def test_a_frame_that_is_also_an_adu_is_a_frame_because_of_its_crc() -> None:
    # 01 03 00 00 00 02 C4 0B: transaction 0103H, length 2, unit C4H, function 0BH.
    assert rtu_adu(1, READ)[4:6] == b"\x00\x02"
    decoded = fed(at_its_own_port(), RTU_PAIR)
    assert [one.pdu for one in adus(decoded)] == [READ, VALUES]


def test_an_adu_that_is_also_a_frame_is_an_adu_if_its_response_is_one() -> None:
    request = RTU_PAIR[0]
    answer = bytes.fromhex("0103 0000 0006 C4 0B 0000 0000")  # Its counter stands at 0.
    (one,) = transactions(
        [
            *fed(detector := at_its_own_port(), [request, (RESPONSE, answer)]),
            *detector.close(),
        ]
    )
    assert (one.function, one.unit) == (0x0B, 0xC4)


def test_one_rtu_frame_by_chance_does_not_outweigh_expected_modbus_tcp() -> None:
    chance = rtu_adu(0x54, bytes.fromhex("06 0203 0405"))
    for joined in (False, True):
        detector = at_its_own_port(joined=joined)
        said = [(REQUEST, b"\xff" * 90 + chance + b"\xff" * 90)]
        assert is_one_event([*fed(detector, said), *detector.close()])


def test_one_rtu_frame_before_a_gap_does_not_outweigh_expected_modbus_tcp() -> None:
    detector = at_its_own_port(joined=True)
    chance = b"\xff" * 90 + rtu_adu(0x54, bytes.fromhex("06 0203 0405"))
    decoded = fed(detector, [(REQUEST, chance)]) + detector.gap(REQUEST, 9, 0)
    assert is_one_event([*decoded, *detector.close()])


def test_if_modbus_tcp_is_expected_rtu_needs_the_same_evidence_as_elsewhere() -> None:
    assert len(transactions(fed(at_its_own_port(), RTU_PAIR))) == 1
    detector = at_its_own_port()
    assert len(adus(fed(detector, [(REQUEST, rtu_adu(1, WRITE_ONE))] * ENOUGH_ADUS))) == ENOUGH_ADUS


@pytest.mark.parametrize("kind", ["tcp", "rtu", "any"])
@pytest.mark.parametrize("noise", [b"\xff" * 9, b"\xff\x2b\x17" * 400])
def test_bytes_of_another_protocol_are_one_event_when_the_connection_ends(
    kind: str, noise: bytes
) -> None:
    detector = ProtocolDetector(CONNECTION, joined=True, tcp=kind != "rtu", rtu=kind != "tcp")
    assert is_one_event([*fed(detector, [(REQUEST, noise)]), *detector.close()])


def test_an_incomplete_adu_and_a_wrong_crc_are_reported_at_the_end() -> None:
    tcp = expected(joined=True)
    assert fed(tcp, [(REQUEST, mbap_adu(1, 1, READ)[:7])]) == []
    assert [one.kind for one in wire_events(tcp.close())] == [EventKind.SKIPPED]
    wrong_length = expected()
    assert fed(wrong_length, [(REQUEST, b"\x00\x01\x00\x00\x88\x04\x05\x07")]) == []
    assert {one.kind for one in wire_events(wrong_length.close())} == {EventKind.SKIPPED}
    rtu = ProtocolDetector(CONNECTION, joined=True, tcp=False, rtu=True)
    assert fed(rtu, [(REQUEST, rtu_adu(1, READ)[:-1] + b"\xee")]) == []
    assert [one.kind for one in wire_events(rtu.close())] == [EventKind.BAD_CHECK]


@pytest.mark.parametrize(("before", "found"), [(MAX_NOISE - 8, 2), (MAX_NOISE - 7, 0)])
def test_elsewhere_only_the_first_bytes_are_searched_for_a_frame(before: int, found: int) -> None:
    for size in (1, 7, 1000):
        detector = anywhere(joined=True)
        said = [(REQUEST, b"\xff" * before + RTU_PAIR[0][1]), RTU_PAIR[1]]
        decoded = fed(detector, in_pieces(said, size)) + detector.close()
        assert len(adus(decoded)) == found


@pytest.mark.parametrize(
    ("size", "state"),
    [(MAX_NOISE - 1, ProtocolState.UNDECIDED), (MAX_NOISE, ProtocolState.FOREIGN)],
)
def test_elsewhere_a_connection_is_given_up_once_so_much_noise_has_come(
    size: int, state: ProtocolState
) -> None:
    detector = ProtocolDetector(CONNECTION, joined=True, expected=False, tcp=False, rtu=True)
    fed(detector, [(REQUEST, b"\xff" * size)])
    assert detector.state is state


def test_a_connection_that_was_given_up_holds_nothing() -> None:
    detector = anywhere(joined=True)
    for at in range(MAX_UNDECIDED_BYTES // GAP_BYTES):
        detector.gap(REQUEST, 1, at, EventKind.GAP)
    assert detector.state is ProtocolState.FOREIGN
    assert detector._candidates == []


def test_the_master_of_a_connection_without_beginning_is_detected() -> None:
    detector = anywhere(joined=True)
    detector.hold(
        WireEvent(
            ts_ns=0,
            link=CONNECTION.link,
            kind=EventKind.OPENED,
            message="connection joined",
            source=str(CONNECTION.master),
            destination=str(CONNECTION.slave),
        )
    )
    exchanged = [(RESPONSE, TCP_PAIR[0][1]), (REQUEST, TCP_PAIR[1][1])]
    decoded = [*fed(detector, exchanged), *fed(detector, exchanged), *detector.close()]
    one, _ = transactions(decoded)
    assert (one.source, one.destination) == ("10.0.0.9:1502", "10.0.0.1:50211")
    (opened,) = wire_events(decoded)
    assert (opened.source, opened.destination) == (one.source, one.destination)


@given(st.lists(st.tuples(st.sampled_from([REQUEST, RESPONSE]), st.binary(max_size=300))))
def test_held_results_are_bounded(pieces: list[Piece]) -> None:
    detector = anywhere(joined=True)
    given_out = fed(detector, pieces)
    size = sum(len(data) for _, data in pieces)
    if detector.state is ProtocolState.UNDECIDED:
        assert not given_out
        assert size < MAX_UNDECIDED_BYTES


def test_gaps_without_end_are_bounded() -> None:
    detector = anywhere()
    gaps = [
        detector.gap(REQUEST, 1, 7 + place) for place in range(MAX_UNDECIDED_BYTES // GAP_BYTES)
    ]
    assert not any(gaps[:-1])
    assert is_one_event(gaps[-1])
    assert [event.ts_ns for event in wire_events(gaps[-1])] == [7]


PIECES: list[Piece] = [
    *TCP_PAIR,
    *RTU_PAIR,
    (REQUEST, TLS),
    (REQUEST, LDAP_BIND),
    (RESPONSE, LDAP_ANSWER),
    (REQUEST, mbap_adu(2, 1, LONG_READ)),
    (REQUEST, mbap_adu(3, 1, OWN_FUNCTION)),
    (RESPONSE, bytes(40)),
    (REQUEST, b"\xff" * 500),
]


@given(
    pieces=st.lists(st.sampled_from(PIECES), max_size=12),
    size=st.integers(1, 40),
    kind=st.sampled_from([expected, at_its_own_port, anywhere]),
    joined=st.booleans(),
)
def test_where_segments_end_does_not_matter(
    pieces: list[Piece], size: int, kind: Port, joined: bool
) -> None:
    """While the boundaries of ADUs are known; to find them again, segments are evidence."""
    whole, cut = kind(joined=joined), kind(joined=joined)
    wanted = [one for way, data in pieces for one in whole.feed(way, data, 0)] + whole.close()
    found = [
        one
        for way, data in pieces
        for start in range(0, len(data), size)
        for one in cut.feed(way, data[start : start + size], 0)
    ] + cut.close()
    assert cut.state is whole.state
    if not any(Verdict.RESYNCHRONISED in one.verdicts for one in adus([*found, *wanted])):
        assert adus(found) == adus(wanted)
        assert transactions(found) == transactions(wanted)


def test_held_events_are_bounded() -> None:
    detector = anywhere()
    for ts_ns in range(16):
        overlap = WireEvent(
            ts_ns=ts_ns,
            link="x",
            kind=EventKind.OVERLAP,
            message="",
            raw=bytes(3 * MAX_UNDECIDED_BYTES),
        )
        detector.hold(overlap)
    told = wire_events(fed(detector, TCP_PAIR))
    assert [event.ts_ns for event in told] == list(range(8))
    assert {len(event.raw) for event in told} == {MAX_UNDECIDED_BYTES}


def test_one_request_is_enough_at_a_slave_that_answered_on_another_connection() -> None:
    slaves = ProvenSlaves()
    first, second, other = (
        ProtocolDetector(connection, expected=False, rtu=True, slaves=slaves)
        for connection in (
            CONNECTION,
            replace(CONNECTION, master=replace(CONNECTION.master, port=50_001)),
            replace(CONNECTION, slave=replace(CONNECTION.slave, port=9_999)),
        )
    )
    for detector in (first, second, other):
        assert fed(detector, TCP_PAIR[:1]) == []
    assert len(transactions(fed(first, TCP_PAIR[1:]))) == 1
    (one,) = transactions(second.close())
    assert (one.outcome, one.request_raw) == (Outcome.NO_ANSWER, TCP_PAIR[0][1])
    assert is_one_event(other.close())


def test_bytes_of_another_protocol_are_foreign_also_at_a_slave_that_answered() -> None:
    slaves = ProvenSlaves()
    slaves.add(CONNECTION.slave)
    detector = ProtocolDetector(CONNECTION, expected=False, rtu=True, slaves=slaves)
    fed(detector, [(REQUEST, b"GET / HTTP/1.1\r\n\r\n")])
    assert is_one_event(detector.close()) or detector.state is ProtocolState.FOREIGN
