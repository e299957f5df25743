"""The limits and the evidence that decide what a TCP connection carries, one by one."""

from __future__ import annotations

import pytest

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.decode.protocol_detection import (
    MAX_NOISE,
    MAX_UNDECIDED_BYTES,
    ProtocolDetector,
    ProtocolState,
)
from mbtool.modbus.adu import mbap_adu, rtu_adu
from tests.decode.test_protocol_detection import (
    CONNECTION,
    LONG_READ,
    OWN_FUNCTION,
    READ,
    REQUEST,
    RESPONSE,
    RTU_PAIR,
    TCP_PAIR,
    TLS,
    TLS_DATA,
    VALUES,
    WRITE_ONE,
    Piece,
    Port,
    anywhere,
    at_its_own_port,
    expected,
    fed,
    in_pieces,
    is_one_event,
)
from tests.modbus.reading import adus, transactions, wire_events

UNDECIDED, MODBUS, FOREIGN = ProtocolState.UNDECIDED, ProtocolState.MODBUS, ProtocolState.FOREIGN
NOISE = b"\xff"


def rtu_port(*, joined: bool = False) -> ProtocolDetector:
    """A connection to a port that the user named for RTU over TCP."""
    return ProtocolDetector(CONNECTION, joined=joined, tcp=False, rtu=True)


@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize(
    ("port", "pair"),
    [(expected, TCP_PAIR), (anywhere, TCP_PAIR), (anywhere, RTU_PAIR), (rtu_port, RTU_PAIR)],
)
def test_an_adu_may_be_cut_into_segments_at_every_byte(
    port: Port, pair: list[Piece], joined: bool
) -> None:
    for size in range(1, 14):
        detector = port(joined=joined)
        decoded = fed(detector, in_pieces(pair * 2, size))
        assert detector.state is MODBUS, size
        # If the capture lacks the beginning, the first response may answer an earlier request.
        decoded += detector.advance(1_000_000_000)
        assert len(transactions(decoded)) == 2, size


@pytest.mark.parametrize(
    ("request_pdu", "response_pdu", "is_evidence"),
    [
        (READ, VALUES, True),
        (READ, bytes.fromhex("83 02"), True),
        (READ, bytes.fromhex("83 02 00"), False),  # An exception with a byte too much.
        (READ, bytes.fromhex("03 02 1234"), False),  # Too few values.
        (LONG_READ, VALUES, False),
        (OWN_FUNCTION, bytes.fromhex("41 02"), False),
    ],
)
def test_elsewhere_a_pair_is_evidence_if_both_have_the_form_of_a_known_function(
    request_pdu: bytes, response_pdu: bytes, is_evidence: bool
) -> None:
    pair = [(REQUEST, mbap_adu(1, 1, request_pdu)), (RESPONSE, mbap_adu(1, 1, response_pdu))]
    detector = anywhere()
    fed(detector, pair)
    assert detector.state is (MODBUS if is_evidence else UNDECIDED)


@pytest.mark.parametrize("way", [REQUEST, RESPONSE])
@pytest.mark.parametrize(("size", "state"), [(255, UNDECIDED), (256, FOREIGN)])
def test_elsewhere_noise_of_either_direction_speaks_against_rtu(
    way: Direction, size: int, state: ProtocolState
) -> None:
    detector = ProtocolDetector(CONNECTION, joined=True, expected=False, tcp=False, rtu=True)
    half = size // 2
    fed(detector, [(way, NOISE * half), (way, NOISE * (size - half))])
    assert detector.state is state


@pytest.mark.parametrize(("size", "state"), [(2047, UNDECIDED), (2048, FOREIGN)])
@pytest.mark.parametrize("part", [1, 700, 5000])
def test_a_connection_is_undecided_for_so_many_bytes(
    size: int, state: ProtocolState, part: int
) -> None:
    detector = expected(joined=True)
    decoded = fed(detector, in_pieces([(REQUEST, NOISE * size)], part))
    assert (detector.state, is_one_event(decoded)) == (state, state is FOREIGN)


