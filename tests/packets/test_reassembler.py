from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Chunk, Connection, Direction, Endpoint, EventKind, Stamp, WireEvent
from mbtool.packets.reassembler import TcpReassembler
from mbtool.packets.segment import ACK, FIN, RST, SYN
from mbtool.packets.stream_events import (
    CloseReason,
    StreamClosed,
    StreamEvent,
    StreamGap,
    StreamOpened,
)
from tests.captures import read_packets
from tests.packets.building import (
    MASTER,
    MASTER_PORT,
    SLAVE,
    End,
    Talk,
    cut,
    ethernet,
    in_fragments,
    ipv4,
    ipv6,
    packet,
    tcp,
)
from tests.packets.reading import close_reasons, run_packets, wire_events, words_of

if TYPE_CHECKING:
    from pathlib import Path

_MASTER = Endpoint("10.0.0.1", 49152)
_SLAVE = Endpoint("10.0.0.2", 502)
_MS = 1_000_000

# The limits of the reassembler, as numbers: with others, decode reports other ends of connections.
MAX_CONNECTIONS, MAX_HOLDING = 4096, 256
IDLE_NS = 2 * 3600 * 1_000_000_000  # RFC 1122, 4.2.3.6


def test_gives_the_bytes_of_a_connection_with_its_ends_and_times() -> None:
    talk = Talk()

    items = run_packets(
        [*talk.handshake(), talk.request(b"ask"), talk.response(b"tell"), *talk.goodbye()]
    )

    connection = Connection(_MASTER, _SLAVE, 0)
    assert items == [
        StreamOpened(1 * _MS, connection, joined=False),
        Chunk(
            ts_ns=4 * _MS,
            link="10.0.0.2",
            data=b"ask",
            direction=Direction.REQUEST,
            stamp=Stamp.AT_ONCE,
            connection=connection,
        ),
        Chunk(
            ts_ns=5 * _MS,
            link="10.0.0.2",
            data=b"tell",
            direction=Direction.RESPONSE,
            stamp=Stamp.AT_ONCE,
            connection=connection,
        ),
        StreamClosed(7 * _MS, connection, CloseReason.FINISHED, Direction.REQUEST),
    ]


def test_follows_a_connection_over_ipv6() -> None:
    data = tcp(49152, 1502, 1000, payload=b"ask")

    items = run_packets([packet(ipv6(data), link_type=229)], TcpReassembler(frozenset((502, 1502))))

    assert isinstance(items[0], StreamOpened)
    assert items[0].connection == Connection(Endpoint("fd00::1", 49152), Endpoint("fd00::2", 1502))
    assert isinstance(items[1], Chunk)
    assert items[1].link == "[fd00::2]:1502"


def test_passes_over_connections_of_other_ports() -> None:
    talk = Talk(slave=End(SLAVE, 503, 5000))

    assert run_packets([*talk.handshake(), talk.request(b"ask")]) == []


@pytest.mark.parametrize(
    ("source_port", "destination_port", "flags", "slave_port"),
    [
        (502, 1502, ACK, 502),
        (1502, 502, ACK, 502),
        (502, 1502, SYN, 1502),
        (502, 1502, SYN | ACK, 502),
    ],
    ids=["lower port speaks", "lower port listens", "got the SYN", "answered the SYN"],
)
def test_decides_which_end_is_the_slave_if_both_ports_are_wanted(
    source_port: int, destination_port: int, flags: int, slave_port: int
) -> None:
    data = ethernet(ipv4(tcp(source_port, destination_port, 1000, flags=flags, payload=b"a")))

    opened = run_packets([packet(data)], TcpReassembler(frozenset((502, 1502))))[0]

    assert isinstance(opened, StreamOpened)
    assert opened.connection.slave.port == slave_port


def test_with_equal_ports_the_first_destination_is_the_slave() -> None:
    data = ethernet(ipv4(tcp(502, 502, 1000, payload=b"a")))

    opened = run_packets([packet(data)])[0]

    assert isinstance(opened, StreamOpened)
    assert opened.connection.slave.host == "10.0.0.2"


@pytest.mark.parametrize("finished", [False, True])
def test_a_port_used_again_is_another_connection(finished: bool) -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"one")]
    packets += talk.goodbye() if finished else []
    again = Talk(End(MASTER, MASTER_PORT, 1002), End(SLAVE, 502, 9000), talk.ts_ns)
    packets += [*again.handshake(), again.request(b"two")]

    items = run_packets(packets)

    assert words_of(items) == [">one", ">two"]
    numbers = [item.connection.number for item in items if isinstance(item, StreamOpened)]
    assert numbers == [0, 1]
    assert close_reasons(items) == [
        CloseReason.FINISHED if finished else CloseReason.REPLACED,
        CloseReason.CAPTURE_END,
    ]


