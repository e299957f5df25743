"""Which bytes are taken for a damaged answer, and how it is sent again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Transport, ascii_adu, rtu_adu
from mbtool.modbus.response import wire_pieces
from mbtool.replay.damaged import RESPONSE_NS, DamagedAnswer, damaged_answers
from tests.replay.recorded import MS, answered, unanswered

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

READ = "03 0000 0002"
VALUES = bytes.fromhex("03 04 1234 5678")
WRONG = rtu_adu(1, VALUES)[:-1] + b"\x00"


def _event(at_ms: int, raw: bytes, kind: EventKind = EventKind.BAD_CHECK) -> WireEvent:
    return WireEvent(ts_ns=at_ms * MS, link="rs485", kind=kind, message="", raw=raw)


def _raw(asked: list[Transaction], *events: WireEvent) -> dict[int, bytes]:
    return {place: one.raw for place, one in damaged_answers(asked, events).items()}


def test_bytes_before_the_next_request_are_the_damaged_response() -> None:
    asked = [unanswered(0, READ), unanswered(100, READ), answered(200, READ, VALUES.hex())]
    found = damaged_answers(asked, [_event(120, WRONG), _event(210, WRONG)])
    assert found == {1: DamagedAnswer(WRONG, Transport.RTU, True, 20 * MS)}


def test_an_incomplete_response_counts_too() -> None:
    assert _raw([unanswered(0, READ)], _event(5, WRONG[:4], EventKind.SKIPPED)) == {0: WRONG[:4]}


@pytest.mark.parametrize(
    "raw",
    [
        rtu_adu(2, VALUES),  # of another unit
        rtu_adu(1, b"\x04" + VALUES[1:]),  # of another function
        bytes.fromhex("01 03 00 00 00 02 FF FF"),  # the request again, with a wrong CRC
        b"\x01",
        b"",
    ],
)
def test_bytes_that_do_not_begin_like_the_response_do_not_count(raw: bytes) -> None:
    assert _raw([unanswered(0, READ)], _event(5, raw)) == {}


def test_bytes_too_late_before_the_request_or_of_another_link_do_not_count() -> None:
    late = _event(RESPONSE_NS // MS + 1, WRONG)
    elsewhere = WireEvent(ts_ns=5, link="b", kind=EventKind.BAD_CHECK, message="", raw=WRONG)
    told = _event(5, WRONG, EventKind.LINE_ERROR)
    assert _raw([unanswered(1, READ)], _event(0, WRONG), late, elsewhere, told) == {}


def test_an_exception_can_be_damaged_too() -> None:
    raw = rtu_adu(1, b"\x83\x02")[:-1] + b"\x00"
    assert _raw([unanswered(0, READ)], _event(5, raw)) == {0: raw}


def _sent(damaged: DamagedAnswer, transport: Transport) -> bytes | None:
    answer = damaged.with_same_damage(transport, 3)
    if answer is None:
        return None
    assert answer.delay_ns == 3
    return b"".join(piece for _, piece in wire_pieces(answer, transport, 1))


@pytest.mark.parametrize("transport", [Transport.RTU, Transport.RTU_TCP])
@pytest.mark.parametrize("raw", [WRONG, WRONG[:3]])
def test_the_same_framing_sends_the_same_bytes(transport: Transport, raw: bytes) -> None:
    assert _sent(DamagedAnswer(raw, Transport.RTU, True, 0), transport) == raw


def test_another_framing_sends_a_wrong_check_but_no_incomplete_response() -> None:
    sent = _sent(DamagedAnswer(WRONG, Transport.RTU, True, 0), Transport.ASCII)
    assert sent is not None
    whole = ascii_adu(1, VALUES)
    assert (sent[:-4], sent == whole) == (whole[:-4], False)
    assert _sent(DamagedAnswer(WRONG[:4], Transport.RTU, False, 0), Transport.ASCII) is None


def test_modbus_tcp_has_silence_for_a_damaged_response() -> None:
    assert _sent(DamagedAnswer(WRONG, Transport.RTU, True, 0), Transport.TCP) is None


def test_an_ascii_response_is_recognised_by_its_digits() -> None:
    asked = answered(0, READ, VALUES.hex(), transport=Transport.ASCII)
    import msgspec

    from mbtool.modbus import Outcome

    silent = msgspec.structs.replace(
        asked, outcome=Outcome.NO_ANSWER, response_raw=None, response_ns=None, latency_ns=None
    )
    wrong = ascii_adu(1, VALUES)[:-4] + b"00\r\n"
    assert _raw([silent], _event(5, wrong)) == {0: wrong}
    assert _raw([silent], _event(5, b":zz\r\n")) == {}