@pytest.mark.parametrize(("more", "state"), [(0, UNDECIDED), (1, FOREIGN)])
def test_a_gap_counts_as_64_bytes(more: int, state: ProtocolState) -> None:
    detector = anywhere(joined=True)
    for missing in range(12):
        assert detector.gap(REQUEST, missing, 0) == detector.gap(RESPONSE, 1000, 0) == []
    room = 2048 - 24 * 64 - 1
    fed(detector, [(REQUEST, NOISE * (room + more))])
    assert detector.state is state


@pytest.mark.parametrize("way", [REQUEST, RESPONSE])
@pytest.mark.parametrize(("size", "state"), [(519, UNDECIDED), (520, FOREIGN)])
def test_elsewhere_noise_of_either_direction_speaks_against_modbus_tcp(
    way: Direction, size: int, state: ProtocolState
) -> None:
    detector = anywhere(joined=True)
    half = size // 2
    fed(detector, [(way, NOISE * half), (way, NOISE * (size - half))])
    assert detector.state is state


def test_elsewhere_the_rests_of_two_long_adus_do_not_speak_against_modbus_tcp() -> None:
    rest = mbap_adu(1, 1, bytes([3, 250]) + b"\x01" * 250)[6:]
    detector = anywhere(joined=True)
    said: list[Piece] = [(RESPONSE, rest), (REQUEST, mbap_adu(2, 1, READ))]
    decoded = fed(detector, [*said, (RESPONSE, rest[200:]), *said[1:], *said[1:]])
    assert detector.state is MODBUS
    assert [one.transaction_id for one in adus(decoded)] == [2, 2, 2]


def test_bytes_behind_the_limit_are_decoded_if_the_last_ones_before_it_decide() -> None:
    detector = expected(joined=True)
    first = mbap_adu(1, 1, READ)
    begun = NOISE * (MAX_UNDECIDED_BYTES - len(first))
    said: list[Piece] = [(REQUEST, begun), (REQUEST, first + mbap_adu(2, 1, READ))]
    assert [one.transaction_id for one in adus(fed(detector, said))] == [1, 2]


@pytest.mark.parametrize("port", [expected, anywhere])
def test_three_malformed_adus_decide(port: Port) -> None:
    long: Piece = (REQUEST, mbap_adu(1, 1, LONG_READ))
    detector = port()
    assert fed(detector, [long] * 2) == []
    assert detector.state is UNDECIDED
    decoded = fed(detector, [long])
    is_foreign = port is anywhere
    assert detector.state is (FOREIGN if is_foreign else MODBUS)
    assert len(adus(decoded)) == (0 if is_foreign else 3)


def test_what_decided_first_counts_though_more_of_the_segment_speaks_against_it() -> None:
    long = mbap_adu(1, 1, LONG_READ)
    detector = anywhere()
    fed(detector, [TCP_PAIR[0], (RESPONSE, TCP_PAIR[1][1] + long * 4)])
    assert detector.state is MODBUS
    detector = anywhere()
    assert is_one_event(fed(detector, [(REQUEST, long * 3 + TCP_PAIR[0][1] * 4)]))


@pytest.mark.parametrize(
    "between",
    [(REQUEST, mbap_adu(9, 1, LONG_READ)), (RESPONSE, mbap_adu(9, 1, LONG_READ))],
    ids=["of its direction", "of the other direction"],
)
def test_elsewhere_a_malformed_adu_ends_a_row_of_well_formed_ones(between: Piece) -> None:
    good: Piece = (REQUEST, mbap_adu(1, 1, READ))
    detector = anywhere()
    fed(detector, [good] * 2 + [between] + [good] * 2)
    assert detector.state is UNDECIDED
    fed(detector, [good])
    assert detector.state is MODBUS


def test_elsewhere_noise_ends_a_row_of_frames_and_a_gap_does_not() -> None:
    frame: Piece = (REQUEST, rtu_adu(1, WRITE_ONE))
    detector = anywhere()
    fed(detector, [frame] * 2)
    assert detector.gap(REQUEST, 8, 0) == []
    assert len(adus(fed(detector, [frame]))) == 3
    detector = anywhere()
    noise: Piece = (REQUEST, NOISE * 300)
    fed(detector, [frame] * 2 + [noise, frame])
    assert detector.state is UNDECIDED


def test_another_protocols_message_at_an_expected_port_is_foreign_at_once() -> None:
    """An LDAP message that is an ADU of 15 bytes, whose function has another length."""
    message = bytes.fromhex("30 84 0000000f 02 01 01 60 84 00000006 02 01 03 04 00 80")
    detector = expected(joined=True)
    assert is_one_event(fed(detector, [(REQUEST, message)]))