def test_bytes_after_a_reset_belong_to_another_connection() -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"ask"), talk.at(talk.master, 1004, flags=RST)]

    items = run_packets([*packets, talk.response(b"tell")])

    assert words_of(items) == [">ask", "<tell"]
    assert close_reasons(items) == [CloseReason.RESET, CloseReason.CAPTURE_END]


def test_port_scans_and_stray_packets_open_no_connection() -> None:
    talk = Talk()
    flags = (ACK, FIN | ACK, RST, RST | ACK)

    assert run_packets([talk.at(talk.master, 1000, flags=each) for each in flags]) == []


def test_the_number_of_connections_with_held_bytes_is_limited() -> None:
    reassembler = TcpReassembler()
    said = []
    for number in range(MAX_HOLDING + 1):
        talk = Talk(master=End(MASTER, 10000 + number, 1000))
        said += words_of(
            run_packets(
                [talk.handshake()[0], talk.at(talk.master, 1002, b"x")], reassembler, close=False
            )
        )

    assert said == [1, ">x"]


def test_connections_without_held_bytes_do_not_count_as_holding_ones() -> None:
    reassembler = TcpReassembler()
    said = []
    for number in range(MAX_HOLDING):
        talk = Talk(master=End(MASTER, 10000 + number, 1000))
        packets = [talk.handshake()[0], talk.at(talk.master, 1002, b"x")]
        said += words_of(run_packets(packets, reassembler, close=False))
    for port in (20000, 20001):
        talk = Talk(master=End(MASTER, port, 1000))
        said += words_of(run_packets(talk.handshake(), reassembler, close=False))
    assert said == []


def test_a_connection_that_is_dropped_says_what_it_held() -> None:
    talk = Talk()
    reassembler = TcpReassembler()
    packets = [*talk.handshake(), talk.at(talk.master, 1004, b"def")]
    run_packets(packets, reassembler, close=False)
    with patch("mbtool.packets.reassembler.MAX_CONNECTIONS", 1):
        other = Talk(End(MASTER, 10000, 1000), ts_ns=talk.ts_ns)
        items = run_packets(other.handshake(), reassembler, close=False)
    assert words_of(items) == [3, ">def"]
    assert close_reasons(items) == [CloseReason.DISCARDED]
    assert reassembler.advance(60_000 * _MS) == []


def test_the_least_recently_used_connection_is_discarded_above_the_limit() -> None:
    reassembler = TcpReassembler()
    items = []
    for number in range(MAX_CONNECTIONS + 1):
        talk = Talk(master=End(MASTER, 10000 + number, 1000))
        items += run_packets([talk.request(b"x")], reassembler, close=False)
        if number == 1:
            again = Talk(master=End(MASTER, 10000, 1001), ts_ns=_MS)
            items += run_packets([again.request(b"y")], reassembler, close=False)

    (closed,) = [item for item in items if isinstance(item, StreamClosed)]
    assert closed.reason is CloseReason.DISCARDED
    assert closed.connection.master.port == 10001


def test_a_connection_that_replaces_another_takes_no_other_place() -> None:
    reassembler = TcpReassembler()
    items = []
    with patch("mbtool.packets.reassembler.MAX_CONNECTIONS", 2):
        for port, sequence in ((10000, 1000), (10001, 1000), (10001, 9000)):
            talk = Talk(master=End(MASTER, port, sequence))
            items += run_packets(talk.handshake(), reassembler, close=False)

    (closed,) = [item for item in items if isinstance(item, StreamClosed)]
    assert (closed.reason, closed.connection.master.port) == (CloseReason.REPLACED, 10001)


def test_an_idle_connection_is_forgotten() -> None:
    talk = Talk()
    reassembler = TcpReassembler()
    run_packets([*talk.handshake(), talk.request(b"one")], reassembler, close=False)

    assert reassembler.advance(4 * _MS + IDLE_NS - 1) == []
    assert close_reasons(reassembler.advance(4 * _MS + IDLE_NS)) == [CloseReason.IDLE]
    items = run_packets([talk.request(b"two")], reassembler)
    assert isinstance(items[0], StreamOpened)
    assert items[0].joined


