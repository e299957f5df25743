from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.framing import MbapSplitter
from mbtool.modbus.adu import Adu, Transport, ascii_adu, crc, lrc, mbap_adu, rtu_adu
from mbtool.modbus.response import Distortion, Response, wire_pieces

PDU = bytes.fromhex("03 02 1234")  # two bytes, one register
FRAMED = {
    Transport.RTU: rtu_adu(1, PDU),
    Transport.RTU_TCP: rtu_adu(1, PDU),
    Transport.ASCII: ascii_adu(1, PDU),
    Transport.TCP: mbap_adu(7, 1, PDU),
    Transport.UDP: mbap_adu(7, 1, PDU),
    Transport.RTU_UDP: rtu_adu(1, PDU),
}


def _sent(spoiling: Distortion | None, transport: Transport = Transport.RTU) -> bytes:
    return b"".join(
        data for _, data in wire_pieces(Response(PDU, distortion=spoiling), transport, 1, 7)
    )


@pytest.mark.parametrize("transport", Transport)
@pytest.mark.parametrize("spoiling", [None, Distortion()])
def test_a_response_without_distortion_is_sent_whole(
    transport: Transport, spoiling: Distortion | None
) -> None:
    assert wire_pieces(Response(PDU, distortion=spoiling), transport, 1, 7) == [
        (0, FRAMED[transport])
    ]


def test_an_adu_with_another_unit_has_a_correct_check() -> None:
    assert _sent(Distortion(unit_by=2)) == rtu_adu(3, PDU)
    assert _sent(Distortion(unit_by=255), Transport.TCP) == mbap_adu(7, 0, PDU)


def test_another_transaction_id_wraps() -> None:
    assert _sent(Distortion(id_by=0xFFFF), Transport.TCP) == mbap_adu(6, 1, PDU)


@pytest.mark.parametrize("transport", [Transport.RTU, Transport.RTU_TCP])
def test_a_wrong_crc_is_wrong(transport: Transport) -> None:
    sent = _sent(Distortion(wrong_check=True), transport)
    assert sent[:-2] == FRAMED[transport][:-2]
    assert crc(sent) != 0


def test_a_wrong_lrc_is_wrong_and_still_hexadecimal() -> None:
    sent = _sent(Distortion(wrong_check=True), Transport.ASCII)
    body = bytes.fromhex(sent[1:-2].decode())
    assert sent[:-4] == FRAMED[Transport.ASCII][:-4]
    assert lrc(body[:-1]) != body[-1]


def test_modbus_tcp_has_no_check_that_could_be_wrong() -> None:
    assert _sent(Distortion(wrong_check=True), Transport.TCP) == FRAMED[Transport.TCP]


def test_bytes_can_be_cut_off_and_added_at_the_end() -> None:
    assert _sent(Distortion(cut=2, extra=b"\xff")) == FRAMED[Transport.RTU][:-2] + b"\xff"


def test_a_response_that_is_cut_off_completely_sends_nothing() -> None:
    assert wire_pieces(Response(PDU, distortion=Distortion(cut=99)), Transport.RTU, 1) == []


@pytest.mark.parametrize("transport", Transport)
def test_a_cut_that_is_longer_than_the_adu_leaves_nothing_either(transport: Transport) -> None:
    size = len(FRAMED[transport])
    for cut in range(size, 2 * size + 1):
        assert _sent(Distortion(cut=cut), transport) == b""


def test_a_silent_response_sends_nothing() -> None:
    answer = Response(PDU, distortion=Distortion(silent=True, extra=b"\xff"))
    assert wire_pieces(answer, Transport.RTU, 1) == []


@given(st.integers(1, 300), st.integers(0, 10**9))
def test_pieces_make_the_whole_adu_with_pauses_between_them(pieces: int, gap_ns: int) -> None:
    spoiling = Distortion(pieces=pieces, gap_ns=gap_ns)
    sent = wire_pieces(Response(PDU, distortion=spoiling), Transport.TCP, 1, 7)
    assert b"".join(data for _, data in sent) == FRAMED[Transport.TCP]
    assert len(sent) == min(pieces, len(FRAMED[Transport.TCP]))
    assert all(data for _, data in sent)
    assert [at_ns for at_ns, _ in sent] == [number * gap_ns for number in range(len(sent))]


@given(st.binary(min_size=1, max_size=253), st.integers(0, 0xFFFF), st.integers(0, 255))
def test_an_adu_without_damage_can_be_read_back(pdu: bytes, transaction_id: int, unit: int) -> None:
    spoiling = Distortion(unit_by=3, id_by=5, pieces=3)
    splitter = MbapSplitter(Direction.RESPONSE)
    events = [
        event
        for _, data in wire_pieces(
            Response(pdu, distortion=spoiling), Transport.TCP, unit, transaction_id
        )
        for event in splitter.feed(data, 0)
    ]
    (adu,) = events
    assert isinstance(adu, Adu)
    assert (adu.unit, adu.pdu) == (unit + 3 & 0xFF, pdu)
    assert adu.transaction_id == transaction_id + 5 & 0xFFFF


def test_faults_that_are_not_named_are_none() -> None:
    assert Distortion() == Distortion(
        unit_by=0, id_by=0, wrong_check=False, cut=0, extra=b"", pieces=1, gap_ns=0, silent=False,
        ending=None,
    )  # fmt: skip
    assert Response(PDU) == Response(PDU, delay_ns=0, distortion=None)
    assert [at_ns for at_ns, _ in wire_pieces(
        Response(PDU, distortion=Distortion(pieces=2)), Transport.TCP, 1
    )] == [0, 0]  # fmt: skip


def test_the_transaction_id_is_0_if_none_is_given() -> None:
    ((_, adu),) = wire_pieces(Response(PDU), Transport.TCP, 1)
    assert adu == mbap_adu(0, 1, PDU)


@pytest.mark.parametrize("transport", [Transport.RTU, Transport.ASCII])
def test_a_wrong_check_differs_in_its_last_byte_or_digit(transport: Transport) -> None:
    sent, right = _sent(Distortion(wrong_check=True), transport), FRAMED[transport]
    end = -3 if transport is Transport.ASCII else -1
    assert len(sent) == len(right)
    assert [at for at, one in enumerate(sent) if one != right[at]] == [len(right) + end]
    digit, before = sent[end], right[end]
    assert digit ^ before == 0xFF or int(chr(digit), 16) ^ int(chr(before), 16) == 0xF