@pytest.mark.parametrize(
    ("head", "is_possible"),
    [
        (b"\x12\x34\x00\x00\x00\x06\x01", True),
        (b"\x12\x34\x00\x00\x00", True),
        (b"\x12\x34\x00", True),
        (b"\x12", True),
        (b"\x12\x34\x00\x01", False),
        (b"\x12\x34\x01", False),
        (b"\x12\x34\x00\x00\x06", False),  # A length of more than 1454.
        (b"\x12\x34\x00\x00\x00\x01", False),
    ],
)
def test_the_first_bytes_of_both_directions_must_be_able_to_begin_an_adu(
    head: bytes, is_possible: bool
) -> None:
    detector = expected()
    fed(detector, [(REQUEST, head)])
    assert detector.state is UNDECIDED  # One direction alone does not speak against it.
    fed(detector, [(RESPONSE, head)])
    assert detector.state is (UNDECIDED if is_possible else FOREIGN)
    elsewhere = ProtocolDetector(CONNECTION, expected=False)
    fed(elsewhere, [(REQUEST, head)])
    assert elsewhere.state is (UNDECIDED if is_possible else FOREIGN)


@pytest.mark.parametrize(
    ("head", "is_modbus"),
    [(b"", False), (b"\x12", True), (b"\x12\x34\x00\x00\x77\x77", True), (b"\x12\x34\x01", False)],
)
@pytest.mark.parametrize("end", ["gap", "close"])
def test_at_an_expected_port_the_protocol_id_decides_when_nothing_more_comes(
    head: bytes, is_modbus: bool, end: str
) -> None:
    detector = expected(joined=True)
    if head:
        fed(detector, [(REQUEST, head)])
    decoded = detector.gap(REQUEST, 5, 0) if end == "gap" else detector.close()
    if not head:  # A gap before the first byte says nothing against Modbus.
        assert detector.state is (MODBUS if end == "gap" else UNDECIDED)
    elif is_modbus:
        assert (detector.state, bool(decoded)) == (MODBUS, True)
    else:
        assert detector.state is (UNDECIDED if end == "gap" else FOREIGN)


def test_a_gap_takes_away_the_beginning_of_its_direction_only() -> None:
    detector = ProtocolDetector(CONNECTION, expected=False)
    assert detector.gap(REQUEST, 5, 0) == []
    assert fed(detector, [(REQUEST, NOISE * 7)]) == []
    assert detector.state is UNDECIDED
    assert is_one_event(fed(detector, [(RESPONSE, NOISE * 7)]))


@pytest.mark.parametrize("way", [REQUEST, RESPONSE])
def test_a_foreign_connection_is_told_with_its_ends_its_first_bytes_and_their_time(
    way: Direction,
) -> None:
    for begins in ([(way, TLS_DATA)], [(way, b""), (way, TLS_DATA)]):
        detector = expected()
        for at, (direction, data) in enumerate(begins, 5):
            assert detector.feed(direction, data, at) == []
        other = RESPONSE if way is REQUEST else REQUEST
        (event,) = wire_events(detector.feed(other, TLS_DATA, 9))
        assert event.ts_ns == 4 + len(begins)
        assert (event.source, event.destination) == ("10.0.0.1:50211", "10.0.0.9:1502")
        assert (event.link, event.kind) == (CONNECTION.link, EventKind.FOREIGN)
        assert event.raw == (TLS_DATA + TLS_DATA)[:257]
        assert detector.feed(way, TLS, 10) == detector.gap(way, 1, 11) == detector.close() == []
        assert detector.advance(12) == []


@pytest.mark.parametrize(
    ("joined", "pair", "roles", "is_plain"),
    [
        (False, TCP_PAIR, {}, True),
        (False, RTU_PAIR, {}, False),
        (True, TCP_PAIR, {REQUEST: RESPONSE, RESPONSE: REQUEST}, False),
        (True, TCP_PAIR, {}, True),
    ],
)
def test_only_modbus_tcp_in_the_expected_roles_may_be_decoded_elsewhere(
    joined: bool, pair: list[Piece], roles: dict[Direction, Direction], is_plain: bool
) -> None:
    detector = anywhere(joined=joined)
    assert detector.plain_decoder() is None
    fed(detector, [(roles.get(way, way), data) for way, data in (pair * 2)[: 3 if joined else 2]])
    assert detector.state is MODBUS
    assert (detector.plain_decoder() is not None) is is_plain