def test_a_clock_that_steps_back_loses_nothing() -> None:
    talk = Talk(ts_ns=10**18)
    packets = [*talk.handshake(), talk.request(b"one")]
    talk.ts_ns = 0
    packets += [talk.response(b"ONE"), talk.request(b"two")]

    items = run_packets(packets)

    assert words_of(items) == [">one", "<ONE", ">two"]
    assert close_reasons(items) == [CloseReason.CAPTURE_END]


def test_no_more_than_4096_reports_are_remembered() -> None:
    reassembler = TcpReassembler()
    told = []
    for number in (*range(4097), 0):
        told += reassembler.feed(packet(b"", link_type=9999, link=str(number)))
    assert len(told) == 4096


_OF_A_LINE = "; if it holds bytes of a serial line, say which: --link rtu@19200-8E1"


@pytest.mark.parametrize(
    ("link_type", "hint"), [(148, _OF_A_LINE), (162, _OF_A_LINE), (163, ""), (9999, "")]
)
def test_an_unknown_link_type_is_one_event_for_each_interface(link_type: int, hint: str) -> None:
    packets = [
        packet(b"abc", 7, link_type=link_type, link="if0"),
        packet(b"abc", 8, link_type=link_type, link="if0"),
        packet(b"abc", 9, link_type=link_type, link="if1"),
    ]

    assert run_packets(packets) == [
        WireEvent(
            ts_ns=7 + 2 * number,
            link=link,
            kind=EventKind.UNREADABLE,
            message=f"link type {link_type} cannot be looked into{hint}",
        )
        for number, link in enumerate(("if0", "if1"))
    ]


def test_packets_cut_in_their_headers_are_one_event() -> None:
    talk = Talk()

    (event,) = run_packets([cut(each, 40) for each in (*talk.handshake(), talk.request(b"a" * 20))])

    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.CUT


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2), (0, 0, 1, 1, 2, 2)])
def test_a_packet_in_fragments_is_reassembled(order: tuple[int, ...]) -> None:
    talk = Talk()
    packets = talk.handshake()
    fragments = in_fragments(talk.request(bytes(range(65, 91))), 8, 24)
    packets += [replace(fragments[at], ts_ns=10 * _MS + turn) for turn, at in enumerate(order)]

    items = run_packets([*packets, talk.response(b"tell")])

    assert words_of(items) == [">ABCDEFGHIJKLMNOPQRSTUVWXYZ", "<tell"]
    assert wire_events(items) == []
    (asked, _) = [item for item in items if isinstance(item, Chunk)]
    assert asked.ts_ns == 10 * _MS + (4 if len(order) > 3 else 2)


def test_fragments_of_ipv6_with_extension_headers_are_reassembled() -> None:
    header = bytes.fromhex("06 00 0104 00000000")  # destination options before TCP
    data = header + tcp(49152, 502, 1000, payload=b"abcdefghijk")
    hops = bytes.fromhex("2c 00 0104 00000000")  # hop-by-hop options before the fragment header
    parts = []
    for at, more in ((0, 1), (8, 1), (16, 0)):
        part = data[at : at + 8] if more else data[at:]
        field = (at | more).to_bytes(2, "big")
        parts.append(ipv6(hops + b"\x3c\x00" + field + b"\x00\x00\x00\x09" + part, following=0))

    items = run_packets([packet(each, link_type=229) for each in parts])

    assert words_of(items) == [">abcdefghijk"]


def test_fragments_that_contradict_each_other_are_one_event() -> None:
    talk = Talk()
    packets = talk.handshake()
    whole = talk.request(b"first copy!!")
    other = replace(whole, data=whole.data.replace(b"first", b"worst"))
    packets += [in_fragments(whole, 24)[0], *in_fragments(other, 24)]

    items = run_packets(packets)

    assert words_of(items) == [">first copy!!"]
    (event,) = wire_events(items)
    assert (event.kind, event.link) == (EventKind.OVERLAP, "if0")
    assert event.message == "fragments of a packet contradict each other; the first copy is kept"
    assert (event.source, event.destination) == (str(_MASTER), str(_SLAVE))


def test_a_packet_that_lacks_a_fragment_is_one_event() -> None:
    talk = Talk()
    packets = talk.handshake()
    packets += in_fragments(talk.request(b"never whole"), 24)[:1]
    items = run_packets([*packets, talk.request(b"x")])

    # Its bytes are a gap of the connection too.
    assert words_of(items) == [11, ">x"]
    (event,) = wire_events(items)
    assert (event.kind, event.raw[-4:]) == (EventKind.UNREADABLE, b"neve")
    assert event.message == "a packet of which fragments are missing"


