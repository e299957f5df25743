"""Modbus over UDP: datagrams that are whole, lost, doubled, late and cut."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, NamedTransaction, Namer
from mbtool.modbus import mbap_adu, rtu_adu
from tests.packets.building import MASTER, SLAVE, cut, ethernet, ipv4, ipv6, packet, udp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core import Packet

MS = 1_000_000
READ = bytes.fromhex("03 0000 0002")
TWO = bytes.fromhex("03 04 0001 0002")


def _sent(
    payload: bytes,
    ms: float,
    *,
    is_request: bool = True,
    number: int = 0,
    ports: tuple[int, int] = (50000, 502),
    link: str = "if0",
) -> Packet:
    hosts, ends = (MASTER, SLAVE), ports
    if not is_request:
        hosts, ends = hosts[::-1], ends[::-1]
    datagram = ipv4(udp(*ends, payload), *hosts, protocol=17, identification=number)
    return packet(ethernet(datagram), round(ms * MS), link=link)


def _response(payload: bytes, ms: float, **options: int) -> Packet:
    return _sent(payload, ms, is_request=False, **options)  # type: ignore[arg-type]


def _records(
    packets: Sequence[Packet], **options: object
) -> tuple[list[NamedTransaction], list[WireEvent]]:
    given = {"ports": (502,), "across": True} | options
    decoder = Decoder(Namer(Assignments()), **given)  # type: ignore[arg-type]
    records = [record for one in packets for record in decoder.feed(one)] + decoder.close()
    return (
        [one for one in records if not isinstance(one, WireEvent)],
        [one for one in records if isinstance(one, WireEvent)],
    )


def _told(found: list[NamedTransaction]) -> list[tuple[str, int | None]]:
    by_time = sorted(found, key=lambda one: one.start_ns)
    return [(str(one.outcome), one.latency_ns and one.latency_ns // MS) for one in by_time]


def test_a_request_and_its_response_are_a_transaction() -> None:
    packets = [_sent(mbap_adu(7, 1, READ), 0), _response(mbap_adu(7, 1, TWO), 5)]
    (one,), events = _records(packets)
    assert events == []
    assert (str(one.transport), str(one.outcome), one.response_values) == ("udp", "ok", [1, 2])
    assert (one.link, one.source, one.destination) == (SLAVE, f"{MASTER}:50000", f"{SLAVE}:502")
    assert one.latency_ns == 5 * MS


def test_datagrams_of_rtu_are_read_at_the_ports_for_rtu() -> None:
    packets = [
        _sent(rtu_adu(1, READ), 0, ports=(50000, 4001)),
        _sent(rtu_adu(1, TWO), 5, ports=(50000, 4001), is_request=False),
    ]
    (one,), events = _records(packets, ports=(), rtu_ports=(4001,))
    assert events == []
    assert (str(one.transport), str(one.outcome)) == ("rtu-udp", "ok")


def test_datagrams_in_ipv6_are_read() -> None:
    packets = [
        packet(ethernet(ipv6(udp(50000, 502, mbap_adu(7, 1, READ)), following=17), 0x86DD)),
        packet(
            ethernet(
                ipv6(udp(502, 50000, mbap_adu(7, 1, TWO)), "fd00::2", "fd00::1", following=17),
                0x86DD,
            ),
            MS,
        ),
    ]
    assert _told(_records(packets)[0]) == [("ok", 1)]


def test_both_ends_may_use_the_same_port() -> None:
    packets = [
        _sent(mbap_adu(7, 1, READ), 0, ports=(502, 502)),
        _sent(mbap_adu(7, 1, TWO), 5, ports=(502, 502), is_request=False),
    ]
    (one,), _ = _records(packets)
    assert (one.source, str(one.outcome)) == (f"{MASTER}:502", "ok")


def test_a_lost_datagram_costs_its_transaction_only() -> None:
    packets = [
        _sent(mbap_adu(1, 1, READ), 0),
        _response(mbap_adu(1, 1, TWO), 5),
        _sent(mbap_adu(2, 1, READ), 100),  # Its response is lost.
        _sent(mbap_adu(3, 1, READ), 3000),
        _response(mbap_adu(3, 1, TWO), 3005),
        _response(mbap_adu(4, 1, TWO), 3105),  # The capture lacks its request.
    ]
    found, events = _records(packets)
    assert _told(found) == [("ok", 5), ("no-answer", None), ("ok", 5), ("not-captured", None)]
    assert events == []


def test_a_repeated_request_whose_response_comes_late_is_told_as_late() -> None:
    packets = []
    for number in range(60):  # This master waits for each response, or for a second.
        packets += [
            _sent(mbap_adu(number, 1, READ), 100 * number),
            _response(mbap_adu(number, 1, TWO), 100 * number + 5),
        ]
    packets += [
        _sent(mbap_adu(60, 1, READ), 10000),
        _sent(mbap_adu(61, 1, READ), 11000),
        _response(mbap_adu(60, 1, TWO), 11005),
        _response(mbap_adu(61, 1, TWO), 11010),
    ]
    found, events = _records(packets)
    assert _told(found)[-2:] == [("late", 1005), ("ok", 10)]
    assert events == []


def test_responses_may_come_in_another_order_than_their_requests() -> None:
    packets = [
        _sent(mbap_adu(1, 1, READ), 0),
        _sent(mbap_adu(2, 1, READ), 1),
        _response(mbap_adu(2, 1, TWO), 5),
        _response(mbap_adu(1, 1, TWO), 6),
    ]
    assert _told(_records(packets)[0]) == [("ok", 6), ("ok", 4)]


@pytest.mark.parametrize("number", [0, 77])
def test_a_doubled_datagram_is_an_event_and_no_transaction(number: int) -> None:
    request, response = mbap_adu(1, 1, READ), mbap_adu(1, 1, TWO)
    packets = [
        _sent(request, 0, number=number),
        _sent(request, 0.2, number=number),
        _response(response, 5, number=number),
        _response(response, 5.3, number=number),
        _response(response, 400, number=number),
    ]
    found, events = _records(packets)
    assert _told(found) == [("ok", 5)]
    assert [(str(one.kind), one.raw) for one in events] == [
        ("repeated", request), ("repeated", response), ("repeated", response),
    ]  # fmt: skip
    assert events[1].source == f"{SLAVE}:502"


@pytest.mark.parametrize("numbers", [(0, 0), (77, 78)])
def test_a_retry_of_the_master_is_no_doubled_datagram(numbers: tuple[int, int]) -> None:
    packets = [
        _sent(mbap_adu(1, 1, READ), 0, number=numbers[0]),
        _sent(mbap_adu(1, 1, READ), 500, number=numbers[1]),
        _response(mbap_adu(1, 1, TWO), 505, number=1),
    ]
    found, events = _records(packets)
    assert events == []
    assert _told(found) == [("no-answer", None), ("ok", 5)]
    assert [one.retries for one in sorted(found, key=lambda one: one.start_ns)] == [0, 1]


def test_a_datagram_that_two_interfaces_have_heard_counts_once() -> None:
    packets = [
        _sent(mbap_adu(1, 1, READ), 0, link="if0"),
        _sent(mbap_adu(1, 1, READ), 0.1, link="if1"),
        _response(mbap_adu(1, 1, TWO), 5),
    ]
    found, events = _records(packets)
    assert (_told(found), events) == ([("ok", 5)], [])


def test_a_datagram_that_is_no_adu_does_not_harm_the_next() -> None:
    packets = [
        _sent(b"\x00\x01\x00\x00\x00\x20\x01", 0),
        _sent(mbap_adu(1, 1, READ), 10),
        _response(mbap_adu(1, 1, TWO)[:-2], 12),
        _sent(mbap_adu(2, 1, READ), 20),
        _response(mbap_adu(2, 1, TWO), 22),
    ]
    found, events = _records(packets)
    assert [str(one.outcome) for one in found].count("ok") == 1
    assert [str(one.kind) for one in events] == ["skipped", "skipped"]


def test_a_datagram_that_the_capture_has_cut_keeps_its_unit_and_function() -> None:
    long = mbap_adu(1, 1, bytes.fromhex("03 28") + bytes(40))
    packets = [_sent(mbap_adu(1, 1, READ[:-1] + b"\x14"), 0), cut(_response(long, 5), 60)]
    (one,), events = _records(packets)
    assert (one.unit, one.function, str(one.outcome)) == (1, 3, "not-captured")
    assert [str(one.kind) for one in events] == ["cut"]


def test_datagrams_of_other_ports_are_passed_over() -> None:
    packets = [_sent(mbap_adu(1, 1, READ), 0, ports=(50000, 53))]
    assert _records(packets) == ([], [])


def test_any_port_finds_modbus_over_udp() -> None:
    packets = []
    for number in range(4):
        packets += [
            _sent(mbap_adu(number, 1, READ), 100 * number, ports=(50000, 5020)),
            _sent(
                mbap_adu(number, 1, TWO), 100 * number + 5, ports=(50000, 5020), is_request=False
            ),
            _sent(bytes.fromhex("a0b1 0100 0001 0000"), 100 * number, ports=(50001, 53)),
        ]
    found, _ = _records(packets, any_port=True)
    assert _told(found) == [("ok", 5)] * 4
    assert {one.destination for one in found} == {f"{SLAVE}:5020"}