def test_of_a_foreign_connection_so_many_first_bytes_are_kept() -> None:
    (event,) = wire_events(
        fed(expected(joined=True), [(REQUEST, NOISE * 9), (RESPONSE, TLS * 200)])
    )
    assert event.raw == (NOISE * 9 + TLS * 200)[:257]


def opened(raw: bytes = b"") -> WireEvent:
    return WireEvent(
        ts_ns=0,
        link="10.0.0.9",
        kind=EventKind.OPENED,
        message="",
        source=str(CONNECTION.master),
        destination=str(CONNECTION.slave),
        raw=raw,
    )


def test_events_are_told_in_the_roles_that_were_detected() -> None:
    detector = anywhere(joined=True)
    swapped = [(RESPONSE, TCP_PAIR[0][1]), (REQUEST, TCP_PAIR[1][1])]
    fed(detector, [*swapped, swapped[0]])
    told, with_bytes = (detector.with_detected_roles(opened(raw)) for raw in (b"", b"\x01"))
    assert (told.source, told.destination) == ("10.0.0.9:1502", "10.0.0.1:50211")
    # Whoever sent the bytes sent them, whatever the roles are.
    assert (with_bytes.source, with_bytes.destination) == (told.destination, told.source)
    assert told.link == with_bytes.link == "10.0.0.1:50211"
    straight = anywhere(joined=True)
    fed(straight, [*TCP_PAIR, TCP_PAIR[0]])
    assert straight.with_detected_roles(opened()) == opened()
    refused = expected()
    fed(refused, [(REQUEST, TLS), (RESPONSE, TLS)])
    assert refused.with_detected_roles(opened()) == opened()


def test_a_request_that_waits_is_closed_while_its_connection_is_undecided() -> None:
    """What time says goes to the held results, and comes out with them."""
    detector = anywhere()
    assert detector.feed(REQUEST, mbap_adu(1, 1, READ), 0) == []
    assert detector.advance(100_000_000_000) == []
    late = 100_000_000_001
    assert detector.feed(REQUEST, mbap_adu(2, 1, READ), late) == []
    decoded = detector.feed(RESPONSE, mbap_adu(2, 1, VALUES), late)
    said = [type(one).__name__ for one in decoded]
    assert said == ["Adu", "Transaction", "Adu", "Adu", "Transaction"]
    assert [one.outcome for one in transactions(decoded)] == ["no-answer", "ok"]
    assert detector.advance(100_000_000_002) == []


@pytest.mark.parametrize("end_ns", [None, 1000])
def test_the_end_of_a_connection_and_of_a_capture_differ_for_its_open_requests(
    end_ns: int | None,
) -> None:
    outcome = "no-answer" if end_ns is None else "not-captured"
    decided, undecided = expected(), anywhere()
    fed(decided, [(REQUEST, mbap_adu(1, 1, READ))])
    fed(undecided, [(REQUEST, mbap_adu(1, 1, READ))] * 3)
    for detector, count in ((decided, 1), (undecided, 3)):
        done = transactions(detector.close(end_ns))
        assert [one.outcome for one in done] == [outcome] * count


def test_a_connection_without_bytes_ends_without_a_word() -> None:
    assert expected().close() == anywhere(joined=True).close() == []


def test_all_bytes_of_a_long_segment_with_frames_are_read() -> None:
    frame = rtu_adu(1, WRITE_ONE)
    count = 2 * MAX_NOISE // len(frame)
    assert len(adus(fed(anywhere(), [(REQUEST, frame * count)]))) == count


def test_frames_at_a_modbus_tcp_port_wait_until_the_next_adu_decides() -> None:
    """01 03 00 00 00 02 C4 0B is a frame and also an ADU; two whole ADUs are no frames."""
    detector = at_its_own_port()
    assert fed(detector, [RTU_PAIR[0]]) == []
    assert detector.state is UNDECIDED
    assert len(adus(detector.close())) == 1