def test_a_packet_that_lacks_a_fragment_is_told_when_its_time_is_over() -> None:
    reassembler = TcpReassembler()
    first = in_fragments(Talk().request(b"never whole"), 24)[0]  # At 1 ms.
    run_packets([first], reassembler, close=False)
    assert reassembler.advance(1 * _MS + 9_999_999_999) == []
    (event,) = wire_events(reassembler.advance(1 * _MS + 10_000_000_000))
    assert (event.message, event.ts_ns) == (
        "a packet of which fragments are missing", 1 * _MS + 10_000_000_000,
    )  # fmt: skip


def test_fragments_without_the_first_one_are_one_event_for_each_interface() -> None:
    talk = Talk()
    packets = [
        in_fragments(talk.request(b"abcdefghijk"), 24, identification=number)[1]
        for number in range(3)
    ]

    (event,) = wire_events(run_packets(packets))

    assert event.message == "fragments of packets whose first one is not in the capture"


def test_fragments_of_other_ports_are_passed_over() -> None:
    talk = Talk(slave=End(SLAVE, 503, 5000))
    first, second = in_fragments(talk.request(b"abcdefghijk"), 24)

    assert run_packets([first, first, second]) == []
    assert run_packets([first]) == []


@pytest.mark.parametrize("across", [False, True])
def test_packets_of_two_interfaces_are_put_together_only_if_wanted(across: bool) -> None:
    talk = Talk()
    packets = [*talk.handshake(), talk.request(b"first"), talk.request(b"second")]
    packets += in_fragments(talk.request(b"in fragments"), 24)
    moved = [replace(each, link=f"if{at % 2}") for at, each in enumerate(packets)]
    items = run_packets(moved, TcpReassembler(across=across))
    opened = [item for item in items if isinstance(item, StreamOpened)]
    assert len(opened) == (1 if across else 2)
    assert (words_of(items)[:3] == [">first", ">second", ">in fragments"]) == across
    assert bool(wire_events(items)) != across


def test_connections_of_the_same_ports_are_told_apart_by_their_addresses() -> None:
    pairs = (("10.0.0.1", "10.0.0.2"), ("10.0.0.3", "10.0.0.2"), ("10.0.0.3", "10.0.0.1"))
    talks = [Talk(End(master, 502, 1000), End(slave, 502, 5000)) for master, slave in pairs]
    packets = [one for talk in talks for one in talk.handshake()]
    packets += [talk.request(b"%d" % at) for at, talk in enumerate(talks)]
    packets += [talk.response(b"%d" % at) for at, talk in enumerate(talks)]
    items = run_packets(packets)
    assert words_of(items) == [">0", ">1", ">2", "<0", "<1", "<2"]
    chunks = [item for item in items if isinstance(item, Chunk)]
    assert [one.connection.master.host for one in chunks if one.connection] == [
        "10.0.0.1", "10.0.0.3", "10.0.0.3",
    ] * 2  # fmt: skip


def test_only_whole_ports_are_compared() -> None:
    for source, destination, is_read in (
        (502, 1, True), (1, 502, True), (0x01F7, 1, False), (0x02F6, 1, False),
        (1, 0x01F5, False), (1, 0xF6, False), (0xF601, 0x0001, False), (0x0101, 0xF6F6, False),
    ):  # fmt: skip
        data = ethernet(ipv4(tcp(source, destination, 1, payload=b"a")))
        assert bool(run_packets([packet(data)])) == is_read, (source, destination)


def test_the_time_of_a_second_connection_lets_the_first_go_on() -> None:
    talk, other = Talk(), Talk(End(MASTER, 10000, 1000), ts_ns=20_000 * _MS)
    packets = [*talk.handshake(), talk.at(talk.master, 1004, b"def")]
    assert words_of(run_packets([*packets, *other.handshake()], close=False)) == [3, ">def"]


def test_an_address_before_a_tunnel_is_not_that_of_an_end() -> None:
    data = ipv4(tcp(49152, 502, 1000, payload=b"ask"))
    inner = bytes.fromhex("0a0000000001 0a0000000002 0800") + data
    outer = bytes.fromhex("0b0000000001 0b0000000002 0800") + ipv4(data, protocol=4)
    for frame, addresses in ((inner, True), (outer, False)):
        (chunk,) = [one for one in run_packets([packet(frame)]) if isinstance(one, Chunk)]
        assert chunk.place is not None
        assert chunk.place.origin is not None
        assert (chunk.place.origin.addresses is not None) == addresses


