"""Reading plain stretches as arrays gives what the decoder gives packet by packet."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbtool.core import Direction, EventKind
from mbtool.modbus import encode_pdu, exception_pdu, mbap_adu
from mbtool.packets.segment import ACK, FIN
from tests.captures import public_folder
from tests.columns.both_ways import as_arrays, blocks_of, damaged, differences, generated
from tests.columns.disturbed_captures import disturbed
from tests.packets.building import Pcapng, Talk, pcap

if TYPE_CHECKING:
    from mbtool.core import Packet

MOST_BYTES = 60_000
"""Longer captures of others take too long here."""

READ = encode_pdu(0x03, Direction.REQUEST, address=107, quantity=3)
VALUES = encode_pdu(0x03, Direction.RESPONSE, values=(1, 2, 3))


def poll(
    talk: Talk, transactions: int, request: bytes = READ, response: bytes = VALUES
) -> list[Packet]:
    packets = []
    for number in range(transactions):
        packets.append(talk.request(mbap_adu(number, 17, request)))
        packets.append(talk.response(mbap_adu(number, 17, response)))
    return packets


def test_a_clean_poll_is_read_as_arrays_but_for_its_beginning() -> None:
    talk = Talk()
    capture = pcap([*talk.handshake(), *poll(talk, 50)])
    assert differences(capture) == []
    assert as_arrays(capture).plain == 49


def test_a_connection_that_the_capture_has_whole_is_read_as_arrays() -> None:
    talk = Talk()
    capture = pcap([*talk.handshake(), *poll(talk, 50), *talk.goodbye()])
    assert differences(capture) == []
    assert as_arrays(capture).plain == 50
    assert differences(capture, 60) == []


def test_connections_that_the_slave_ends_are_read_as_arrays() -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 5)]
    packets += [talk.send(talk.slave, flags=FIN | ACK), talk.send(talk.master, flags=FIN | ACK)]
    capture = pcap([*packets, talk.send(talk.slave)])
    assert differences(capture) == []
    assert as_arrays(capture).plain == 5
    assert as_arrays(capture).events[-1].message == "connection closed: finished by the slave"


@pytest.mark.parametrize("flows_at_once", [3, 2048])
def test_connections_of_one_poll_each_are_read_as_arrays(flows_at_once: int) -> None:
    packets: list[Packet] = []
    for number in range(40):
        talk = Talk(ts_ns=1_000_000_000 * number)
        talk.master.port += number % 12
        talk.master.sequence += 70_000 * number
        packets += [*talk.handshake(), *poll(talk, 1), *talk.goodbye()]
    with patch("mbtool.columns.column_decoder._FLOWS_AT_ONCE", flows_at_once):
        assert differences(pcap(packets)) == []
        assert as_arrays(pcap(packets)).plain == 40


def test_a_late_copy_of_a_packet_of_an_ended_connection_gives_equal_results() -> None:
    talk = Talk()
    whole = [*talk.handshake(), *poll(talk, 2), *talk.goodbye()]
    for late in whole:
        packets = [*whole, replace(late, ts_ns=whole[-1].ts_ns + 1000)]
        assert differences(pcap(packets)) == []
        assert differences(pcap(packets), len(whole)) == []
        assert as_arrays(pcap(packets), len(whole)).plain == 2


def test_a_request_in_two_segments_and_segments_sent_again_are_read_as_arrays() -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 3)]
    for cut in range(1, 12):
        request = mbap_adu(cut, 17, READ)
        packets += [talk.request(request[:cut]), talk.request(request[cut:])]
        packets.append(talk.response(mbap_adu(cut, 17, VALUES)))
    packets += poll(talk, 3)
    assert differences(pcap(packets)) == []
    assert as_arrays(pcap(packets)).plain == 16
    again = [one for one in packets[3:] for _ in range(2)]
    assert differences(pcap(packets[:3] + again)) == []
    assert as_arrays(pcap(packets[:3] + again)).plain == 16 - 2  # A single byte may be a probe.


def test_late_retransmissions_and_late_parts_are_told_both_ways() -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 3)]
    for number in range(4):
        request = talk.request(mbap_adu(number, 17, READ))
        talk.ts_ns += 210_000_000
        packets += [request, replace(request, ts_ns=talk.ts_ns)]
        packets.append(talk.response(mbap_adu(number, 17, VALUES)))
    for wait_ms in (1, 40, 200):
        request_bytes = mbap_adu(wait_ms, 17, READ)
        packets.append(talk.request(request_bytes[:6]))
        talk.ts_ns += wait_ms * 1_000_000
        packets.append(talk.request(request_bytes[6:]))
        packets.append(talk.response(mbap_adu(wait_ms, 17, VALUES)))
    capture = pcap([*packets, *poll(talk, 3)])
    assert differences(capture) == []
    read = as_arrays(capture)
    assert [one.kind for one in read.events].count(EventKind.SENT_AGAIN) == 4
    parts = [ns for ns in read.table["request_parts_ns"].to_pylist() if ns is not None]
    assert parts == [41_000_000, 201_000_000]


def test_responses_of_another_mac_address_are_told_both_ways() -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 6)]
    own, other = bytes.fromhex("020000000001"), bytes.fromhex("020000000066")
    packets = [replace(one, data=own + own + one.data[12:]) for one in packets]
    for at in (6, 10):  # Two of the responses.
        packets[at] = replace(packets[at], data=own + other + packets[at].data[12:])
    assert differences(pcap(packets)) == []
    told = as_arrays(pcap(packets)).table["response_mac"].to_pylist()
    assert set(told) == {None, "02:00:00:00:00:66"}


MASKS = {"address": 7, "and_mask": 1, "or_mask": 2}
ELEVEN = (1, 0, 1, 1, 0, 0, 0, 1, 1, 0, 1, 0, 0, 0, 0, 0)
PADDED = (1, 0, 1, 1, 0, 0, 0, 1, 1, 0, 1, 1, 0, 0, 0, 0)
FORMS: tuple[tuple[int, dict[str, Any], dict[str, Any]], ...] = (
    (0x01, {"address": 3, "quantity": 11}, {"values": ELEVEN}),
    (0x01, {"address": 3, "quantity": 11}, {"values": PADDED}),
    (0x02, {"address": 0, "quantity": 8}, {"values": (1,) * 8}),
    (0x03, {"address": 107, "quantity": 2}, {"values": (1, 2, 3)}),
    (0x04, {"address": 65535, "quantity": 2}, {"values": (65535, 0)}),
    (0x03, {"address": 0, "quantity": 0}, {"values": ()}),
    (0x05, {"address": 1, "value": 0xFF00}, {"address": 1, "value": 0xFF00}),
    (0x05, {"address": 1, "value": 0}, {"address": 1, "value": 0}),
    (0x05, {"address": 1, "value": 1}, {"address": 1, "value": 1}),
    (0x06, {"address": 1, "value": 4660}, {"address": 1, "value": 4660}),
    (0x06, {"address": 1, "value": 4660}, {"address": 2, "value": 4660}),
    (0x07, {}, {"status": 3}),
    (0x0F, {"address": 7, "values": (1, 0, 1)}, {"address": 7, "quantity": 3}),
    (0x0F, {"address": 7, "values": (1,) * 9}, {"address": 7, "quantity": 8}),
    (0x10, {"address": 7, "values": (1, 2)}, {"address": 7, "quantity": 2}),
    (0x16, MASKS, MASKS),
    (0x17, {"address": 1, "quantity": 1, "write_address": 3, "values": (4, 5)}, {"values": (9,)}),
)  # fmt: skip


Form = tuple[int, dict[str, Any], dict[str, Any]]


def encoded(form: Form) -> tuple[bytes, bytes]:
    """The PDUs of a request and its response."""
    code, asked, answered = form
    request = encode_pdu(code, Direction.REQUEST, **asked)
    return request, encode_pdu(code, Direction.RESPONSE, **answered)


def every_form() -> bytes:
    """A capture with two answered and two refused requests of each form of PDU."""
    talk = Talk()
    packets = talk.handshake()
    for form in FORMS:
        request, response = encoded(form)
        packets += poll(talk, 2, request, response)
        packets += poll(talk, 2, request, exception_pdu(form[0], 2))
    return pcap(packets)


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize("refused", [False, True])
def test_each_form_of_pdu_gives_equal_columns(form: Form, refused: bool) -> None:
    code = form[0]
    request, response = encoded(form)
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 3)]
    packets += poll(talk, 4, request, exception_pdu(code, 2) if refused else response)
    packets += [*poll(talk, 3), *talk.goodbye()]
    assert differences(pcap(packets)) == []
    assert as_arrays(pcap(packets)).plain == 10


@pytest.mark.parametrize(
    "request_",
    ["03 006b", "03 006b 0003 00", "0f 0001 0008 02 ff", "10 0001 0002 03 000102", "41 00"],
)
def test_a_request_of_a_wrong_form_gives_equal_columns(request_: str) -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 3), *poll(talk, 3, bytes.fromhex(request_), VALUES)]
    packets += poll(talk, 2, bytes.fromhex(request_), bytes([bytes.fromhex(request_)[0], 1, 2]))
    assert differences(pcap(packets)) == []


@pytest.mark.parametrize("number", range(28))
def test_simulated_plants_give_equal_results(number: int) -> None:
    rng = random.Random(number)
    capture = damaged(generated(number), rng)
    assert differences(capture, rng.choice((3, 17, 100, 65_536))) == []


@pytest.mark.parametrize("apart_ns", [30_000_000_000, 30_000_000_001])
def test_the_parts_of_a_request_may_come_late(apart_ns: int) -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 3)]
    request = mbap_adu(3, 17, READ)
    packets.append(talk.request(request[:5]))
    talk.ts_ns += apart_ns - 1_000_000
    packets += [talk.request(request[5:]), talk.response(mbap_adu(3, 17, VALUES)), *poll(talk, 3)]
    assert differences(pcap(packets, magic=0xA1B23C4D)) == []


@pytest.mark.parametrize("number", range(24))
def test_many_short_connections_with_disorder_give_equal_results(number: int) -> None:
    capture = disturbed(number)
    limit = 10 if number % 3 else 4096
    with (
        patch("mbtool.packets.reassembler.MAX_CONNECTIONS", limit),
        patch("mbtool.decode.decoder.MAX_CONNECTIONS", limit),
        patch("mbtool.columns.column_decoder._FLOWS_AT_ONCE", limit // 2),
    ):
        assert differences(capture, 100 if number % 2 else 65_536) == []


def test_a_connection_is_told_the_time_while_its_stretch_goes_on() -> None:
    assert differences(damaged(generated(742), random.Random("cut 742"))) == []


def polls_of_several(count: int, transactions: int, unanswered: int = 0) -> list[Packet]:
    """The packets of `count` connections that poll in turn, a transaction each 2 ms.

    From the tenth request of a connection on, each request with a number that `unanswered` divides
    has no response.
    """
    talks = [Talk(ts_ns=number * 10_000_000) for number in range(count)]
    packets: list[Packet] = []
    for number, talk in enumerate(talks):
        talk.master.port += number
        packets += talk.handshake()
    for number in range(transactions):
        for talk in talks:
            talk.ts_ns = packets[-1].ts_ns
            both = poll(talk, 1)
            if unanswered and number > 10 and not number % unanswered:
                talk.slave.sequence -= len(mbap_adu(0, 17, VALUES))
                del both[1]
            packets += both
    return packets


@pytest.mark.parametrize("jitter_ns", [900_000, 60_000_000, 130_000_000])
@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("smallest", [4, 256])
def test_times_that_go_back_give_equal_results(jitter_ns: int, number: int, smallest: int) -> None:
    rng = random.Random(number)
    packets = polls_of_several(3, 60, rng.choice((0, 7)))
    for at in range(0, len(packets), rng.choice((1, 5, 40))):
        packets[at] = moved(packets[at], rng.randrange(jitter_ns))
    with patch("mbtool.columns.column_decoder.SMALLEST", smallest):
        assert differences(pcap(packets, magic=0xA1B23C4D)) == []


def test_times_that_go_back_a_little_leave_polls_to_arrays() -> None:
    packets = polls_of_several(4, 60)
    for at in range(12, len(packets), 10):
        packets[at] = moved(packets[at], -20_000_000)
    assert differences(pcap(packets)) == []
    assert as_arrays(pcap(packets)).plain > 100


@pytest.mark.parametrize("hours", [1, 1.9, 2, 3])
@pytest.mark.parametrize("smallest", [4, 256])
def test_pauses_of_hours_give_equal_results(hours: float, smallest: int) -> None:
    packets: list[Packet] = []
    pause_ns = int(hours * 3600e9)
    ends_ns = 0
    talks = [Talk(), Talk(), Talk()]
    for number, talk in enumerate(talks):
        talk.master.port += number
        talk.ts_ns = ends_ns
        packets += [*talk.handshake(), *poll(talk, 3)]
        ends_ns = talk.ts_ns
    for number in range(40):
        talk = talks[number % (2 if number < 20 else 3)]
        talk.ts_ns = ends_ns + pause_ns // 2
        packets += poll(talk, 2)
        ends_ns = talk.ts_ns
    with patch("mbtool.columns.column_decoder.SMALLEST", smallest):
        assert differences(pcap(packets, magic=0xA1B23C4D)) == []
        if hours == 1 and smallest == 4:
            assert as_arrays(pcap(packets, magic=0xA1B23C4D)).plain > 60


@pytest.mark.parametrize("varied", [False, True])
@pytest.mark.parametrize("apart_ns", [0, 3_000_000_000, 61_000_000_000])
def test_polls_behind_a_request_without_response_are_read_as_arrays(
    varied: bool, apart_ns: int
) -> None:
    talk = Talk()
    packets = talk.handshake()
    requests = [
        encode_pdu(0x03, Direction.REQUEST, address=107 + number, quantity=3) for number in range(5)
    ]
    for number in range(100):
        request = requests[number % 5 if varied else 0]
        asked, answered = mbap_adu(number, 17, request), mbap_adu(number, 17, VALUES)
        packets.append(talk.request(asked))
        if number not in (20, 40, 41):
            packets.append(talk.response(answered))
        talk.ts_ns += apart_ns if number in (21, 60) else 200_000_000 * (number in (20, 40, 41))
    capture = pcap(packets, magic=0xA1B23C4D)
    assert differences(capture) == []
    assert as_arrays(capture).plain > 80


@settings(max_examples=40)
@given(data=st.data())
def test_a_poll_that_is_disturbed_anywhere_gives_equal_results(data: st.DataObject) -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 12), *talk.goodbye()]
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(packets) - 2))
        match data.draw(st.sampled_from(["lose", "repeat", "swap", "late", "cut"])):
            case "lose":
                del packets[at]
            case "repeat":
                packets.insert(data.draw(st.integers(at, len(packets))), packets[at])
            case "swap":
                packets[at : at + 2] = packets[at : at + 2][::-1]
            case "late":
                packets[at:] = [moved(one, 70_000_000_000) for one in packets[at:]]
            case _:
                packets[at] = shortened(packets[at])
    assert differences(pcap(packets), data.draw(st.sampled_from([2, 5, 65_536]))) == []


def moved(packet: Packet, by_ns: int) -> Packet:
    return replace(packet, ts_ns=packet.ts_ns + by_ns)


def shortened(packet: Packet) -> Packet:
    return replace(packet, data=packet.data[:-5])


def test_two_connections_at_once_give_equal_results_in_order() -> None:
    one, other = Talk(), Talk()
    other.master.port += 1
    pairs = zip(
        [*one.handshake(), *poll(one, 20)], [*other.handshake(), *poll(other, 20)], strict=True
    )
    packets = [packet for pair in pairs for packet in pair]
    del packets[31]
    assert differences(pcap(packets)) == []
    assert as_arrays(pcap(packets)).plain > 30


def test_an_address_that_changes_within_a_connection_is_in_its_row() -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 20)]
    moved_ = [replace(one, data=b"\2" + one.data[1:]) for one in packets[20:24]]
    assert differences(pcap([*packets[:20], *moved_, *packets[24:]])) == []


def test_a_pcapng_file_gives_equal_results() -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 20)]
    blocks = Pcapng()
    file = blocks.section() + blocks.interface()
    file += b"".join(blocks.enhanced(one.data, one.ts_ns // 1000) for one in packets)
    assert differences(file, 7) == []
    assert as_arrays(file).plain == 19


OWN = Path(__file__).resolve().parents[2] / "captures"


def test_the_captures_of_the_repository_give_equal_results() -> None:
    captures = sorted(OWN.glob("**/*.pcap"))
    assert len(captures) > 100
    for path in captures:
        assert differences(path.read_bytes()) == [], path


@pytest.mark.public_captures
def test_captures_made_by_others_give_equal_results(public_captures: Path) -> None:
    assert public_captures == public_folder()
    differing = {}
    for path in sorted(public_captures.glob("**/*.pcap*")):
        if path.suffix in (".pcap", ".pcapng") and path.stat().st_size <= MOST_BYTES:
            found = differences(path.read_bytes(), 97)
            if found:
                differing[path.name] = found
    assert differing == {}


@pytest.mark.parametrize("in_one_segment", [True, False])
def test_pipelined_requests_are_rows_although_the_decoder_reads_them(in_one_segment: bool) -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 2)]
    for number in range(0, 120, 3):
        asked = [mbap_adu(10 + number + one, 17, READ) for one in range(3)]
        told = [mbap_adu(10 + number + one, 17, VALUES) for one in range(3)]
        if in_one_segment:
            packets += [talk.request(b"".join(asked)), talk.response(b"".join(told))]
        else:
            packets += [*map(talk.request, asked), *map(talk.response, told)]
    packets += poll(talk, 2)
    capture = pcap(packets)
    assert differences(capture) == []
    blocks, _, _ = blocks_of(capture)
    rows = sum(len(one.plain.request) for one in blocks if one.plain is not None)
    assert rows >= 120
