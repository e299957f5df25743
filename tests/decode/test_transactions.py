"""The record of a transaction, from its request and its response."""

from __future__ import annotations

from typing import Any

import pytest

from mbtool.core import Direction
from mbtool.decode.transactions import (
    MAX_CACHED_REQUESTS,
    Ends,
    _request_facts,
    broadcast,
    no_answer,
    unsolicited,
    with_response,
)
from mbtool.modbus.adu import Adu, DirectionBy, Transport, Verdict
from mbtool.modbus.transaction import Outcome, Transaction

ENDS = Ends("rs485")


def adu(direction: Direction, pdu: str, at_ns: int, *verdicts: Verdict) -> Adu:
    data = bytes.fromhex(pdu)
    return Adu(
        start_ns=at_ns,
        end_ns=at_ns + 10,
        transport=Transport.RTU,
        direction=direction,
        direction_by=DirectionBy.FORM,
        confidence=0.9 if direction is Direction.REQUEST else 0.99,
        unit=5,
        pdu=data,
        raw=b"\x05" + data + b"\x00\x00",
        verdicts=verdicts,
    )


def request(pdu: str, *verdicts: Verdict) -> Adu:
    return adu(Direction.REQUEST, pdu, 100, *verdicts)


def response(pdu: str, *verdicts: Verdict) -> Adu:
    return adu(Direction.RESPONSE, pdu, 150, *verdicts)


def exchange(asked: str, told: str) -> Transaction:
    return with_response(ENDS, request(asked), response(told), 0, ())


@pytest.mark.parametrize(
    ("asked", "told", "fields"),
    [
        (
            "01 0013 0003", "01 01 FD",  # The rest of the byte is padding.
            {"address": 0x13, "quantity": 3, "response_values": [1, 0, 1]},
        ),
        (
            "03 006B 0002", "03 04 022B 0064",
            {"address": 0x6B, "quantity": 2, "response_values": [0x22B, 0x64]},
        ),
        (
            "05 00AC FF00", "05 00AC FF00",
            {"address": 0xAC, "quantity": 1, "request_values": [1]},
        ),
        (
            "05 00AC 0000", "05 00AC 0000",
            {"address": 0xAC, "quantity": 1, "request_values": [0]},
        ),
        (
            "06 0001 0003", "06 0001 0003",
            {"address": 1, "quantity": 1, "request_values": [3]},
        ),
        ("07", "07 6D", {"response_values": [0x6D]}),
        (
            "08 0000 A537", "08 0000 A537",
            {"sub_function": 0, "request_values": [0xA537], "response_values": [0xA537]},
        ),
        ("0B", "0B FFFF 0108", {"response_values": [0xFFFF, 0x108]}),
        ("11", "11 03 01 FF 00", {}),
        (
            "0F 0013 000A 02 CD01", "0F 0013 000A",
            {"address": 0x13, "quantity": 10, "request_values": [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]},
        ),
        (
            "10 0001 0002 04 000A 0102", "10 0001 0002",
            {"address": 1, "quantity": 2, "request_values": [10, 0x102]},
        ),
        (
            "16 0004 00F2 0025", "16 0004 00F2 0025",
            {"address": 4, "quantity": 1, "request_values": [0xF2, 0x25]},
        ),
        (
            "17 0003 0002 000E 0001 02 00FF", "17 04 00FE 0ACD",
            {
                "address": 3, "quantity": 2, "write_address": 14, "write_quantity": 1,
                "request_values": [0xFF], "response_values": [0xFE, 0xACD],
            },
        ),
        (
            "18 04DE", "18 0006 0002 01B8 1284",
            {"address": 0x4DE, "response_values": [0x1B8, 0x1284]},
        ),
        ("2B 0E 01 00", "2B 0E 01 01 00 00 01 00 01 41", {"sub_function": 0x0E}),
        ("41 00", "41 00 13", {}),
    ],
)  # fmt: skip
def test_transaction_says_what_was_asked_and_told(
    asked: str, told: str, fields: dict[str, Any]
) -> None:
    done = exchange(asked, told)
    names = (
        "address", "quantity", "write_address", "write_quantity", "request_values",
        "response_values", "sub_function",
    )  # fmt: skip
    assert {name: getattr(done, name) for name in names} == {**dict.fromkeys(names), **fields}
    assert (done.outcome, done.verdicts, done.exception) == (Outcome.OK, [], None)
    assert (done.request_ns, done.response_ns, done.latency_ns) == (110, 160, 40)
    assert (done.function, done.unit, done.link) == (bytes.fromhex(asked)[0], 5, "rs485")