@given(
    changes=st.lists(
        st.tuples(st.integers(0, 40), st.integers(0, 79), st.integers(0, 255)), max_size=12
    ),
    lengths=st.lists(st.tuples(st.integers(0, 40), st.integers(0, 80)), max_size=4),
    link_type=st.sampled_from((0, 1, 9, 101, 104, 105, 108, 113, 127, 276, 9999)),
)
def test_no_packet_raises_or_holds_without_bound(
    changes: list[tuple[int, int, int]], lengths: list[tuple[int, int]], link_type: int
) -> None:
    talk = Talk()
    packets = talk.handshake()
    for number in range(10):
        packets += [talk.request(f"ask{number}".encode()), talk.response(f"tell{number}".encode())]
    packets += talk.goodbye()
    if link_type != 1:
        packets = [replace(each, link_type=link_type, data=each.data[14:]) for each in packets]
    for index, at, value in changes:
        each = packets[index % len(packets)]
        data = bytearray(each.data)
        data[at % len(data)] = value
        packets[index % len(packets)] = replace(each, data=bytes(data))
    for index, length in lengths:
        packets[index % len(packets)] = cut(packets[index % len(packets)], max(length, 1))
    reassembler = TcpReassembler()

    items = run_packets(packets, reassembler)

    opened = {item.connection for item in items if isinstance(item, StreamOpened)}
    closed = {item.connection for item in items if isinstance(item, StreamClosed)}
    assert opened == closed
    assert reassembler.close(0) == []


# Derived captures hold the same bytes as their origins, wrapped, cut or mixed up differently.
_ICSNPP = "cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap"
_PLC4X = "apache__plc4x/modbus__tcp__manual-test-capture.pcapng"
_NOPNOP = "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap"
_SURICATA = "OISF__suricata-verify/tests__modbus__modbus.pcap"
_GATEWAY = "Stepping0__modbus-dnp3-gateway/pcap__modbus.pcapng"
_ITI = "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap"


@pytest.mark.public_captures
@pytest.mark.parametrize(
    ("derived", "origin", "same_times"),
    [
        ("vlan_icsnpp_example.pcap", _ICSNPP, True),
        ("disorder_icsnpp.pcap", _ICSNPP, False),
        ("sll2_ndpi.pcap", "ntop__nDPI/modbus.pcap", True),
        ("loop108_plc4x.pcap", _PLC4X, True),
        ("us_be_zeeksmall.pcap", "zeek__zeek/modbusSmall.pcap", True),
        ("gz_eit.pcap.gz", "zeek__zeek/modbus-eit.pcap", True),
        ("ipv6_iti_modbus_test.pcap", _ITI, True),
        ("port10502_stepping0.pcap", _GATEWAY, True),
        ("reseg5_suricata.pcap", _SURICATA, False),
        ("reseg9_nopnop.pcap", _NOPNOP, False),
    ],
)
def test_derived_public_captures_carry_the_bytes_of_their_origins(
    public_captures: Path, derived: str, origin: str, same_times: bool
) -> None:
    wanted, wanted_times = _streams(public_captures / origin)
    given_, times = _streams(public_captures / "derived" / derived)

    assert wanted
    assert given_ == wanted
    if same_times:
        # Some of the derived files keep microseconds only.
        assert [ns // 1000 for ns in times] == [ns // 1000 for ns in wanted_times]


def _streams(path: Path) -> tuple[list[bytes], list[int]]:
    """Give the bytes of each direction of each connection, and the times of all chunks."""
    reassembler = TcpReassembler(frozenset((502, 10502)))
    streams: dict[tuple[Connection, Direction], bytes] = {}
    times = []
    for item in run_packets(list(read_packets(path)), reassembler):
        assert not isinstance(item, StreamGap)
        if isinstance(item, Chunk) and item.connection is not None:
            key = (item.connection, item.direction)
            streams[key] = streams.get(key, b"") + item.data
            times.append(item.ts_ns)
    return sorted(streams.values()), times


@pytest.mark.public_captures
def test_a_public_capture_of_many_connections_has_one_chunk_for_each_adu(
    public_captures: Path,
) -> None:
    # 37436 ADUs in 9354 connections, nearly all on ports used before, with 11 retransmissions: 5 of
    # a SYN, 6 with bytes.
    path = public_captures / "antoine-lemay__Modbus_dataset/channel_4d_5s.pcap"
    reassembler = TcpReassembler()
    kinds = Counter(type(item) for each in read_packets(path) for item in reassembler.feed(each))

    assert kinds == {Chunk: 37436, StreamOpened: 9354, StreamClosed: 9354, StreamEvent: 6}