def test_exception_response_has_a_name() -> None:
    done = exchange("03 006B 0002", "83 02")
    assert (done.outcome, done.function) == (Outcome.EXCEPTION, 3)
    assert (done.exception, done.exception_name) == (2, "illegal data address")
    assert (done.response_values, done.quantity, done.latency_ns) == (None, 2, 40)


def test_exception_response_that_is_too_long_is_noticed() -> None:
    done = exchange("03 006B 0002", "83 02 00")
    assert (done.outcome, done.verdicts) == (Outcome.EXCEPTION, [Verdict.MALFORMED_RESPONSE])


@pytest.mark.parametrize("told", ["03 02 0000", "03 04 0000 00", "03", "83"])
def test_response_of_another_form_is_malformed(told: str) -> None:
    done = exchange("03 006B 0002", told)
    assert (done.outcome, done.verdicts) == (Outcome.MALFORMED, [Verdict.MALFORMED_RESPONSE])
    assert done.response_raw == b"\x05" + bytes.fromhex(told) + b"\x00\x00"


def test_malformed_request_may_be_answered_well() -> None:
    done = exchange("10 0001 0001 04 000A 0102", "10 0001 0001")
    assert (done.outcome, done.verdicts) == (Outcome.OK, [Verdict.MALFORMED_REQUEST])
    assert done.request_values == [10, 0x102]


def test_coil_value_that_is_neither_on_nor_off_is_no_value() -> None:
    done = exchange("05 0001 1234", "05 0001 1234")
    assert (done.outcome, done.request_values) == (Outcome.OK, None)
    assert done.verdicts == [Verdict.MALFORMED_REQUEST]


def test_verdicts_of_both_frames_are_kept_once() -> None:
    done = with_response(
        ENDS,
        request("07", Verdict.GLUED),
        response("07 00", Verdict.SPLIT, Verdict.GLUED),
        2,
        (Verdict.OTHER_TRANSACTION_ID,),
    )
    assert done.verdicts == [Verdict.GLUED, Verdict.SPLIT, Verdict.OTHER_TRANSACTION_ID]
    assert (done.retries, done.confidence) == (2, 0.9)


def test_request_alone_has_no_response() -> None:
    for done, outcome in (
        (no_answer(ENDS, request("06 0001 0003"), 1), Outcome.NO_ANSWER),
        (broadcast(ENDS, request("06 0001 0003")), Outcome.BROADCAST),
    ):
        assert (done.outcome, done.address, done.request_values) == (outcome, 1, [3])
        assert (done.response_ns, done.response_raw, done.latency_ns) == (None, None, None)
        assert done.start_ns == 110
    assert no_answer(ENDS, request("06 0001"), 0).verdicts == [Verdict.MALFORMED_REQUEST]


def test_request_with_the_exception_bit_keeps_its_code() -> None:
    done = no_answer(ENDS, request("83 00"), 0)
    assert (done.function, done.function_name) == (0x83, "function 83H")


def test_response_alone_has_no_request() -> None:
    done = unsolicited(ENDS, response("10 0001 0002"))
    assert (done.outcome, done.address, done.quantity) == (Outcome.UNSOLICITED, 1, 2)
    assert (done.request_ns, done.request_raw, done.request_values) == (None, None, None)
    assert done.start_ns == 160
    assert unsolicited(ENDS, response("83 02")).exception_name == "illegal data address"
    assert unsolicited(ENDS, response("03 02")).verdicts == [Verdict.MALFORMED_RESPONSE]


def test_values_of_a_transaction_are_its_own() -> None:
    """The same request is read once, and what it says is given to each transaction anew."""
    write = "10 0001 0002 04 000A 0102"
    first = exchange(write, "10 0001 0002")
    assert first.request_values is not None
    first.request_values.append(7)
    assert exchange(write, "10 0001 0002").request_values == [10, 0x102]


def test_requests_remembered_are_bounded() -> None:
    for number in range(2 * MAX_CACHED_REQUESTS):
        assert exchange(f"06 0001 {number:04X}", "83 02").request_values == [number]
    assert _request_facts.cache_info().currsize == MAX_CACHED_REQUESTS
